"""The first page: who, what, when, and the verdict of the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from truepath.answers.certificate.issue import Certificate, ResultSource
from truepath.answers.certificate.language import Language
from truepath.answers.shown.templating import View
from truepath.files.bundle.identity_file import FIELDS
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import position_unit

_DEVICES = {"tracker": "tracker", "control": "motion"}


def describe_heading(certificate: Certificate, language: Language) -> View:
    """Number and dates; that of measurement as stated, else from the Runs."""
    provenance = certificate.found.content["provenance"]
    analysed = _read_day(provenance.get("created"), language)
    return {
        "machine": certificate.found.result.machine.name,
        "number": certificate.shown_number,
        "dates": [
            (language.say("number"), certificate.shown_number),
            (language.say("issued"), language.day(certificate.issued)),
            (language.say("measured_on"), _find_measured(certificate, language)),
            *_date_as_left(certificate, language),
            (language.say("analysed_on"), analysed or language.say("not_stated")),
        ],
    }


def describe_verdict(certificate: Certificate, language: Language) -> View:
    """Verdicts as found and as left, with reasons, the most severe first."""
    found = certificate.found.result.verdict
    said = [{"of": "", **_describe_verdict(found, language)}]
    if (left := certificate.left_verdict) is not None:
        said.append(
            {"of": language.say("after_left"), **_describe_verdict(left, language)}
        )
    return {"said": said}


def _describe_verdict(verdict: Verdict, language: Language) -> View:
    reasons = sorted(verdict.reasons, key=lambda reason: -reason.severity)
    key = verdict.state.replace("-", "_")
    texts = {
        "usable": "usable_to_know" if reasons else "usable_means",
        "doubtful": "doubtful_means",
        "not-usable": "not_usable_accepted",
    }
    return {
        "state": verdict.state,
        "title": language.say(f"{key}_title"),
        "text": language.say(texts[verdict.state]),
        "reasons": [language.describe_reason(reason) for reason in reasons],
    }


def describe_identity(certificate: Certificate, language: Language) -> View:
    """Who and what; unknown entries are shown as not stated."""
    machine = certificate.found.result.machine
    stated = {**_read_devices(certificate), **certificate.identity}
    missing = language.say("not_stated")
    travel = "; ".join(
        f"{axis.name} {_describe_range(axis.low, axis.high, language)} "
        f"{position_unit(axis)}"
        for axis in machine.axes
    ).replace(" deg", "°")
    targets = "; ".join(
        f"{t.name} ({', '.join(language.number(v) for v in t.offset_mm)}) mm "
        f"{language.say(f'on_{t.on}')}".strip()
        for t in machine.targets
    )
    rows = [
        (language.say("identity_machine"), machine.name),
        *(
            (language.say(f"identity_{name}"), stated.get(name, missing))
            for name in FIELDS
            if name not in ("warm_up", "measured_on")
        ),
        (language.say("chain"), machine.chain),
        (language.say("travel"), travel),
        (language.say("targets"), targets),
    ]
    return {"rows": rows, "missing": missing}


def _read_devices(certificate: Certificate) -> dict[str, str]:
    runs: list[Mapping[str, Any]] = certificate.found.content.get("runs", [])
    known: dict[str, str] = {}
    for field, device in _DEVICES.items():
        said = [run.get("source", {}).get(device) for run in runs]
        if names := dict.fromkeys(str(one).strip() for one in said if one):
            known[field] = "; ".join(names)
    return known


def _find_measured(certificate: Certificate, language: Language) -> str:
    if stated := certificate.identity.get("measured_on"):
        return stated
    return _list_days(certificate.found, language)


def _date_as_left(
    certificate: Certificate, language: Language
) -> Iterator[tuple[str, str]]:
    if certificate.left is not None:
        days = _list_days(certificate.left, language)
        yield language.say("left_measured_on"), days


def _list_days(source: ResultSource, language: Language) -> str:
    runs: list[Mapping[str, Any]] = source.content.get("runs", [])
    known = (run.get("source", {}).get("started") for run in runs)
    days = dict.fromkeys(day for one in known if (day := _read_day(one, language)))
    return ", ".join(days) or language.say("not_stated")


def _read_day(text: object, language: Language) -> str:
    """Empty for a text that is no time stamp of ISO 8601."""
    try:
        return language.day(datetime.fromisoformat(str(text)).date())
    except ValueError:
        return ""


def _describe_range(low: float, high: float, language: Language) -> str:
    return language.say(
        "from_to", low=language.number(low, 0), high=language.number(high, 0)
    )
