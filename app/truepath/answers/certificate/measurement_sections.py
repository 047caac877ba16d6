"""Sections on the measurement: method, conditions, path and set-up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from truepath.answers.certificate.issue import Certificate
from truepath.answers.certificate.language import Language
from truepath.answers.certificate.setup_figures import draw_setup
from truepath.answers.shown.page import View
from truepath.documents.file_model import as_object

Run = Mapping[str, Any]
Row = tuple[str, str]
_UNITS = {"degC": "°C", "hPa": "hPa", "percent": "%"}
_QUANTITIES = {"degC": "temperature", "hPa": "pressure", "percent": "humidity"}
_AIR = {"instrument": "instrument", "truepath": "service", "nobody": "nobody"}


def describe_measurement(certificate: Certificate, language: Language) -> View:
    """Method and conditions of each Run, warm-up, and grade of the set-up."""
    runs: list[Run] = certificate.found.content.get("runs", [])
    stated, missing = certificate.identity, language.say("not_stated")
    version = certificate.found.content["provenance"].get("software_version", "")
    rows = [(language.say("procedure"), language.say("procedure_is", version=version))]
    rows += [
        (language.say(f"identity_{name}"), stated.get(name, missing))
        for name in ("deviations", "warm_up")
    ]
    if grade := _describe_grade(certificate.found.content.get("grade"), language):
        rows.append((language.say("grade"), grade))
    return {
        "rows": rows,
        "runs": [_describe_run(run, language) for run in runs],
    }


def describe_setup(certificate: Certificate, language: Language) -> View:
    """Picture of path, tracker and volume; None where nothing is known."""
    runs: list[Run] = certificate.found.content.get("runs", [])
    machine = certificate.found.result.machine
    axes, target = machine.linear_axes, machine.target()
    offset = np.array(target.offset_mm if target.on == "tool" else (0.0, 0.0, 0.0))
    shown = [run["commanded"] for run in runs if run.get("commanded")]
    paths = [
        offset + np.array(each["shown_mm"], float).reshape(-1, 3)
        for each in shown
        if len(axes) == 3
    ]
    trackers = [np.array(run["tracker_mm"], float) for run in runs]
    places = dict.fromkeys(
        ", ".join(language.number(value, 0) for value in at.tolist()) for at in trackers
    )
    steps = [-(-each["rows"] // max(len(each["shown_mm"]), 1)) for each in shown]
    return {
        "figure": draw_setup(axes, offset, paths, trackers, language)
        if paths
        else None,
        "places": places,
        "step": max(steps, default=1),
    }


def _describe_run(run: Run, language: Language) -> View:
    environment = run.get("environment", {})
    sensors = environment.get("sensors", [])
    return {
        "name": run["name"],
        "rows": list(_list_facts(run, language)),
        "sensors": [_state_sensor(one, language) for one in sensors],
        "missing": _list_missing(sensors, language),
        "air": list(_list_air(environment, language)),
    }


def _list_facts(run: Run, language: Language) -> Iterator[Row]:
    alignment = run["alignment"]
    yield language.say("mode"), language.say(f"mode_{run['mode']}")
    what = "lines" if run["mode"] == "otf" else "points"
    counts = {"count": alignment["lines"], "matched": alignment["matched_lines"]}
    yield language.say("commanded"), language.say(what, **counts)
    if feed := run.get("feed_mm_min"):
        speeds = dict.fromkeys(language.count(round(value)) for value in feed)
        yield language.say("feed"), f"{' – '.join(speeds)} mm/min"
    minutes = language.number(run["measured_s"] / 60.0)
    yield language.say("duration"), f"{minutes} min"
    share = 100.0 * run["used_samples"] / max(run["samples"], 1)
    yield (
        language.say("samples"),
        language.say(
            "samples_used",
            count=language.count(run["samples"]),
            share=language.number(share, 1),
        ),
    )
    metres = language.number(run["noise"]["distance_mm"] / 1000.0, 2)
    yield language.say("distance"), f"{metres} m"
    said = "; ".join(_list_interruptions(run.get("interruptions", {}), language))
    yield language.say("interruptions"), said or language.say("none")


def _list_interruptions(found: Mapping[str, Any], language: Language) -> Iterator[str]:
    if found.get("breaks"):
        seconds = language.number(found["broken_s"])
        yield language.say("beam_breaks", count=found["breaks"], seconds=seconds)
    if found.get("gaps"):
        count = language.count(found["lost_samples"])
        yield language.say("lost_samples", count=count, gaps=found["gaps"])
    if tries := found.get("searches", 0) + found.get("found", 0):
        yield language.say("searches", count=tries)
    if again := found.get("driven_again"):
        yield language.say("driven_again", lines=", ".join(again))


def _state_sensor(one: Mapping[str, Any], language: Language) -> tuple[str, ...]:
    name, _, unit = one["name"].rpartition("_")
    numbers = (one[key] for key in ("mean", "low", "high", "change"))
    return (
        language.own.get(f"sensor_{name}", name),
        str(_UNITS.get(unit, unit)),
        *("–" if value is None else language.number(value, 2) for value in numbers),
    )


def _list_missing(sensors: list[Mapping[str, Any]], language: Language) -> str:
    if not sensors:
        return language.say("no_sensors")
    recorded = {
        one["name"].rpartition("_")[2] for one in sensors if one["mean"] is not None
    }
    names = [
        language.say(f"quantity_{quantity}")
        for unit, quantity in _QUANTITIES.items()
        if unit not in recorded
    ]
    if not names:
        return ""
    return language.say("missing_quantities", names=", ".join(names))


def _list_air(environment: Mapping[str, Any], language: Language) -> Iterator[str]:
    refraction = as_object(environment.get("refraction"))
    key = _AIR.get(refraction.get("by", ""), "unknown")
    if key == "service" and refraction.get("why"):
        key = "assumed"
    yield language.say(f"air_{key}")
    if scale := environment.get("range_scale"):
        per_k = language.number(scale["per_K_ppm"], 2)
        per_hpa = language.number(scale["per_hPa_ppm"], 2)
        yield language.say("air_scale", per_k=per_k, per_hpa=per_hpa)


def _describe_grade(grade: Mapping[str, Any] | None, language: Language) -> str:
    if not grade:
        return ""
    word = language.shared[f"grade.{grade['verdict']}"]
    return f"{language.number(float(grade['number']), 2)} ({word})"
