"""Sections next to the numbers: effects, verification, compensation, origin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from truepath.answers.certificate.figures import draw_points, inline_colours
from truepath.answers.certificate.issue import Certificate, Content, Source
from truepath.answers.certificate.language import Language
from truepath.answers.certificate.result_sections import (
    describe_lengths,
    describe_measured_lengths,
)
from truepath.answers.shown.page import SIGN, View
from truepath.answers.verification.circle_figures import FIGURES, OTHER_FEED
from truepath.answers.verification.matched_points import DOUBTFUL
from truepath.answers.verification.polar_figure import (
    ENGLISH,
    draw_polar_circles,
    name_figure,
)
from truepath.answers.verification.static_tests import CIRCLE_FIGURES, LINE_FIGURES
from truepath.documents.file_model import as_object
from truepath.files.earlier.verdict import verdict_from_json

Row = tuple[str, ...]
_K = 2.0


def _describe_effects(certificate: Certificate, language: Language) -> View:
    effects: Sequence[Mapping[str, Any]] = certificate.found.content.get("effects", [])
    words = {True: "agrees_yes", False: "agrees_no", None: "agrees_unknown"}
    return {
        "rows": [
            (
                _name_effect(one, language),
                "; ".join(_list_numbers(one["parameters"], language)),
                language.text(words[one.get("agrees")]),
            )
            for one in effects
        ]
    }


def describe_verification(certificate: Certificate, language: Language) -> View:
    """The decision of a verification, its sentences and its numbers."""
    source = certificate.verification
    if source is None:
        return {"source": None}
    return {
        "source": source,
        "mismatch": _describe_mismatch(
            "verification_mismatch", source, certificate, language
        ),
        "decision": describe_decision(source.content, language),
        "statements": translate_findings(source.content, language),
        "places": _draw_places(certificate, source.content, language),
        "lengths": list(_list_lengths(source.content, language)),
        "rows": list(_list_decisive(source.content, language)),
        "driven": describe_iso_figures(source.content, language),
        "circles": _describe_circles(source.content, language),
    }


def _draw_places(certificate: Certificate, content: Content, language: Language) -> str:
    """Empty without decisions of places, or without three linear axes."""
    places = as_object(content.get("places"))
    if not (decided := places.get("conformity")):
        return ""
    machine = certificate.found.result.machine
    linear = [k for k, a in enumerate(machine.axes) if a in machine.linear_axes]
    if len(linear) != 3:
        return ""
    position_mm = np.array(places["position"], float)[:, linear]
    return draw_points(machine.linear_axes, position_mm, decided, language)


def _describe_compensation(certificate: Certificate, language: Language) -> View:
    source = certificate.compensation
    if source is None:
        return {"source": None, "named": _describe_named_files(certificate, language)}
    account = source.content
    error = account["volumetric_error_um"]
    after = error["after"]
    left = language.expanded(after["mean"], after["mean_uncertainty"])
    if ends := as_object(account.get("lengths")).get("measured_degC"):
        lengths = describe_lengths((ends[0], ends[1]), language)
    else:  # a record of before the temperature
        provenance = as_object(account.get("provenance"))
        lengths = describe_measured_lengths(provenance, language)
    names = (f.replace("\\", "/").rsplit("/", 1)[-1] for f in account["files"])
    rows = [
        *(
            (
                f"compensation_{key}",
                language.shared.get(f"format.{account['format']}.{key}", account[key]),
            )
            for key in ("control", "carries", "not_carried")
        ),
        ("compensation_before", f"{language.number(error['before']['mean'], 2)} µm"),
        ("compensation_after", f"{left} µm (k = 2)"),
        ("compensation_lengths", lengths),
        ("compensation_file", ", ".join(names)),
    ]
    return {
        "source": source,
        "mismatch": _describe_mismatch(
            "compensation_mismatch", source, certificate, language
        ),
        "other": _describe_other_files(certificate, language),
        "rows": [(language.text(name), text) for name, text in rows],
        "sign_open": not account["sign"]["verified"],
    }


def _describe_named_files(certificate: Certificate, language: Language) -> str:
    verification = certificate.verification
    content = as_object(verification.content if verification else None)
    if not content.get("compensated"):
        return ""
    named = as_object(content.get("compensation"))
    files = as_object(named.get("files_sha256"))
    if not files:
        return language.text("compensation_unnamed")
    each = ", ".join(f"{name} (SHA-256 {str(d)[:16]}…)" for name, d in files.items())
    return language.text("compensation_named", format=named.get("format"), files=each)


def _describe_other_files(certificate: Certificate, language: Language) -> str:
    """Empty where verification and compensation record name the same files."""
    if certificate.verification is None or certificate.compensation is None:
        return ""
    active = as_object(certificate.verification.content.get("compensation"))
    verified = as_object(active.get("files_sha256"))
    stated = as_object(certificate.compensation.content.get("files_sha256"))
    if not verified or not stated or set(verified.values()) == set(stated.values()):
        return ""
    return language.text("compensation_other", files=", ".join(verified))


def _describe_provenance(certificate: Certificate, language: Language) -> View:
    return {"rows": list(_list_origins(certificate, language))}


def _describe_signatures(certificate: Certificate, language: Language) -> View:
    return {
        "signatories": [
            (language.text(f"signature_{name}"), certificate.identity.get(name, ""))
            for name in ("operator", "authorised_by")
        ]
    }


def _name_effect(one: Mapping[str, Any], language: Language) -> str:
    keys = [
        str(one[key]) for key in ("axis", "motion", "by", "direction") if key in one
    ]
    return " ".join([language.name_effect(one["name"]), *keys])


def _list_numbers(parameters: Mapping[str, Any], language: Language) -> Iterator[str]:
    for name, number in parameters.items():
        stem, unit = next(
            (
                (name.removesuffix(f"_{u}"), sign)
                for u, sign in SIGN.items()
                if name.endswith(f"_{u}")
            ),
            (name, ""),
        )
        value, sigma = (np.atleast_1d(number[key]) for key in ("value", "uncertainty"))
        pairs = zip(value.tolist(), sigma.tolist(), strict=True)
        shown = ", ".join(language.expanded(v, s) for v, s in pairs)
        word = language.shared.get(f"parameter.{stem}", stem.replace("_", " "))
        yield f"{word} {shown} {unit}".strip()


def _describe_mismatch(
    key: str, source: Source, certificate: Certificate, language: Language
) -> str:
    if not source.is_of_another(certificate.found):
        return ""
    other, own = source.input_sha256, certificate.found.input_sha256
    return language.text(key, other=other[:16], own=own[:16])


def describe_decision(content: Mapping[str, Any], language: Language) -> str:
    """Conformity with the tolerance; without one, agreement with the map."""
    conformity = as_object(content.get("conformity"))
    decision = as_object(conformity.get("measured")).get("conformity")
    agrees = as_object(content.get("agreement")).get("consistent")
    if decision in ("within", "outside", "undecided"):
        state = "_compensated" if content.get("compensated") else ""
        return language.text(f"verification_{decision}{state}")
    if isinstance(agrees, bool):
        return language.text(
            "verification_agrees" if agrees else "verification_differs"
        )
    return language.text("not_stated")


def translate_findings(content: Mapping[str, Any], language: Language) -> list[str]:
    """Sentences of a verification in the language of the certificate.

    Those of its file are English; a file with too few keys has them quoted.
    """
    own = [str(text) for text in content.get("statements", ())]
    if language.code == "en":
        return own
    try:
        return list(_translate_each(content, language)) or own
    except KeyError:
        return own


def _translate_each(content: Mapping[str, Any], language: Language) -> Iterator[str]:
    for of, one in as_object(content.get("conformity")).items():
        worst = language.shared["verify.worst"].format(
            count=len(content["places"]["row"]),
            length=_um(one["length_um"], language),
            u=_um(one["expanded_uncertainty_um"], language),
            k=language.number(one["coverage_factor"], 1),
            tolerance=_um(one["tolerance_um"], language),
        )
        if of == "deviation":
            decision = language.shared[f"verify.is_{one['conformity']}"]
            said = language.shared["verify.as_prediction"]
            worst = said.format(decision=decision, worst=worst)
        yield worst
    if stated := as_object(content.get("run_verdict")):
        yield from map(language.describe_reason, verdict_from_json(stated).reasons)
    if str(content.get("components", "")).startswith("three at standstills"):
        yield language.shared["verify.across"]
    if unseen := content.get("unseen_directions"):
        axes = language.shared["grade.and"].join(unseen)
        yield language.shared["verify.unseen"].format(axes=axes)
    if resting := content.get("axes_at_rest"):
        yield language.shared["verify.resting"].format(axes=", ".join(resting))
    scale = as_object(content.get("map_scale"))
    if agreement := as_object(content.get("agreement")):
        yield _describe_agreement(agreement, scale.get("cause"), language)
    if cause := scale.get("cause"):
        times = language.number(scale["value"], 2)
        yield language.text(f"verification_scale_{cause}", times=times)
    for circle in content.get("circles_in_motion", ()):
        for said in _describe_circle(circle, language):
            yield f"{_name_circle(circle, language)}: {said}"
    for ppm in dict.fromkeys(
        one.get("length_scale_ppm") for one in content.get("runs", ())
    ):
        if ppm is not None:
            scale_ppm = language.number(_K * ppm, 2)
            yield language.text("length_scale", ppm=scale_ppm)


def _describe_circle(one: Mapping[str, Any], language: Language) -> Iterator[str]:
    """What the result does not predict, and a feed that is not the commanded one."""
    words = {name: language.own[f"circle_{name}"] for name in ENGLISH}
    apart = [n for n, d in one.get("difference_um", {}).items() if not d["within"]]
    if apart:
        figures = ", ".join(name_figure(name, words) for name in apart)
        yield language.shared["circles.unlike"].format(figures=figures)
    driven = one.get("driven_feed_mm_min", {})
    if any(abs(v / one["feed_mm_min"] - 1.0) > OTHER_FEED for v in driven.values()):
        feeds = (f"{words[s]} {language.number(v)} mm/min" for s, v in driven.items())
        yield language.shared["circles.driven"].format(feeds=", ".join(feeds))


def _describe_agreement(
    agreement: Mapping[str, Any], cause: str | None, language: Language
) -> str:
    """A `cause` in the control is named before the tracker."""
    if agreement["consistent"]:
        key = "consistent"
    elif agreement["chance_of_any_machine"] >= DOUBTFUL:
        key = "changed"
    else:
        key = "other_compensation" if cause else "no_machine"
    return language.shared[f"verify.{key}"].format(
        chance=language.number(100.0 * agreement["chance"], 1),
        share=language.number(100.0 * agreement["share_within_expanded"], 0),
        k=f"{_K:g}",
    )


def _um(value: float, language: Language) -> str:
    return f"{language.number(value, 2)} µm"


def _list_lengths(content: Mapping[str, Any], language: Language) -> Iterator[Row]:
    lengths = as_object(content.get("volumetric_error_um"))
    for name in ("measured", "predicted", "deviation"):
        if one := as_object(lengths.get(name)):
            yield (
                language.text(f"verification_{name}"),
                *(
                    language.expanded(one[key], one[f"{key}_uncertainty"])
                    for key in ("mean", "p95", "largest")
                ),
            )


def _list_decisive(content: Mapping[str, Any], language: Language) -> Iterator[Row]:
    conformity = as_object(content.get("conformity"))
    tolerance = as_object(conformity.get("measured")).get("tolerance_um")
    if tolerance is not None:
        yield language.text("verification_tolerance"), _um(tolerance, language)
    agreement = as_object(content.get("agreement"))
    if "chi_square" in agreement:
        text = language.text(
            "verification_chi_square_is",
            value=language.number(agreement["chi_square"], 1),
            freedom=agreement["freedom"],
            chance=language.number(100.0 * agreement["chance"], 1),
        )
        yield language.text("verification_chi_square"), text
    if scale := as_object(content.get("map_scale")):
        text = language.expanded(scale["value"], scale["uncertainty"])
        yield language.text("verification_map_scale"), text


def _list_origins(certificate: Certificate, language: Language) -> Iterator[Row]:
    content = certificate.found.content
    provenance = content["provenance"]
    for run in provenance.get("runs", []):
        yield f"{language.text('provenance_run')} ({run['name']})", run["input_sha256"]
    plans = dict.fromkeys(
        run["commanded"]["sha256"]
        for run in content.get("runs", [])
        if run.get("commanded")
    )
    for plan in plans:
        yield language.text("provenance_plan"), plan
    for name, source in certificate.sources.items():
        yield language.text(f"provenance_{name}"), source.sha256
    version = f"truepath {provenance.get('software_version', '')}".strip()
    yield language.text("provenance_software"), version
    if model := provenance.get("model"):
        text = language.text(
            "provenance_model_is", version=model["version"], source=model["source"]
        )
        yield language.text("provenance_model"), text


def _describe_circles(content: Mapping[str, Any], language: Language) -> View:
    circles: Sequence[Mapping[str, Any]] = content.get("circles_in_motion", ())
    missing: Sequence[int] = content.get("circles_missing", ())
    words = {name: language.own[f"circle_{name}"] for name in ENGLISH}
    figure = draw_polar_circles(circles, words, language.localise_numbers)
    names = (name_figure(name, words) for name in FIGURES)
    rows = ", ".join(str(row + 1) for row in missing)
    return {
        "figure": inline_colours(figure),
        "head": (language.text("circle"), *names),
        "rows": [row for one in circles for row in _list_moving_circle(one, language)],
        "missing": language.text("circles_missing", rows=rows) if missing else "",
    }


def _list_moving_circle(one: Mapping[str, Any], language: Language) -> Iterator[Row]:
    names = _name_circle(one, language), language.text("circle_predicted")
    for name, of in zip(names, ("", "predicted_"), strict=True):
        value = one[f"{of}um" if of else "figures_um"]
        sigma = one[f"{of}uncertainty_um"]
        yield (
            name,
            *(
                language.expanded(value[f], sigma[f]) if f in value else "—"
                for f in FIGURES
            ),
        )


def _name_circle(one: Mapping[str, Any], language: Language) -> str:
    heading = language.own["circle_heading"].format(
        plane=one["plane"],
        diameter=f"{one['diameter_mm']:g}",
        feed=f"{one['feed_mm_min']:g}",
    )
    return language.localise_numbers(heading)


def describe_iso_figures(content: Mapping[str, Any], language: Language) -> View:
    """Figures of ISO 230-2, -6 and -4; empty where none were measured.

    content : of a `verification/1`
    """
    lines: list[Row] = []
    circles: list[Row] = []
    for one in content.get("lines", ()):
        standard = str(one["standard"]).upper().replace("ISO-", "ISO ")
        words = {"axes": one["axes"], "standard": standard, "runs": one["runs"]}
        name = language.text("driven_line_is", **words)
        lines += _list_figures(name, one, LINE_FIGURES, language)
    for one in content.get("circles", ()):
        radius = language.number(one["radius_mm"], 0)
        name = language.text("driven_circle_is", plane=one["plane"], radius=radius)
        circles += _list_figures(name, one, CIRCLE_FIGURES, language)
    return {
        "line_head": (language.text("driven_line"), *LINE_FIGURES),
        "lines": lines,
        "circle_head": (language.text("circle"), "G", "F max", "F min"),
        "circles": circles,
    }


def _list_figures(
    name: str, one: Mapping[str, Any], figures: Sequence[str], language: Language
) -> Iterator[Row]:
    value, sigma, predicted = (
        one[key] for key in ("figures_um", "uncertainty_um", "predicted_um")
    )
    yield name, *(language.expanded(value[f], sigma[f]) for f in figures)
    yield (
        language.text("circle_predicted"),
        *(language.number(predicted[f]) if f in predicted else "—" for f in figures),
    )


VIEWS = {
    "verification": describe_verification,
    "effects": _describe_effects,
    "compensation": _describe_compensation,
    "provenance": _describe_provenance,
    "signature": _describe_signatures,
}
