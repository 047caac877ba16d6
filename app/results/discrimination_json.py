"""What to drive next, and why: the key `ask` of `discovery.json`."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.planning.discrimination import Question
from app.planning.discrimination_lines import DECIDED, DiscriminationDesign
from drivers.interfaces.records import Path


def ask_json(asked: DiscriminationDesign, file: str) -> dict[str, Any]:
    """Return the questions, the lines that decide them, and the reason in words.

    file : the `path.csv` of the lines, beside `discovery.json`; `rows` are the same, as
        a measuring job takes them for its path
    """
    return {
        "reason": reason(asked),
        "questions": [
            {"between": [question.left, question.right], "expected_log_bayes": told}
            for question, told in zip(asked.questions, asked.expected, strict=True)
        ],
        "decides": asked.decides,
        "path": file,
        "rows": _rows(asked.path),
        "lines": asked.lines,
        "duration_s": asked.duration_s,
    }


def _rows(path: Path) -> list[dict[str, float | str]]:
    """Return the rows of the path with the columns of `path.csv`."""
    columns = [
        f"{name.lower()}_{'mm' if name in 'XYZ' else 'deg'}" for name in path.axes
    ]
    rows: list[dict[str, float | str]] = []
    for k, place in enumerate(path.position.tolist()):
        row = dict(zip(columns, place, strict=True))
        row |= {"feed_mm_min": float(path.feed_mm_min[k])}
        row |= {"dwell_s": float(path.dwell_s[k])}
        rows.append({**row, **({"target": path.target[k]} if path.target else {})})
    return rows


def reason(asked: DiscriminationDesign) -> str:
    """Return why the lines are to be driven, and what they are."""
    step = np.sign(np.diff(asked.path.position, axis=0))
    turns = int(np.sum((step[1:] * step[:-1] < 0.0).any(axis=1)))
    feeds = sorted({round(float(f)) for f in asked.path.feed_mm_min[1:]})
    told = min(asked.expected)
    enough = "decides" if asked.decides else f"is less than the {DECIDED:.0f} wanted"
    return (
        f"{'; '.join(_open(q) for q in asked.questions)}. {asked.lines} lines in "
        f"{asked.duration_s:.0f} s, {turns} of them turning back, at "
        f"{', '.join(str(f) for f in feeds)} mm/min are expected to bring a log Bayes "
        f"factor of {told:.0f}, which {enough}."
    )


def _open(question: Question) -> str:
    if not question.right:
        return f"the evidence for {question.left} is thin"
    return f"{question.left} and {question.right} explain the measurement alike"
