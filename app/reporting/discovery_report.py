"""The report of a discovery: one HTML page that needs no other.

It shows where simulation and measurement disagree, which effects explain it, which
others explain it as well, the lines that would decide, and the gap before and after on
held-out lines. Uncertainties are expanded (k = 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from truepath.app.discovery.discover import Discovery
from truepath.app.discovery.findings import Finding
from truepath.app.discovery.residual_location import RunResidual, Segment
from truepath.app.files.commanded_file import encode_commanded
from truepath.app.files.file_model import encode_json
from truepath.app.files.whole_files import write_files
from truepath.app.planning.discrimination import DECIDED, DiscriminationDesign, Question
from truepath.app.reporting.analysis_files import REPORT
from truepath.app.reporting.discovery_figures import (
    draw_along_run,
    draw_by_line,
    draw_gap,
    draw_profiles,
    draw_shares,
)
from truepath.app.reporting.templating import View, render_page
from truepath.app.results.discovery import ASK, Discovered
from truepath.app.results.discovery_json import (
    describe_alternatives,
    explain,
    write_title,
)
from truepath.app.results.model_difference import in_words
from truepath.app.results.model_file import NextModel
from truepath.app.results.number_format import format_number

CLOSED = 1.05  # gap over noise up to which the model explains the Run
_WORST = 8


def render_discovery_report(
    discovery: Discovery,
    model: NextModel,
    design: DiscriminationDesign | None,
    ask_file: str,
) -> str:
    """Return the report.

    design : lines to drive next, in `ask_file` beside it; None if no question is open
    """
    named = [f for f in discovery.findings if f.structure is None]
    provenance, parent = model.content["provenance"], model.content["parent"]
    created = datetime.fromisoformat(provenance["created"])
    return render_page(
        "discovery.html",
        {
            "machine": discovery.baseline.model.machine.name,
            "names": discovery.run_names,
            "verdict": model.verdict,
            "parent": parent,
            "created": f"{created:%Y-%m-%d %H:%M} UTC",
            "titles": [write_title(f.candidate) for f in named],
            "findings": [_describe_finding(f, discovery, model) for f in named],
            "possible": [
                _describe_finding(f, discovery, model) for f in discovery.possible
            ],
            "unnamed": _describe_unnamed(discovery.findings),
            "compared": discovery.compared,
            "ask": None if design is None else describe_ask(design, ask_file),
            "gap": _describe_gap(discovery),
            "runs": [
                {"name": aligned.run.name, **_describe_run(residual)}
                for aligned, residual in zip(
                    discovery.aligned, discovery.residuals, strict=True
                )
            ],
            "version": model.content["version"],
            "changes": [
                f"{change['kind']}: {change['text']}"
                for change in model.content["difference"]
            ],
            "software": provenance["software_version"],
            "digest": provenance["input_sha256"],
            "cells": sum(len(one.observations) for one in discovery.aligned),
            "samples": sum(one.observations.used for one in discovery.aligned),
        },
    )


def describe_ask(design: DiscriminationDesign, file: str) -> View:
    """Return the open questions, and the lines that decide them.

    file : the path of the lines, beside the report
    """
    questions = zip(design.questions, design.expected, strict=True)
    return {
        "reason": explain(design),
        "decides": design.decides,
        "questions": [
            (_word_question(q), format_number(factor)) for q, factor in questions
        ],
        "decided": f"{DECIDED:.0f}",
        "axes": [f"{n}, {'mm' if n in 'XYZ' else '°'}" for n in design.path.axes],
        "rows": _list_waypoints(design),
        "file": file,
    }


def _describe_finding(finding: Finding, discovery: Discovery, model: NextModel) -> View:
    evidence = finding.evidence
    return {
        "title": write_title(finding.candidate),
        "grade": finding.grade,
        "numbers": "; ".join(
            in_words(name, number.value, number.uncertainty)
            for name, number in finding.parameters.items()
        ),
        "words": finding.family.words["en"],
        "share": format_number(100 * evidence.share, 0),
        "log_bayes": format_number(evidence.log_bayes),
        "held_out": format_number(evidence.held_out),
        "others": describe_alternatives(finding),
        "is_machine": model.extended.holds(finding),
    }


def _describe_unnamed(findings: Sequence[Finding]) -> list[View]:
    return [
        {
            "text": f.structure.describe(f.candidate, f.parameters),
            "share": format_number(100 * f.evidence.share, 0),
            "words": f.structure.words["en"],
        }
        for f in findings
        if f.structure is not None
    ]


def _describe_gap(discovery: Discovery) -> View:
    gap = discovery.gap
    return {
        "before_um": format_number(gap.before_um, 2),
        "after_um": format_number(gap.after_um, 2),
        "noise_um": format_number(gap.noise_floor_um, 2),
        "expected_um": format_number(gap.expected_um, 2),
        "is_closed": gap.after_um <= CLOSED * gap.expected_um,
        "excess": 100.0 * (gap.after_um / max(gap.expected_um, 1e-12) - 1.0),
        "figure": draw_gap(gap),
    }


def _describe_run(residual: RunResidual) -> View:
    before, after = residual.before, residual.after
    return {
        "observer": residual.observations.at.observer,
        "along": draw_along_run(residual),
        "shares": draw_shares(before.shares, after.shares),
        "by_line": draw_by_line(before.segments, after.segments),
        "profiles": draw_profiles(residual),
        "worst": [_state_segment(s) for s in before.segments[:_WORST]],
    }


def _state_segment(segment: Segment) -> tuple[str, ...]:
    return (
        str(segment.row),
        f"{segment.axis}{segment.direction}".replace("-", "−") or "at rest",
        segment.region,
        format_number(segment.time_s),
        format_number(segment.feed_mm_min, 0),
        format_number(segment.rms_um, 2),
    )


def _word_question(question: Question) -> str:
    if not question.right:
        return f"Is there {question.left}?"
    return f"{question.left}, or {question.right}?"


def _list_waypoints(design: DiscriminationDesign) -> list[tuple[str, ...]]:
    """Return the waypoints; the lines begin at the first."""
    path = design.path
    return [
        (
            str(number),
            *(format_number(value, 3) for value in position),
            format_number(path.feed_mm_min[number - 1], 0) if number > 1 else "–",
            format_number(path.dwell_s[number - 1], 2),
        )
        for number, position in enumerate(path.position, start=1)
    ]


DISCOVERY, MODEL = "discovery.json", "model.json"


def write_discovery(discovered: Discovered, folder: str | Path) -> None:
    """Write the files of a discovery into a folder, each whole or not at all."""
    found, asked = discovered.found, discovered.asked
    report = render_discovery_report(found, discovered.model, asked, ASK)
    files = {REPORT: report.encode()}
    if asked is None:
        (Path(folder) / ASK).unlink(missing_ok=True)  # that of an earlier discovery
    else:
        files[ASK] = encode_commanded(asked.path)
    # The discovery last: where it stands, the others stand as well.
    files[MODEL] = encode_json(discovered.model.content)
    files[DISCOVERY] = encode_json(discovered.content)
    write_files(Path(folder), files)
