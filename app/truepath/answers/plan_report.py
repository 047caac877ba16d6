"""A plan as `plan.json` (schema `plan/1` of the file formats), page and programs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.model_difference import format_parameter
from truepath.answers.shown.chart import (
    NUMBER,
    WIDTH,
    Colour,
    Scale,
    draw_curve,
    draw_image,
    draw_label,
    draw_segments,
)
from truepath.answers.shown.page import SIGN, render_page
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.files.bundle.commanded_file import encode_commanded
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.earlier.verdict import Verdict, verdict_from_json, verdict_json
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.effects.family import find_family
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    describe_symbol,
    find_unit,
    is_location,
)
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.nc_programs.programs import list_dialects, name_file, write_program
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_rows
from truepath.planning.grade import sample_sigma_mm, verdict
from truepath.planning.line_suggestions import SetUpRemedy
from truepath.planning.plan import Plan
from truepath.planning.stations.station_information import StationVariance
from truepath.planning.stations.station_selection import StationAdvice, StationOption
from truepath.plugins import PluginFailed
from truepath.results.updated_effects import prior_model_json, state_predicted_effects
from truepath_drivers.interfaces.records import Path

_K = 2.0  # of uncertainties in sentences
_ORDINAL = {2: "second", 3: "third"}
_HEIGHT, _LEFT, _TOP, _RIGHT, _BOTTOM = 240.0, 58.0, 14.0, 12.0, 34.0
_TICKS = 5


def plan_document(planned: Plan) -> dict[str, Any]:
    """Content of `plan.json`: µm, µrad and s, k = 1 unless the key says otherwise."""
    order, found = planned.order, planned.outcome
    target_um, model = order.target_um, order.model
    errors: dict[str, dict[str, float]] = {}
    for symbol, sigma in planned.forecast.motion_sigmas().items():
        single = symbol in SQUARENESS or is_location(symbol)
        unit = find_unit(symbol) if single or symbol.startswith("E") else "um"
        errors[symbol] = {f"uncertainty_{unit}": sigma * scale_of(unit)}
    return {
        "schema": "plan/1",
        "machine": machine_to_json(planned.machine),
        "mode": order.mode,
        "rows": sum(len(plan.commanded) for plan in planned.at_stations),
        "duration_s": round(sum(p.duration_s for p in planned.at_stations), 3),
        "corner_path": order.corner_path,
        "perpendicular_only": order.perpendicular_only,
        "feeds_mm_min": _choose_feeds(planned),
        "motion": _motion_json(planned.machine),
        "feed_choice": _explain_feeds(planned),
        "model": model and prior_model_json(model),
        "verdict": verdict_json(Verdict() if model is None else model.assess_use()),
        "tracker": {
            "position_mm": _round(planned.station_mm),
            "assumed": order.workspace.tracker_mm is None,
            "chosen": planned.stations is not None and planned.stations.chosen,
        },
        "stations": planned.stations and _stations_json(planned.stations),
        "at_stations": [
            {
                "position_mm": _round(plan.station_mm),
                "rows": len(plan.commanded),
                "duration_s": round(plan.duration_s, 3),
                **_both_uncertainties(plan.uncertainty_um),
            }
            for plan in planned.at_stations
        ]
        if planned.further
        else None,
        "predicted": {
            **_both_uncertainties(planned.uncertainty_um),
            "errors": errors,
            "effects": state_predicted_effects(found),
            "servo_mismatch": {
                axis: {"uncertainty_ms": 1e3 * sigma}
                for axis, sigma in planned.lag_sigma_s.items()
            },
            "tracker_errors": _tracker_errors_json(planned),
        },
        "target": None
        if target_um is None
        else {**_both_uncertainties(target_um), "reached": planned.reached},
        "curve": list(_trace_curve(planned)),
        "unobservable": _list_unobservable(planned),
    }


def _tracker_errors_json(planned: Plan) -> dict[str, Any] | None:
    """Share of the tracker's errors, and the changes of set-up that reduce it."""
    random_um = UM_PER_MM * planned.outcome.random_mm
    if not planned.remedies:
        return None
    total_um = planned.uncertainty_um
    sentences = [
        f"with a perfect tracker U would be {_K * random_um:.2f} µm; the rest of "
        f"{_K * total_um:.2f} µm is what the tracker and its knowledge of the air may "
        "be off by, which no time averages"
    ]
    for one in planned.remedies:
        way = {
            "second-place": f"from {_point(one.place_mm)}",
            "turned-base": f"with its base turned by {math.degrees(one.turn_rad):.0f}°",
            "other-face": "in its other face",
        }[one.change]
        sentences.append(
            f"the same rows once more {way} leave {_um(one)}, for "
            f"{one.added_s / 60.0:.0f} min more"
        )
    return {
        "random_um": random_um,
        "systematic_um": max(total_um**2 - random_um**2, 0.0) ** 0.5,
        "statement": sentences,
        "remedies": [
            {
                "change": one.change,
                "position_mm": _round(one.place_mm),
                "turn_deg": round(math.degrees(one.turn_rad), 3),
                "minutes": one.added_s / 60.0,
                **_both_uncertainties(UM_PER_MM * one.sigma_mm),
                "removed_um_per_minute": UM_PER_MM * 60.0 * one.mm_per_s,
            }
            for one in planned.remedies
        ],
    }


def _trace_curve(planned: Plan) -> Iterator[dict[str, Any]]:
    first_row, begin_s = 0, 0.0
    for plan in planned.at_stations:
        found = plan.forecast
        sample_mm = sample_sigma_mm([run.observations for run in found.stations])
        for step in found.curve:
            number = step.random_mm / sample_mm
            yield {
                "row": first_row + step.row + 1,
                "time_s": round(begin_s + float(plan.time_s[step.row]), 3),
                **_both_uncertainties(UM_PER_MM * step.sigma_mm),
                "grade": {"number": number, "verdict": verdict(number)},
                "weakest": [
                    {"error": name, "at_tool_um": UM_PER_MM * at_tool_mm}
                    for name, at_tool_mm in step.weakest_mm.items()
                ],
            }
        first_row, begin_s = first_row + len(plan.commanded), begin_s + plan.duration_s


def _choose_feeds(planned: Plan) -> list[float]:
    if planned.order.feeds_mm_min:
        return list(planned.order.feeds_mm_min)
    if isinstance(planned.commanded, Path):
        return sorted(set(planned.commanded.feed_mm_min[1:].tolist()), reverse=True)
    return list(planned.order.feeds(planned.machine))


def _motion_json(machine: Machine) -> dict[str, Any]:
    motion, jerk = machine.motion, machine.motion.jerk_mm_s3
    values = {
        "max_feed_mm_min": ("highest feed", f"{motion.max_feed_mm_min:g} mm/min"),
        "acceleration_mm_s2": ("acceleration", f"{motion.acceleration_mm_s2:g} mm/s²"),
    }
    return {
        "max_feed_mm_min": motion.max_feed_mm_min,
        "acceleration_mm_s2": motion.acceleration_mm_s2,
        "jerk_mm_s3": jerk if math.isfinite(jerk) else None,
        "assumed": [
            f"{what} taken to be {value}; state motion.{name} in the machine file"
            for name, (what, value) in values.items()
            if name in motion.assumed
        ],
    }


def _explain_feeds(planned: Plan) -> dict[str, Any] | None:
    path = planned.commanded
    if not planned.feeds_worth or not isinstance(path, Path):
        return None
    feeds = [
        {
            "feed_mm_min": feed,
            "lines": int((path.feed_mm_min[1:] == feed).sum()),
            "relative_information_per_s": round(worth, 3),
        }
        for feed, worth in planned.feeds_worth.items()
    ]
    counted = [f"{f['lines']} at {f['feed_mm_min']:g}" for f in feeds if f["lines"]]
    slower = len(path) - 1 - sum(int(f["lines"]) for f in feeds)
    if slower:
        counted.append(f"{slower} slower, where rotary axes turn or the target changes")
    driven = ", ".join(counted)
    alone = ", ".join(
        f"{f['relative_information_per_s']:.2f} at {f['feed_mm_min']:g}" for f in feeds
    )
    highest = max(planned.feeds_worth)
    machine_feed = planned.machine.motion.max_feed_mm_min
    reason = (
        f"each line has the feed, up to {highest:g} mm/min, at which it tells most a "
        f"second, ramps and dwells included: of {len(path) - 1} lines {driven}; "
        f"with one feed for all a second would tell {alone} times as much"
    )
    if highest < 0.99 * machine_feed:
        reason += (
            f"; at the machine's {machine_feed:g} mm/min too few lines would be long "
            "enough for a steady feed"
        )
    return {"feeds": feeds, "reason": reason}


def _list_unobservable(planned: Plan) -> list[str]:
    sentences = list(planned.forecast.unobservable)
    resting = planned.machine.rotary_axes
    if planned.order.moving(planned.machine).rotary_axes:
        resting = ()
    if resting:
        axes = ", ".join(axis.name for axis in resting)
        sentences.append(
            f"{axes}: rotary axes stand still on this path; their errors show between "
            "standstills (--mode standstill)"
        )
    return sentences


def _both_uncertainties(standard_um: float) -> dict[str, float]:
    return {
        "volumetric_uncertainty_um": standard_um,
        "expanded_volumetric_uncertainty_um": _K * standard_um,
    }


def _stations_json(advice: StationAdvice) -> dict[str, Any]:
    # Uncertainties are standard ones (k = 1).
    return {
        "recommended": len(advice.recommended.place_mm),
        "statement": _describe_stations(advice),
        "move_minutes": advice.move_s / 60.0,
        "judged": advice.judged,
        "best": {"position_mm": _round(advice.best_mm), **_station_json(advice.best)},
        "worst": _station_json(advice.worst),
        "options": [
            {
                "count": len(option.place_mm),
                "position_mm": [_round(place) for place in option.place_mm],
                "minutes": option.total_s / 60.0,
                **_station_json(option.left),
                "one_place_as_long": _station_json(option.stay),
                "pays": option.pays,
                "because": option.reason if option.pays else None,
            }
            for option in advice.options
        ],
    }


def _describe_stations(advice: StationAdvice) -> list[str]:
    first, *further = advice.options
    sentences = [
        f"from {_point(first.place_mm[0])} {_um(first.left)} stay, "
        f"{_K * UM_PER_MM * first.left.systematic_mm:.2f} of them by the tracker's own "
        f"errors; of {advice.judged} places the worst leaves {_um(advice.worst)}"
    ]
    if first.left.seen < 1.0:
        sentences.append(
            f"{first.left.seen:.0%} of the travel are in range and in sight"
        )
    if not advice.chosen and advice.best.sigma_mm < 0.95 * first.left.sigma_mm:
        sentences.append(f"{_point(advice.best_mm)} would leave {_um(advice.best)}")
    sentences += [_compare(option) for option in further]
    count = len(advice.recommended.place_mm)
    sentences.append(f"{count} stations pay" if count > 1 else "one station is enough")
    return sentences


def _compare(option: StationOption) -> str:
    count = len(option.place_mm)
    places = " and ".join(_point(place) for place in option.place_mm[1:])
    text = (
        f"with a {_ORDINAL[count]} station ({places}) {_um(option.left)} after "
        f"{option.total_s / 60.0:.0f} min in all; staying as long leaves "
        f"{_um(option.stay)}"
    )
    if not option.pays:
        return f"{text}: it does not pay"
    return f"{text}: it pays, because {_give_reason(option)}"


def _give_reason(option: StationOption) -> str:
    if option.reason == "sight":
        return (
            f"one place sees {option.stay.seen:.0%} of the travel, these "
            f"{option.left.seen:.0%}"
        )
    if option.reason == "systematic":
        return "the tracker's own errors, which no time averages, differ by the place"
    return f"one place leaves {option.reason} ({describe_symbol(option.reason)}) weak"


def _station_json(left: StationVariance) -> dict[str, float]:
    return {
        "volumetric_uncertainty_um": UM_PER_MM * left.sigma_mm,
        "random_um": UM_PER_MM * left.random_mm,
        "systematic_um": UM_PER_MM * left.systematic_mm,
        "seen": left.seen,
    }


def _um(left: StationVariance | SetUpRemedy) -> str:
    """The expanded uncertainty."""
    return f"{_K * UM_PER_MM * left.sigma_mm:.2f} µm"


def _point(place_mm: Float64[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{v:.0f}' for v in place_mm.tolist())}) mm"


def _round(place_mm: Float64[np.ndarray, "3"]) -> list[float]:
    return [round(v, 3) for v in place_mm.tolist()]


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
            "effects": [_format_effect(effect) for effect in predicted["effects"]],
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


def _format_effect(effect: Mapping[str, Any]) -> tuple[str, ...]:
    keys = {k: v for k, v in effect.items() if isinstance(v, str) and k != "name"}
    numbers = (
        "; ".join(
            format_parameter(name, number["value"], number["uncertainty"])
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
        parts.append(draw_label(*at, f"{decade:g}", size=NUMBER, anchor="end"))
    ticks_s = np.linspace(0.0, x.high, _TICKS)
    for tick_s, at in zip(ticks_s.tolist(), x.place(ticks_s).tolist(), strict=True):
        text = f"{tick_s / 60.0:.1f}"
        parts.append(draw_label(at, bottom + 13.0, text, size=NUMBER, anchor="middle"))
    middle = (_LEFT + right) / 2.0, _HEIGHT - 6.0
    parts += [
        draw_curve(x.place(time_s), y.place(expanded_um), Colour.ACCENT, width=1.8),
        draw_label(*middle, "min", anchor="middle"),
        draw_label(12.0, _HEIGHT / 2.0, "µm (k = 2)", anchor="middle", upright=False),
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
        feed = plan.order.feeds(plan.machine)[0]
        rows = encode_with_programs(plan.commanded, plan.machine, controls, feed)
        files |= {place + name: content for name, content in rows.items()}
    document = plan_document(planned) | {"files": [*files, "plan.json", "plan.html"]}
    files["plan.json"] = encode_json(document, indent=1)
    files["plan.html"] = render_plan_report(document).encode()
    write_files(folder, files)
    return document


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
    files = {"path.csv" if is_path else "points.csv": encode_commanded(commanded)}
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
        "files": [*files, "plan.json"],
    }
    write_files(folder, {**files, "plan.json": encode_json(document)})
    return document
