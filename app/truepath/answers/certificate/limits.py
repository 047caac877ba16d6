"""Limits of a measurement in the language of the certificate.

A result holds English sentences of a few forms. Each form is parsed and written again;
in English, and where the form is unknown, the sentence is quoted. Sentences on what
data do not determine are those of the operator page.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from truepath.answers.certificate.issue import Certificate
from truepath.answers.certificate.language import Language
from truepath.answers.shown.page import View

Forms = Mapping[str, re.Pattern[str]]
_SYMBOL = r"(?P<symbol>[A-Z0O]{3}) \(.*?\)"
_UNOBSERVABLE: Forms = {
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
_REMEDIES: Forms = {
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


def describe_limits(certificate: Certificate, language: Language) -> View:
    """What the measurement cannot determine, or only poorly."""
    found = certificate.found.content["observability"]
    return {
        "unobservable": [
            describe_unobservable(s, language) for s in found["unobservable"]
        ],
        "weak": [
            describe_poorly_observable(s, language) for s in found.get("weak", ())
        ],
        "rank": language.say(
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
        values["others"] = others.replace(" and ", f" {language.say('and')} ")
    said = [language.shared[f"unobservable.{key}"].format(**values)]
    cure, remedy = _match(_REMEDIES, text)
    if remedy:
        said.append(
            language.shared[f"unobservable.{cure}"].format(**remedy.groupdict())
        )
    if accuracy := _ACCURACY.search(text):
        said.append(
            language.say(
                "limits_accuracy", urad=language.localise_numbers(accuracy["urad"])
            )
        )
    return " ".join(said)


def describe_poorly_observable(text: str, language: Language) -> str:
    """Which shape rests mostly on the prior, k = 2; unknown forms are quoted."""
    found = _POOR.match(text)
    form = _describe_form(found["form"], language) if found else ""
    if found is None or not form:
        return language.localise_numbers(text)
    who = found["first"]
    if others := found["others"]:
        key = "limits_poor_with_more" if found["more"] else "limits_poor_with"
        who = language.say(key, first=who, others=others)
    times = 1.0 if found["k"] == "2" else 2.0  # of results of earlier versions
    half = language.number(times * float(found["sigma"]), 1)
    return language.say(
        "limits_poor", who=who, form=form, share=found["share"], half=half
    )


def _describe_form(text: str, language: Language) -> str:
    if text == "the angle":
        return language.say("limits_form_angle")
    found = _FORM.match(text)
    if found is None:
        return ""
    what = language.say(f"limits_of_{found['what']}")
    shape = f"limits_form_{found['shape'].lower()}"
    return language.say(shape, what=what, axis=found["axis"])


def _match(forms: Forms, text: str) -> tuple[str, re.Match[str] | None]:
    for key, form in forms.items():
        if found := form.search(text):
            return key, found
    return "", None
