"""The section of the report that tells what to drive next, and why."""

from __future__ import annotations

from collections.abc import Iterator

from app.discovery.asking import Ask
from app.discovery.extra_lines import DECIDED
from app.discovery.telling_apart import Question
from app.reporting.html_parts import callout, escape, table
from app.results.asking_json import reason
from app.results.numbers_as_text import plain

_HEADING = "Ask the machine"


def asked_section(asked: Ask | None, file: str) -> tuple[str, ...]:
    """Return heading and content: the questions, and the lines that decide them.

    file : the path of the lines, beside the report
    """
    if asked is None:
        return (
            _HEADING,
            "<p>Nothing is asked: no two names explain the measurement alike, and no "
            "evidence is thin.</p>",
        )
    questions = zip(asked.questions, asked.expected, strict=True)
    axes = [f"{n}, {'mm' if n in 'XYZ' else '°'}" for n in asked.path.axes]
    return (
        _HEADING,
        callout(escape(reason(asked)), warn=not asked.decides),
        table(
            ("Question", "Expected log Bayes factor"),
            ((_question(q), plain(told)) for q, told in questions),
            numbers=1,
        ),
        f"<p>From {DECIDED:.0f} on a question counts as decided: one in twenty then "
        "falls short of what a name needs.</p>",
        table(("Row", *axes, "Feed, mm/min", "Dwell, s"), _rows(asked), numbers=1),
        f"<p class=note>The same rows are in <code>{escape(file)}</code>. Drive and "
        "record them, then let both measurements be explained together: the service "
        "does so in one job, <code>measure-extra</code>.</p>",
    )


def _question(question: Question) -> str:
    if not question.right:
        return escape(f"Is there {question.left}?")
    return escape(f"{question.left}, or {question.right}?")


def _rows(asked: Ask) -> Iterator[tuple[str, ...]]:
    """Yield the waypoints; the first is where the lines begin."""
    path = asked.path
    for number, place in enumerate(path.position, start=1):
        feed = path.feed_mm_min[number - 1]
        yield (
            str(number),
            *(plain(value, 3) for value in place),
            plain(feed, 0) if number > 1 else "–",
            plain(path.dwell_s[number - 1], 2),
        )
