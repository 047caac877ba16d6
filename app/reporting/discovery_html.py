"""The report of a discovery: one HTML page that needs nothing else.

Where simulation and measurement disagree, which effects explain it, what it may be
instead, the lines that would decide, and the gap before and after on lines that the fit
did not see. Uncertainties are expanded ones (k = 2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any

from app.discovery.asking import Ask
from app.discovery.discover import Discovery
from app.discovery.where import Segment, Shown
from app.reporting.discovery_ask import asked_section
from app.reporting.discovery_figures import (
    along_run_figure,
    by_line_figure,
    gap_figure,
    profiles_figure,
    shares_figure,
)
from app.reporting.discovery_findings import findings_section, split, unnamed_section
from app.reporting.html_parts import (
    callout,
    drawing,
    escape,
    facts,
    section,
    table,
    tile,
)
from app.reporting.report_style import STYLE
from app.results.discovery_wording import title
from app.results.model_file import NextModel
from app.results.numbers_as_text import plain

CLOSED = 1.05  # gap over noise up to which nothing is left to explain
_WORST = 8
_OWN_STYLE = (
    ".finding{border-top:1px solid var(--rule);padding-top:6px;margin-top:16px}"
    ".finding h3{font-size:17px;margin-top:8px}"
    ".finding:first-of-type{border-top:0}"
    ".numbers{font-size:15px;font-variant-numeric:tabular-nums}"
)


def report_html(
    found: Discovery, model: NextModel, asked: Ask | None, ask_file: str
) -> str:
    """Return the report.

    asked : lines to drive next, None where nothing is asked; in `ask_file` beside it
    """
    name = escape(found.at.machine.name)
    parts = (
        findings_section(found, model),
        asked_section(asked, ask_file),
        _gap(found),
        _where(found),
        unnamed_section(found),
        _model(model),
        _documentation(found, model),
    )
    body = "".join(
        section(number, heading, *content)
        for number, (heading, *content) in enumerate(parts, start=1)
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: discovery report</title>\n<style>{STYLE}{_OWN_STYLE}</style>\n"
        f"</head>\n<body><main>\n{_header(found, model, name)}{_tiles(found)}{body}"
        f"{_footer(model)}</main></body>\n</html>\n"
    )


def _header(found: Discovery, model: NextModel, name: str) -> str:
    created = datetime.fromisoformat(model.content["provenance"]["created"])
    return (
        f"<header><p class=kind>Discovery report</p><h1>{name}</h1>"
        f"<p>What the model of {escape(_names(found))} lacks, held against "
        f"{escape(model.content['parent']['source'])}, {created:%Y-%m-%d %H:%M} UTC"
        "</p></header>\n"
    )


def _names(found: Discovery) -> str:
    return ", ".join(scene.run.name for scene in found.scenes)


def _tiles(found: Discovery) -> str:
    gap = found.gap
    named, unnamed = split(found)
    beside = f", {len(unnamed)} described" if unnamed else ""
    closed = gap.after_um <= CLOSED * gap.expected_um
    texts = [title(f.candidate) for f in named]
    tiles = (
        tile(
            str(len(named)),
            f"named{beside}",
            "Missing effects",
            escape("; ".join(texts) or "nothing that has a name is missing"),
        ),
        tile(plain(gap.before_um, 2), "µm", "Gap before", "on lines not seen"),
        tile(
            plain(gap.after_um, 2),
            "µm",
            "Gap after",
            "down to the noise" if closed else "something is left to explain",
            "good" if closed else "warn",
        ),
        tile(
            plain(gap.noise_floor_um, 2),
            "µm",
            "Noise floor",
            "what noise alone would leave",
        ),
    )
    return f'<div class="tiles">{"".join(tiles)}</div>\n'


def _gap(found: Discovery) -> tuple[str, ...]:
    gap = found.gap
    left = max(gap.after_um / max(gap.expected_um, 1e-12) - 1.0, 0.0)
    way = (
        f"falls from {gap.before_um:.2f} µm to {gap.after_um:.2f} µm"
        if found.findings
        else f"is {gap.after_um:.2f} µm"
    )
    text = (
        f"Measured minus simulated on lines that the fit did not see {way}; noise "
        f"alone would leave "
        f"{gap.noise_floor_um:.2f} µm, a complete model {gap.expected_um:.2f} µm, as "
        "well as the other lines tell it."
    )
    if left > CLOSED - 1.0:
        text += f" It stays {100 * left:.0f} % above that: something is left."
    return (
        "The gap, before and after",
        callout(text, warn=left > CLOSED - 1.0),
        drawing(
            gap_figure(gap),
            "Weighted root mean square of one component, on whole lines held out.",
        ),
        *_of_each_run(found, _along_run),
    )


def _along_run(shown: Shown) -> str:
    return drawing(
        along_run_figure(shown),
        "What is left along the run in X, Y and Z where the tracker stands, on one "
        "scale. Phase and speed of each line are taken out.",
    )


def _where(found: Discovery) -> tuple[str, ...]:
    return (
        "Where they disagree",
        "<p>The share of the squared disagreement that the means of each grouping "
        "hold: what depends on time shows by time and by line and nowhere else.</p>",
        *_of_each_run(found, _where_of),
    )


def _of_each_run(found: Discovery, draw: Callable[[Shown], str]) -> Iterator[str]:
    """Yield what is drawn of each Run, under its name where there are several."""
    runs = zip(found.scenes, found.shown, strict=True)
    for number, (scene, shown) in enumerate(runs, start=1):
        if len(found.scenes) > 1:
            yield f"<h3>Run {number}: {escape(scene.run.name)}</h3>"
        yield draw(shown)


def _where_of(shown: Shown) -> str:
    before, after = shown.before, shown.after
    rows = table(
        ("Row", "Axis", "Region", "Time, s", "Feed, mm/min", "rms, µm"),
        (_segment(s) for s in before.segments[:_WORST]),
        numbers=3,
    )
    return "".join(
        [
            drawing(
                shares_figure(before.shares, after.shares),
                "Grey: before; coloured: after. Noise gives every grouping a small "
                "share; many groups, such as lines, hold more of it.",
            ),
            drawing(
                by_line_figure(before.segments, after.segments),
                "Root mean square on every line.",
            ),
            drawing(
                profiles_figure(shown),
                "Mean disagreement before, in X, Y and Z, against what explains most.",
            ),
            f"<details><summary>The worst lines</summary>{rows}</details>",
        ]
    )


def _segment(segment: Segment) -> tuple[str, ...]:
    return (
        str(segment.row),
        f"{segment.axis}{segment.direction}".replace("-", "−") or "at rest",
        escape(segment.region),
        plain(segment.time_s),
        plain(segment.feed_mm_min, 0),
        plain(segment.rms_um, 2),
    )


def _model(model: NextModel) -> tuple[str, ...]:
    content = model.content
    items = "".join(f"<li>{_change(c)}</li>" for c in content["difference"])
    parent = content["parent"]
    return (
        "The next model",
        f"<p>Version {content['version']} follows version {parent['version']} "
        f"({escape(parent['source'])}). Prediction, tables and compensation from "
        "<code>model.json</code> have in them what belongs to the machine.</p>",
        f"<ul>{items}</ul>"
        if items
        else "<p>No number changed by more than its U.</p>",
        "<p class=note>A number is listed where it changed by more than its expanded "
        "uncertainty.</p>",
    )


def _change(change: dict[str, Any]) -> str:
    return f"{escape(change['kind'])}: {escape(change['text'])}"


def _documentation(found: Discovery, model: NextModel) -> tuple[str, ...]:
    provenance = model.content["provenance"]
    pairs = [
        ("Software", f"truepath {escape(provenance['software_version'])}"),
        ("Runs", escape(_names(found))),
        ("Input", f"<code>{escape(provenance['input_sha256'])}</code>"),
        (
            "Cells",
            f"{sum(len(scene.seen) for scene in found.scenes)} of "
            f"{sum(scene.seen.used for scene in found.scenes)} samples",
        ),
        ("Looked for", f"{found.compared} effects of the installed catalogue"),
    ]
    return ("Documentation", facts(pairs))


def _footer(model: NextModel) -> str:
    software = escape(model.content["provenance"]["software_version"])
    return (
        f"<footer>truepath {software} · uncertainties in this report are expanded, "
        "k = 2 (about 95 %); those in the files are standard, k = 1</footer>\n"
    )
