"""A plan as a page and files: uncertainty over time, and what is not determined."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from markupsafe import Markup

from truepath.answers.comparison.model_difference import format_text
from truepath.answers.plan.plan_document import plan_document
from truepath.answers.shown.chart import (
    NUMBER,
    WIDTH,
    Colour,
    Scale,
    draw_curve,
    draw_image,
    draw_segments,
    write_label,
)
from truepath.answers.shown.page import SIGN, render_page
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.files.bundle.commanded_file import encode_commanded
from truepath.files.earlier.verdict import verdict_from_json
from truepath.kinematics.effects.family import find_family
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.nc_programs.programs import (
    list_dialects,
    name_file,
    write_program,
)
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_rows
from truepath.planning.plan import Plan
from truepath.plugins import PluginFailed
from truepath_drivers.interfaces.records import Path

_HEIGHT, _LEFT, _TOP, _RIGHT, _BOTTOM = 240.0, 58.0, 14.0, 12.0, 34.0
_TICKS = 5
POINTS, PATH, PLAN = "points.csv", "path.csv", "plan.json"


def render_plan_report(document: Mapping[str, Any]) -> str:
    """One HTML page of a plan's JSON."""
    predicted, target = document["predicted"], document["target"]
    return render_page(
        "plan.html",
        {
            "machine": document["machine"]["name"],
            "verdict": verdict_from_json(document["verdict"]),
            "mode": document["mode"],
            "rows": document["rows"],
            "minutes": f"{document['duration_s'] / 60.0:.1f}",
            "uncertainty_um": predicted["expanded_volumetric_uncertainty_um"],
            "target": target,
            "curve": _draw_curve(document["curve"]),
            "errors": [
                (symbol, f"{2.0 * sigma:.2f}", SIGN[key.removeprefix("uncertainty_")])
                for symbol, error in predicted["errors"].items()
                for key, sigma in error.items()
            ],
            "effects": [_state_effect(effect) for effect in predicted["effects"]],
            "unobservable": document["unobservable"],
            "stations": document["stations"],
            "tracker_errors": predicted["tracker_errors"],
            "feeds": explain_feeds(document),
        },
    )


def explain_feeds(document: Mapping[str, Any]) -> list[str]:
    """Reason for the feeds of a plan, and assumed properties of the machine."""
    choice, motion = document.get("feed_choice"), document.get("motion")
    why = [choice["reason"]] if choice else []
    return why + (motion["assumed"] if motion else [])


def _state_effect(effect: Mapping[str, Any]) -> tuple[str, ...]:
    keys = {k: v for k, v in effect.items() if isinstance(v, str) and k != "name"}
    numbers = (
        "; ".join(
            format_text(name, number["value"], number["uncertainty"])
            for name, number in effect[when].items()
        )
        for when in ("known_before", "parameters")
    )
    return find_family(effect["name"]).title(keys), *numbers


def _draw_curve(points: Sequence[Mapping[str, float]]) -> Markup:
    time_s = np.array([p["time_s"] for p in points])
    expanded_um = np.array([p["expanded_volumetric_uncertainty_um"] for p in points])
    low = math.floor(math.log10(expanded_um.min()))
    high = max(math.ceil(math.log10(expanded_um.max())), low + 1)
    right, bottom = WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    x = Scale(0.0, float(time_s.max()), _LEFT, right)
    y = Scale(10.0**low, 10.0**high, bottom, _TOP, logarithmic=True)
    parts: list[Markup] = []
    decades = np.array([10.0**power for power in range(low, high + 1)])
    for decade, level in zip(decades.tolist(), y.place(decades).tolist(), strict=True):
        ends = (_LEFT, level), (right, level)
        parts.append(draw_segments(*ends, Colour.RULE, width=0.6))
        at = _LEFT - 6.0, level + 3.0
        parts.append(write_label(*at, f"{decade:g}", size=NUMBER, anchor="end"))
    ticks_s = np.linspace(0.0, x.high, _TICKS)
    for tick_s, at in zip(ticks_s.tolist(), x.place(ticks_s).tolist(), strict=True):
        text = f"{tick_s / 60.0:.1f}"
        parts.append(write_label(at, bottom + 13.0, text, size=NUMBER, anchor="middle"))
    middle = (_LEFT + right) / 2.0, _HEIGHT - 6.0
    parts += [
        draw_curve(x.place(time_s), y.place(expanded_um), Colour.ACCENT, width=1.8),
        write_label(*middle, "min", anchor="middle"),
        write_label(12.0, _HEIGHT / 2.0, "µm (k = 2)", anchor="middle", upright=False),
    ]
    title = "Predicted volumetric uncertainty during the measurement"
    return draw_image(_HEIGHT, title, parts)


def write_plan(
    planned: Plan, folder: FilePath, controls: Sequence[str] = ()
) -> dict[str, Any]:
    """Write the files of a plan; the result is the content of `plan.json`.

    Rows and programs of several stations are in a folder each.

    controls : whose NC programs are written; of all where left out

    Raises BadInput, nothing written, if a control cannot execute the plan.
    """
    files: dict[str, bytes] = {}
    for number, plan in enumerate(planned.at_stations, start=1):
        place = f"station-{number}/" if planned.further else ""
        files |= {
            place + name: content
            for name, content in _encode_rows(plan, controls).items()
        }
    document = plan_document(planned) | {"files": [*files, "plan.json", "plan.html"]}
    files["plan.json"] = encode_json(document, indent=1)
    files["plan.html"] = render_plan_report(document).encode()
    write_files(folder, files)
    return document


def _encode_rows(plan: Plan, controls: Sequence[str]) -> dict[str, bytes]:
    feed = plan.order.feeds(plan.machine)[0]
    return encode_with_programs(plan.commanded, plan.machine, controls, feed)


def encode_with_programs(
    commanded: Commanded,
    machine: Machine,
    controls: Sequence[str] = (),
    feed: float = DEFAULT_FEED_MM_MIN,
) -> dict[str, bytes]:
    """The rows, and their program for each control, by file name.

    Of a path with arcs, for each that drives them; another that is requested refuses.
    """
    is_path = isinstance(commanded, Path)
    files = {PATH if is_path else POINTS: encode_commanded(commanded)}
    has_arcs = is_path and any(commanded.arc)
    for control in controls or list_dialects(with_arcs=has_arcs):
        # One that was not requested is left out where it fails.
        with nullcontext() if controls else suppress(PluginFailed):
            text = write_program(commanded, machine, control, feed_mm_min=feed)
            files[f"{control}/{name_file(text, control)}"] = text.encode()
    return files


def write_verification_plan(
    machine: Machine,
    kinds: Sequence[VerificationKind],
    seed: int,
    folder: FilePath,
    controls: Sequence[str] = (),
) -> dict[str, Any]:
    """Write rows, programs and `plan.json`; the result is the content of the last.

    The rows are `points.csv`, of circles in motion `path.csv`.

    controls : whose NC programs are written; of all where left out
    """
    points = make_verification_rows(machine, kinds, seed)
    feed = min(DEFAULT_FEED_MM_MIN, machine.motion.max_feed_mm_min)
    files = encode_with_programs(points, machine, controls, feed)
    row_s = row_times_s(points, feed, machine.motion)
    document = {
        "schema": "verification-plan/1",
        "machine": machine.name,
        "what": [kind.value for kind in VerificationKind if kind in kinds],
        "seed": seed,
        "rows": len(points),
        "duration_s": float(row_s.sum()),
        "files": [*files, PLAN],
    }
    write_files(folder, {**files, PLAN: encode_json(document)})
    return document
