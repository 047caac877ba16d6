"""The first page: who, what, when, verdict of the result, statement of conformity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from truepath.answers.certificate.issue import Certificate, ResultSource
from truepath.answers.certificate.language import Language
from truepath.answers.certificate.stated_results import (
    StatedConformity,
    state_results,
)
from truepath.answers.shown.page import View
from truepath.files.bundle.identity_file import FIELDS
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import position_unit

_ELSEWHERE = (  # on the first page, with the method, and above the signatures
    *("laboratory", "customer", "place", "received_on", "measured_on"),
    *("warm_up", "deviations", "authorised_by"),
)


def describe_heading(certificate: Certificate, language: Language) -> View:
    """Number, parties and dates; that of measurement as stated, else from the Runs."""
    provenance = certificate.found.content["provenance"]
    analysed = _read_day(provenance.get("created"), language)
    preview = certificate.is_preview
    number = language.say("not_issued") if preview else certificate.shown_number
    issued = number if preview else language.day(certificate.issued)
    stated, missing = certificate.identity, language.say("not_stated")

    def name(field: str) -> tuple[str, str]:
        return language.say(f"identity_{field}"), stated.get(field, missing)

    return {
        "machine": certificate.found.result.machine.name,
        "number": number,
        "banner": " · ".join(_list_banners(certificate, language)),
        "rows": [
            (language.say("number"), number),
            name("laboratory"),
            name("customer"),
            (language.say("item"), _describe_item(certificate, language)),
            name("place"),
            name("received_on"),
            (language.say("measured_on"), _find_measured(certificate, language)),
            *_date_as_left(certificate, language),
            (language.say("analysed_on"), analysed or missing),
            (language.say("issued"), issued),
            (language.say("issued_by"), certificate.issued_by or missing),
        ],
    }


def _list_banners(certificate: Certificate, language: Language) -> Iterator[str]:
    if certificate.is_preview:
        yield language.say("banner_preview")
    if certificate.is_simulated:
        yield language.say("banner_simulated")


def _describe_item(certificate: Certificate, language: Language) -> str:
    stated = certificate.identity
    serial = stated.get("serial_number", language.say("not_stated"))
    return language.say(
        "item_is", machine=certificate.found.result.machine.name, serial=serial
    )


def describe_conformity(certificate: Certificate, language: Language) -> View:
    """Statements of conformity with their decision rule, or that there are none."""
    results = state_results(certificate)
    rows = [
        (
            _name_decided(one, certificate, language),
            language.number(one.tolerance_um, 2),
            _write_size(one, language),
            language.number(one.size.coverage_factor, 1),
            language.say(f"decision_{one.conformity}"),
        )
        for one in results.conformity
    ]
    unusable = certificate.tolerance_um is not None
    return {
        "rows": rows,
        "none": language.say("no_conformity_unusable" if unusable else "no_conformity"),
        "has_places": any(one.of == "verification" for one in results.conformity),
    }


def _name_decided(
    one: StatedConformity, certificate: Certificate, language: Language
) -> str:
    if one.of != "verification":
        return language.say("conformity_p95", state=language.say(one.of))
    source = certificate.verification
    is_active = source is not None and source.content.get("compensated")
    key = "conformity_compensated" if is_active else "conformity_verification"
    return language.say(key, places=one.places)


def _write_size(one: StatedConformity, language: Language) -> str:
    """As the section that it comes from writes it."""
    value, half = one.size.value_um, one.size.expanded_uncertainty_um
    if one.of != "verification":
        return language.write_expanded(value, 0.5 * half)
    return f"{language.number(value, 2)} ± {language.number(half, 2)}"


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
    stated = {**certificate.devices, **certificate.identity}
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
            if name not in _ELSEWHERE
        ),
        (language.say("chain"), machine.chain),
        (language.say("travel"), travel),
        (language.say("targets"), targets),
    ]
    has_certificate = "tracker_certificate" in stated
    key = "traceability" if has_certificate else "traceability_missing"
    traceability = language.say(
        key,
        certificate=stated.get("tracker_certificate"),
        date=stated.get("tracker_calibrated_on", missing),
    )
    return {"rows": rows, "missing": missing, "traceability": traceability}


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
