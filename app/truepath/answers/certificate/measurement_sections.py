"""Sections on parties, dates, verdict and conformity, method, set-up and limits.

A result holds its limits as English sentences of a few forms. Each form is parsed and
written again; in English, and where the form is unknown, the sentence is quoted.
Sentences on what data do not determine are those of the operator page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

import numpy as np

from truepath.answers.certificate.figures import draw_setup
from truepath.answers.certificate.issue import Certificate, ResultSource
from truepath.answers.certificate.language import Language
from truepath.answers.certificate.stated_results import (
    StatedConformity,
    list_main_results,
)
from truepath.answers.shown.page import View
from truepath.documents.file_model import as_object
from truepath.files.bundle.identity_file import FIELDS
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import position_unit

_ELSEWHERE = (  # on the first page, with the method, and above the signatures
    *("laboratory", "customer", "place", "received_on", "measured_on"),
    *("warm_up", "deviations", "authorised_by"),
)
Run = Mapping[str, Any]
Row = tuple[str, str]
_UNITS = {"degC": "°C", "hPa": "hPa", "percent": "%"}
_Forms = Mapping[str, re.Pattern[str]]
_SYMBOL = r"(?P<symbol>[A-Z0O]{3}) \(.*?\)"
_UNOBSERVABLE: _Forms = {
    "merged": re.compile(
        rf"^{_SYMBOL} (?:is not distinguishable|cannot be told) from "
        r"(?P<others>.+?) with "
    ),
    "still": re.compile(rf"^{_SYMBOL} does not move the target"),
    "resting": re.compile(r"^(?P<axes>[A-Z, ]+): rotary axes stand still on this path"),
    "unseen": re.compile(
        r"^(?P<symbols>[\w, ]+): (?:\d+ common shapes are|a common shape is)"
        " not seen at the measured places"
    ),
}
_REMEDIES: _Forms = {
    "by_tool": re.compile(r"at least (?P<length>\d+) mm longer or shorter"),
    "by_side": re.compile(r"at least (?P<length>\d+) mm to the side"),
    "by_other_tool": re.compile("tool longer or shorter"),
    "by_other_side": re.compile("target to the side"),
    "by_another": re.compile("another tool length or offset"),
    "on_workpiece": re.compile("targets on the workpiece"),
    "off_line": re.compile("off one line with these"),
    "by_lines": re.compile("lines or points (?:determine|tell) too little"),
    "by_standstill": re.compile("between standstills"),
    "by_more_lines": re.compile("not corner to corner"),
}
_ACCURACY = re.compile(r"\(to (?P<urad>[\d.]+) µrad, k = 2, on the same path\)")
_POOR = re.compile(
    r"^(?P<first>\w{3})(?: together with (?P<others>[\w, ]+?)(?P<more> and others)?)?: "
    r"(?P<form>.+) is poorly observable; (?P<share>\d+) % of what a usual machine may "
    r"have stays open, (?P<sigma>[\d.]+) µm at the tool \(k = (?P<k>[12])\)$"
)
_FORM = re.compile(
    r"^an? (?P<shape>slope|bow|S|wave) of the (?P<what>error|turning) "
    r"along (?P<axis>\w)$"
)


def _describe_heading(certificate: Certificate, language: Language) -> View:
    found, stated = certificate.found, certificate.identity
    machine, missing = found.result.machine.name, language.text("not_stated")
    analysed = _read_day(found.content["provenance"].get("created"), language)
    preview = certificate.is_preview
    number = language.text("not_issued") if preview else certificate.shown_number
    issued = number if preview else language.day(certificate.issued)
    serial = stated.get("serial_number", missing)
    banners = {"preview": preview, "simulated": certificate.is_simulated}
    shown = [
        language.text(f"banner_{name}") for name, is_so in banners.items() if is_so
    ]
    as_left: list[Row] = []
    if certificate.left is not None:
        days = _list_days(certificate.left, language)
        as_left = [(language.text("left_measured_on"), days)]

    def name(field: str) -> Row:
        return language.text(f"identity_{field}"), stated.get(field, missing)

    return {
        "machine": machine,
        "number": number,
        "banner": " · ".join(shown),
        "rows": [
            (language.text("number"), number),
            name("laboratory"),
            name("customer"),
            (
                language.text("item"),
                language.text("item_is", machine=machine, serial=serial),
            ),
            name("place"),
            name("received_on"),
            (
                language.text("measured_on"),
                stated.get("measured_on") or _list_days(found, language),
            ),
            *as_left,
            (language.text("analysed_on"), analysed or missing),
            (language.text("issued"), issued),
            (language.text("issued_by"), certificate.issued_by or missing),
        ],
    }


def _describe_conformity(certificate: Certificate, language: Language) -> View:
    results = list_main_results(certificate)
    rows = [
        (
            _describe_decided(one, certificate, language),
            language.number(one.tolerance_um, 2),
            # As the section that it comes from writes it.
            f"{language.number(value, 2)} ± {language.number(half, 2)}"
            if one.of == "verification"
            else language.expanded(value, 0.5 * half),
            language.number(one.size.coverage_factor, 1),
            language.text(f"decision_{one.conformity}"),
        )
        for one in results.conformity
        for value, half in [(one.size.value_um, one.size.expanded_uncertainty_um)]
    ]
    unusable = certificate.tolerance_um is not None
    return {
        "rows": rows,
        "none": language.text(
            "no_conformity_unusable" if unusable else "no_conformity"
        ),
        "has_places": any(one.of == "verification" for one in results.conformity),
    }


def _describe_decided(
    one: StatedConformity, certificate: Certificate, language: Language
) -> str:
    if one.of != "verification":
        return language.text("conformity_p95", state=language.text(one.of))
    source = certificate.verification
    is_active = source is not None and source.content.get("compensated")
    key = "conformity_compensated" if is_active else "conformity_verification"
    return language.text(key, places=one.places)


def _describe_verdict(certificate: Certificate, language: Language) -> View:
    found = certificate.found.result.verdict
    verdicts = [{"of": "", **_format_verdict(found, language)}]
    if (left := certificate.left_verdict) is not None:
        of = language.text("after_left")
        verdicts.append({"of": of, **_format_verdict(left, language)})
    return {"said": verdicts}


def _format_verdict(verdict: Verdict, language: Language) -> View:
    reasons = sorted(verdict.reasons, key=lambda reason: -reason.severity)
    key = verdict.state.replace("-", "_")
    texts = {
        "usable": "usable_to_know" if reasons else "usable_means",
        "doubtful": "doubtful_means",
        "not-usable": "not_usable_accepted",
    }
    return {
        "state": verdict.state,
        "title": language.text(f"{key}_title"),
        "text": language.text(texts[verdict.state]),
        "reasons": [language.describe_reason(reason) for reason in reasons],
    }


def _describe_identity(certificate: Certificate, language: Language) -> View:
    machine = certificate.found.result.machine
    stated = {**certificate.devices, **certificate.identity}
    missing = language.text("not_stated")
    ranges = (
        language.text(
            "from_to",
            low=language.number(axis.low, 0),
            high=language.number(axis.high, 0),
        )
        for axis in machine.axes
    )
    travel = "; ".join(
        f"{axis.name} {span} {position_unit(axis)}"
        for axis, span in zip(machine.axes, ranges, strict=True)
    ).replace(" deg", "°")
    targets = "; ".join(
        f"{t.name} ({', '.join(language.number(v) for v in t.offset_mm)}) mm "
        f"{language.text(f'on_{t.on}')}".strip()
        for t in machine.targets
    )
    rows = [
        (language.text("identity_machine"), machine.name),
        *(
            (language.text(f"identity_{name}"), stated.get(name, missing))
            for name in FIELDS
            if name not in _ELSEWHERE
        ),
        (language.text("chain"), machine.chain),
        (language.text("travel"), travel),
        (language.text("targets"), targets),
    ]
    is_known = "tracker_certificate" in stated
    traceability = language.text(
        "traceability" if is_known else "traceability_missing",
        certificate=stated.get("tracker_certificate"),
        date=stated.get("tracker_calibrated_on", missing),
    )
    return {"rows": rows, "missing": missing, "traceability": traceability}


def _list_days(source: ResultSource, language: Language) -> str:
    runs: list[Mapping[str, Any]] = source.content.get("runs", [])
    known = (run.get("source", {}).get("started") for run in runs)
    days = dict.fromkeys(day for one in known if (day := _read_day(one, language)))
    return ", ".join(days) or language.text("not_stated")


def _read_day(text: object, language: Language) -> str:
    """Empty for a text that is no time stamp of ISO 8601."""
    try:
        return language.day(datetime.fromisoformat(str(text)).date())
    except ValueError:
        return ""


def _describe_measurement(certificate: Certificate, language: Language) -> View:
    runs: list[Run] = certificate.found.content.get("runs", [])
    stated, missing = certificate.identity, language.text("not_stated")
    version = certificate.found.content["provenance"].get("software_version", "")
    rows = [
        (language.text("procedure"), language.text("procedure_is", version=version))
    ]
    rows += [
        (language.text(f"identity_{name}"), stated.get(name, missing))
        for name in ("deviations", "warm_up")
    ]
    if grade := certificate.found.content.get("grade"):
        word = language.shared[f"grade.{grade['verdict']}"]
        text = f"{language.number(float(grade['number']), 2)} ({word})"
        rows.append((language.text("grade"), text))
    return {"rows": rows, "runs": [_describe_run(run, language) for run in runs]}


def _describe_setup(certificate: Certificate, language: Language) -> View:
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
        "sensors": [_format_sensor(one, language) for one in sensors],
        "missing": _describe_missing(sensors, language),
        "air": list(_describe_air(environment, language)),
    }


def _list_facts(run: Run, language: Language) -> Iterator[Row]:
    alignment = run["alignment"]
    yield language.text("mode"), language.text(f"mode_{run['mode']}")
    what = "lines" if run["mode"] == "otf" else "points"
    counts = {"count": alignment["lines"], "matched": alignment["matched_lines"]}
    yield language.text("commanded"), language.text(what, **counts)
    if feed := run.get("feed_mm_min"):
        speeds = dict.fromkeys(language.count(round(value)) for value in feed)
        yield language.text("feed"), f"{' – '.join(speeds)} mm/min"
    minutes = language.number(run["measured_s"] / 60.0)
    yield language.text("duration"), f"{minutes} min"
    share = 100.0 * run["used_samples"] / max(run["samples"], 1)
    used = {"count": language.count(run["samples"]), "share": language.number(share, 1)}
    yield language.text("samples"), language.text("samples_used", **used)
    metres = language.number(run["noise"]["distance_mm"] / 1000.0, 2)
    yield language.text("distance"), f"{metres} m"
    text = "; ".join(_describe_interruptions(run.get("interruptions", {}), language))
    yield language.text("interruptions"), text or language.text("none")


def _describe_interruptions(
    found: Mapping[str, Any], language: Language
) -> Iterator[str]:
    if found.get("breaks"):
        seconds = language.number(found["broken_s"])
        yield language.text("beam_breaks", count=found["breaks"], seconds=seconds)
    if found.get("gaps"):
        count = language.count(found["lost_samples"])
        yield language.text("lost_samples", count=count, gaps=found["gaps"])
    if tries := found.get("searches", 0) + found.get("found", 0):
        yield language.text("searches", count=tries)
    if again := found.get("driven_again"):
        yield language.text("driven_again", lines=", ".join(again))


def _format_sensor(one: Mapping[str, Any], language: Language) -> tuple[str, ...]:
    name, _, unit = one["name"].rpartition("_")
    numbers = (one[key] for key in ("mean", "low", "high", "change"))
    return (
        language.own.get(f"sensor_{name}", name),
        str(_UNITS.get(unit, unit)),
        *("–" if value is None else language.number(value, 2) for value in numbers),
    )


def _describe_missing(sensors: list[Mapping[str, Any]], language: Language) -> str:
    if not sensors:
        return language.text("no_sensors")
    recorded = {
        one["name"].rpartition("_")[2] for one in sensors if one["mean"] is not None
    }
    quantities = {"degC": "temperature", "hPa": "pressure", "percent": "humidity"}
    names = ", ".join(
        language.text(f"quantity_{quantity}")
        for unit, quantity in quantities.items()
        if unit not in recorded
    )
    return names and language.text("missing_quantities", names=names)


def _describe_air(environment: Mapping[str, Any], language: Language) -> Iterator[str]:
    refraction = as_object(environment.get("refraction"))
    keys = {"instrument": "instrument", "truepath": "service", "nobody": "nobody"}
    key = keys.get(refraction.get("by", ""), "unknown")
    if key == "service" and refraction.get("why"):
        key = "assumed"
    yield language.text(f"air_{key}")
    if scale := environment.get("range_scale"):
        per_k = language.number(scale["per_K_ppm"], 2)
        per_hpa = language.number(scale["per_hPa_ppm"], 2)
        yield language.text("air_scale", per_k=per_k, per_hpa=per_hpa)


def _describe_limits(certificate: Certificate, language: Language) -> View:
    found = certificate.found.content["observability"]
    return {
        "unobservable": [
            describe_unobservable(s, language) for s in found["unobservable"]
        ],
        "weak": [
            describe_poorly_observable(s, language) for s in found.get("weak", ())
        ],
        "rank": language.text(
            "limits_rank", rank=found["rank"], parameters=found["parameters"]
        ),
    }


def describe_unobservable(text: str, language: Language) -> str:
    """What data do not determine, and what would; unknown forms are quoted."""
    key, found = _match(_UNOBSERVABLE, text)
    if language.code == "en" or found is None:
        return language.localise_numbers(text)
    values = found.groupdict()
    if symbol := values.get("symbol"):
        values["name"] = language.name_symbol(symbol)
    if others := values.get("others"):
        values["others"] = others.replace(" and ", f" {language.text('and')} ")
    texts = [language.shared[f"unobservable.{key}"].format(**values)]
    cure, remedy = _match(_REMEDIES, text)
    if remedy:
        texts.append(
            language.shared[f"unobservable.{cure}"].format(**remedy.groupdict())
        )
    if accuracy := _ACCURACY.search(text):
        texts.append(
            language.text(
                "limits_accuracy", urad=language.localise_numbers(accuracy["urad"])
            )
        )
    return " ".join(texts)


def describe_poorly_observable(text: str, language: Language) -> str:
    """Which shape rests mostly on the prior, k = 2; unknown forms are quoted."""
    found = _POOR.match(text)
    form = _describe_form(found["form"], language) if found else ""
    if found is None or not form:
        return language.localise_numbers(text)
    who = found["first"]
    if others := found["others"]:
        key = "limits_poor_with_more" if found["more"] else "limits_poor_with"
        who = language.text(key, first=who, others=others)
    times = 1.0 if found["k"] == "2" else 2.0  # of results of earlier versions
    half = language.number(times * float(found["sigma"]), 1)
    return language.text(
        "limits_poor", who=who, form=form, share=found["share"], half=half
    )


def _describe_form(text: str, language: Language) -> str:
    if text == "the angle":
        return language.text("limits_form_angle")
    found = _FORM.match(text)
    if found is None:
        return ""
    what = language.text(f"limits_of_{found['what']}")
    shape = f"limits_form_{found['shape'].lower()}"
    return language.text(shape, what=what, axis=found["axis"])


def _match(forms: _Forms, text: str) -> tuple[str, re.Match[str] | None]:
    for key, form in forms.items():
        if found := form.search(text):
            return key, found
    return "", None


VIEWS = {
    "heading": _describe_heading,
    "verdict": _describe_verdict,
    "conformity": _describe_conformity,
    "identity": _describe_identity,
    "measurement": _describe_measurement,
    "setup": _describe_setup,
    "limits": _describe_limits,
}
