"""The report of a discovery: one HTML page that needs no other.

It shows where simulation and measurement disagree, which effects explain it, which
others explain it as well, the lines that would decide, and the gap before and after on
held-out lines. Uncertainties are expanded (k = 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from shutil import rmtree

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.calibration_report import REPORT
from truepath.answers.discovery import ASK, Discovered, NextModel
from truepath.answers.discovery_json import (
    describe_alternatives,
    describe_remedy,
    describe_undetermined,
    explain_proposal,
    format_title,
    list_unexplained,
)
from truepath.answers.model_difference import format_parameter
from truepath.answers.plan_report import encode_with_programs
from truepath.answers.shown.chart import (
    EDGE,
    LEFT,
    NUMBER,
    TOP,
    WIDTH,
    Colour,
    Frame,
    Scale,
    draw_curve,
    draw_image,
    draw_label,
    draw_segments,
    fill_box,
    join_shapes,
    make_panel,
)
from truepath.answers.shown.page import View, format_number, render_page
from truepath.discovery.discover import Discovery
from truepath.discovery.discrimination import DECIDED, DiscriminationDesign
from truepath.discovery.findings import Finding, Gap
from truepath.discovery.residual_location import (
    Covariate,
    RunResidual,
    Segment,
    list_covariates,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.motion.nc_programs.programs import list_dialects

_HEIGHT, _ROW = 104.0, 150.0
_BARS, _NAMES = 16.0, 130.0
_HALF = 12.0  # of the level of a class
_POINTS, _BINS, _PROFILES = 240, 24, 6
_COLOURS = (Colour.ACCENT, Colour.SECOND, Colour.THIRD)


def render_discovery_report(
    discovery: Discovery,
    model: NextModel,
    design: DiscriminationDesign | None,
    ask_file: str,
) -> str:
    """One HTML page.

    design : lines to measure next, in `ask_file` next to it; None if no question is
        open
    """
    named = [f for f in discovery.findings if f.structure is None]
    provenance, parent = model.content["provenance"], model.content["parent"]
    created, gap = datetime.fromisoformat(provenance["created"]), discovery.gap
    return render_page(
        "discovery.html",
        {
            "machine": discovery.baseline.model.machine.name,
            "names": discovery.run_names,
            "verdict": model.verdict,
            "parent": parent,
            "created": f"{created:%Y-%m-%d %H:%M} UTC",
            "titles": [format_title(f.candidate) for f in named],
            "findings": [_describe_finding(f, model) for f in named],
            "possible": [_describe_finding(f, model) for f in discovery.possible],
            "unnamed": _describe_unnamed(discovery),
            "cannot_tell": [
                describe_undetermined(one) for one in discovery.undetermined
            ],
            "compared": discovery.compared,
            "ask": None if design is None else describe_proposal(design, ask_file),
            "gap": {
                "before_um": format_number(gap.before_um, 2),
                "after_um": format_number(gap.after_um, 2),
                "noise_um": format_number(gap.noise_floor_um, 2),
                "expected_um": format_number(gap.expected_um, 2),
                "is_closed": gap.after_um <= 1.05 * gap.expected_um,
                "excess": 100.0 * (gap.after_um / max(gap.expected_um, 1e-12) - 1.0),
                "figure": _draw_gap(gap),
            },
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


def describe_proposal(design: DiscriminationDesign, file: str) -> View:
    """The open questions, and the lines that decide them.

    file : the path of the lines, next to the report
    """
    path, questions = design.path, zip(design.questions, design.expected, strict=True)
    return {
        "reason": explain_proposal(design),
        "decides": design.decides,
        "questions": [
            (
                f"{q.left}, or {q.right}?" if q.right else f"Is there {q.left}?",
                format_number(factor),
            )
            for q, factor in questions
        ],
        "decided": f"{DECIDED:.0f}",
        "axes": [f"{n}, {'mm' if n in 'XYZ' else '°'}" for n in path.axes],
        "rows": [
            (
                str(number),
                *(format_number(value, 3) for value in position),
                format_number(path.feed_mm_min[number - 1], 0) if number > 1 else "–",
                format_number(path.dwell_s[number - 1], 2),
            )
            for number, position in enumerate(path.position, start=1)
        ],
        "file": file,
    }


def _describe_finding(finding: Finding, model: NextModel) -> View:
    evidence = finding.evidence
    return {
        "title": format_title(finding.candidate),
        "grade": finding.grade,
        "numbers": "; ".join(
            format_parameter(name, number.value, number.uncertainty)
            for name, number in finding.parameters.items()
        ),
        "words": finding.family.words["en"],
        "remedy": describe_remedy(finding),
        "share": format_number(100 * evidence.share, 0),
        "log_bayes": format_number(evidence.log_bayes),
        "held_out": format_number(evidence.held_out),
        "others": describe_alternatives(finding),
        "is_machine": model.extended.holds(finding),
    }


def _describe_unnamed(discovery: Discovery) -> list[View]:
    described = [
        {
            "text": f.structure.describe(f.candidate, f.parameters),
            "share": format_number(100 * f.evidence.share, 0),
            "words": f.structure.words["en"],
        }
        for f in discovery.findings
        if f.structure is not None
    ]
    left = [
        {"text": one["description"], "words": None}
        for one in list_unexplained(discovery)
    ]
    return [*described, *left]


def _describe_run(residual: RunResidual) -> View:
    before, after = residual.before, residual.after
    return {
        "observer": residual.observations.at.observer,
        "along": _draw_along_run(residual),
        "shares": _draw_shares(before.shares, after.shares),
        "by_line": _draw_by_line(before.segments, after.segments),
        "profiles": _draw_profiles(residual),
        "worst": [
            (
                str(segment.row + 1),
                f"{segment.axis}{segment.direction}".replace("-", "−") or "at rest",
                segment.region,
                format_number(segment.time_s),
                format_number(segment.feed_mm_min, 0),
                format_number(segment.rms_um, 2),
            )
            for segment in before.segments[:8]
        ],
    }


def write_discovery(discovered: Discovered, folder: str | Path) -> None:
    """Report, `ask/path.csv` with its programs, `model.json` and `discovery.json`."""
    found, proposal = discovered.found, discovered.proposal
    report = render_discovery_report(found, discovered.model, proposal, ASK)
    files = {REPORT: report.encode()}
    place = Path(ASK).parent
    # Lines that an earlier discovery asked for; what was recorded there stays.
    (Path(folder) / ASK).unlink(missing_ok=True)
    for control in list_dialects():
        rmtree(Path(folder) / place / control, ignore_errors=True)
    if proposal is not None:
        rows = encode_with_programs(proposal.path, found.aligned[0].run.machine)
        files |= {str(place / name): content for name, content in rows.items()}
    # The discovery last: where it exists, the others exist as well.
    files["model.json"] = encode_json(discovered.model.content)
    files["discovery.json"] = encode_json(discovered.content)
    write_files(Path(folder), files)


def _draw_gap(gap: Gap) -> Markup:
    frame = Frame(60.0, 20.0, WIDTH - 60.0, 68.0)
    high = 1.1 * max(gap.before_um, gap.after_um, gap.noise_floor_um)
    x = Scale(0.0, high, frame.left, frame.right)
    rows = (
        ("before", gap.before_um, Colour.MUTED),
        ("after", gap.after_um, Colour.ACCENT),
    )
    parts: list[Markup] = []
    for row, (name, value, colour) in enumerate(rows):
        top, end = frame.top + 26.0 * row, _place(x, value)
        parts += [
            draw_label(
                frame.left - 6.0, top + 13.0, name, anchor="end", colour=Colour.INK
            ),
            fill_box(frame.left, top, end - frame.left, 18.0, colour),
            draw_label(end + 5.0, top + 13.0, f"{value:.2f} µm", colour=Colour.INK),
        ]
    floor = _place(x, gap.noise_floor_um)
    ends = (floor, frame.top - 5.0), (floor, frame.bottom)
    noise = f"noise {gap.noise_floor_um:.2f} µm"
    parts += [
        draw_segments(*ends, Colour.SECOND, width=1.4, dash="4 2"),
        draw_label(floor, frame.top - 9.0, noise, anchor="middle"),
    ]
    return draw_image(76.0, "Gap on held-out lines, before and after", parts)


def _draw_along_run(residual: RunResidual) -> Markup:
    observations = residual.observations
    time_s = observations.at.time_s - observations.at.time_s.min()
    edges = np.linspace(0.0, float(time_s.max()) + 1e-9, _POINTS + 1)
    drawn = [
        _bin_means(time_s, 1e3 * residual_mm, observations.count, edges)
        for residual_mm in (residual.before.residual_mm, residual.after.residual_mm)
    ]
    reach = 1.05 * max(float(np.abs(mean).max()) for _, mean in drawn)
    parts: list[Markup] = []
    for row, ((at, mean), title) in enumerate(
        zip(drawn, ("Residual along the run, before", "After"), strict=True)
    ):
        top = TOP + 136.0 * row
        frame = Frame(LEFT, top, WIDTH - EDGE, top + _HEIGHT)
        x = frame.make_x(0.0, float(edges[-1]))
        label = "time, s" if row else ""
        parts.append(_draw_components(frame, x, at, mean, reach, title, label))
    for number, (name, colour) in enumerate(zip("XYZ", _COLOURS, strict=True)):
        left, y = WIDTH - EDGE - 84.0 + 28.0 * number, TOP - 8.0
        parts.append(draw_segments((left, y), (left + 12.0, y), colour, width=1.6))
        parts.append(draw_label(left + 15.0, y + 2.7, name, colour=Colour.INK))
    return draw_image(TOP + 136.0 + _HEIGHT + 28.0, "Residual along the run", parts)


def _draw_by_line(before: Sequence[Segment], after: Sequence[Segment]) -> Markup:
    frame = Frame(LEFT, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    rows = np.array([s.row + 1 for s in before], float)
    high = 1.05 * max(s.rms_um for s in (*before, *after))
    x = frame.make_x(float(rows.min()), float(rows.max()), margin=0.02)
    y = frame.make_y(0.0, high, margin=0.0)
    width = float(np.clip(220.0 / len(rows), 0.5, 3.0))
    parts = [
        frame.draw_title("By line: before and, on top of it, after"),
        frame.draw_axes(x, y, "row of the path", "rms, µm", upright=False),
    ]
    for states, colour in ((before, Colour.MUTED), (after, Colour.ACCENT)):
        at = x.place(np.array([s.row + 1 for s in states], float))
        rms = y.place(np.array([s.rms_um for s in states]))
        foot = np.full(len(at), frame.bottom)
        ends = np.column_stack([at, foot]), np.column_stack([at, rms])
        parts.append(draw_segments(*ends, colour, width=width))
    return draw_image(TOP + _HEIGHT + 28.0, "Residual by line before and after", parts)


def _draw_shares(before: dict[str, float], after: dict[str, float]) -> Markup:
    frame = Frame(_NAMES, 8.0, WIDTH - 110.0, 8.0 + _BARS * len(before))
    x = Scale(0.0, max(max(before.values()), 0.05), frame.left, frame.right)
    parts: list[Markup] = []
    for row, (name, share) in enumerate(before.items()):
        top = frame.top + _BARS * row
        end, rest = _place(x, share), after.get(name, 0.0)
        parts += [
            draw_label(
                frame.left - 6.0, top + 9.0, name, anchor="end", colour=Colour.INK
            ),
            fill_box(frame.left, top, end - frame.left, 6.0, Colour.MUTED),
            fill_box(
                frame.left, top + 6.0, _place(x, rest) - frame.left, 5.0, Colour.ACCENT
            ),
            draw_label(
                max(end, _place(x, rest)) + 5.0,
                top + 9.0,
                f"{100 * share:.0f} %, after {100 * rest:.0f} %",
                size=NUMBER,
            ),
        ]
    return draw_image(frame.bottom + 4.0, "Share explained by each grouping", parts)


def _draw_profiles(residual: RunResidual) -> Markup:
    by_name = {c.name: c for c in list_covariates(residual.observations)}
    chosen = [by_name[name] for name in residual.before.shares if name in by_name][
        :_PROFILES
    ]
    parts: list[Markup] = []
    for number, covariate in enumerate(chosen):
        frame = make_panel(*divmod(number, 3), _HEIGHT, _ROW)
        parts.append(_draw_profile(frame, residual, covariate))
    rows = -(-len(chosen) // 3)
    return draw_image(TOP + _ROW * (rows - 1) + _HEIGHT + 28.0, "Profiles", parts)


def _draw_profile(frame: Frame, residual: RunResidual, covariate: Covariate) -> Markup:
    observations = residual.observations
    edges = np.unique(np.quantile(covariate.values, np.linspace(0.0, 1.0, _BINS + 1)))
    if len(edges) <= _BINS // 2:  # few values: a bin for each
        own = np.unique(covariate.values)
        middle = 0.5 * (own[1:] + own[:-1])
        edges = np.concatenate([[own[0] - 1.0], middle, [own[-1] + 1.0]])
    edges[-1] += 1e-9 * max(abs(float(edges[-1])), 1.0)
    at, mean = _bin_means(
        covariate.values, 1e3 * residual.before.residual_mm, observations.count, edges
    )
    reach = 1.05 * max(float(np.abs(mean).max()), 0.1)
    low, high = float(covariate.values.min()), float(covariate.values.max())
    x = frame.make_x(low, high, margin=0.03)
    if covariate.names:
        own = np.unique(covariate.values).tolist()
        x = replace(
            frame.make_x(low, high, margin=0.5),
            names={value: covariate.names[value] for value in own},
        )
    return _draw_components(frame, x, at, mean, reach, covariate.name, covariate.label)


def _draw_components(
    frame: Frame,
    x: Scale,
    at: Float64[np.ndarray, " b"],
    mean: Float64[np.ndarray, "b 3"],
    reach: float,
    title: str,
    label: str,
) -> Markup:
    y = frame.make_y(-reach, reach)
    return join_shapes(
        [
            frame.draw_title(title),
            frame.draw_axes(x, y, label, "µm"),
            *(
                draw_segments(
                    np.column_stack([x.place(at) - _HALF, y.place(component)]),
                    np.column_stack([x.place(at) + _HALF, y.place(component)]),
                    colour,
                    width=2.0,
                )
                if x.names
                else draw_curve(x.place(at), y.place(component), colour, width=1.1)
                for component, colour in zip(mean.T, _COLOURS, strict=True)
            ),
        ]
    )


def _bin_means(
    at: Float64[np.ndarray, " n"],
    values: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    edges: Float64[np.ndarray, " e"],
) -> tuple[Float64[np.ndarray, " b"], Float64[np.ndarray, "b 3"]]:
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    total = np.bincount(index, weight, len(edges) - 1)
    filled = total > 0.0
    sums = [np.bincount(index, weight * v, len(total)) for v in (at, *values.T)]
    place, *means = (s[filled] / total[filled] for s in sums)
    return place, np.stack(means, axis=1)


def _place(scale: Scale, value: float) -> float:
    return float(scale.place(np.array([value]))[0])
