"""`discovery.json` (schema `discovery/1` of the file formats), and its sentences."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from truepath.alignment.observations.observations import Observations
from truepath.answers.shown.page import format_number
from truepath.discovery.discover import Discovery
from truepath.discovery.discrimination import DECIDED, DiscriminationDesign
from truepath.discovery.findings import Finding
from truepath.discovery.residual_location import RunResidual, Segment
from truepath.discovery.undetermined import (
    OTHER,
    POSE,
    SQUARENESS,
    TIMING,
    TRACKER,
    Undetermined,
)
from truepath.estimation.problem.noise import split_sigma_mm
from truepath.files.bundle.commanded_file import list_columns
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.family import Candidate, Family, find_family
from truepath.kinematics.machine.symbols import is_turn
from truepath.results.updated_effects import parameters_json

_TAKERS = {
    POSE: "the pose of the tracker",
    TIMING: "phase and speed of the lines",
    SQUARENESS: "squareness",
    TRACKER: "errors of the tracker within its specification",
    OTHER: "other effects of the model",
}
_TELLS = {
    "other-target": "Another tool length or offset shows it.",
    "oblique-lines": "Lines on which several axes move at once show it.",
    "both-directions": "Lines in both directions and at different feeds show it.",
    "repeated-lines": "Repeated lines, the first ones again at the end, show it.",
    "other-places": "Lines along the axis at more positions of the other axes show it.",
    "more-lines": "More lines, at other places and feeds, show it, unless the error "
    "motions contain it.",
}
_NOISY = 1.5  # times the specification of the tracker: to be described
_VISIBLE = 0.25  # of the variance specified in all directions: less changes nothing
_SEGMENTS = 20  # the worst ones; all of them are in the report's plots


def _undetermined_json(one: Undetermined) -> dict[str, Any]:
    return {
        "name": one.family.name,
        **one.keys,
        "signal_to_noise": one.ratio,
        "taken_by": list(one.taken_by),
        "indistinguishable_from": [
            {"name": rival.family, **rival.keys} for rival in one.rivals
        ],
        "would_tell": _choose_cure(one),
        "sentence": describe_undetermined(one),
    }


def describe_undetermined(one: Undetermined) -> str:
    """For example `Backlash of X is not distinguishable from …; … show it.`"""
    takers = [
        _TAKERS.get(name, f"the error motions of {name}") for name in one.taken_by
    ]
    takers += [find_family(r.family).title(r.keys) for r in one.rivals]
    cure = _choose_cure(one)
    tells = _TELLS.get(cure, one.family.words["en"].remedy)
    title = one.family.title(one.keys)
    return f"{title} is not distinguishable from {' with '.join(takers)}. {tells}"


def _choose_cure(one: Undetermined) -> str:
    """Key of the measurement that would distinguish it."""
    axis = one.keys.get("axis")
    if any(
        r.family == one.family.name and r.keys.get("axis") == axis for r in one.rivals
    ):
        return "other-target"
    if TIMING in one.taken_by:
        return "oblique-lines"
    if one.family.varies_with == "way":
        return "both-directions"
    if one.family.varies_with == "time":
        return "repeated-lines"
    if one.family.role is Role.MEASUREMENT:
        return "remedy"  # that of the effect's family
    return "other-places" if one.family.varies_with == "place" else "more-lines"


def discovery_json(found: Discovery) -> dict[str, Any]:
    """The whole content of `discovery.json` but `model`, `verdict` and `ask`."""
    named = [f for f in found.findings if f.structure is None]
    worst = [
        (s, k) for k, one in enumerate(found.residuals) for s in one.before.segments
    ]
    worst.sort(key=lambda pair: -pair[0].rms_um)
    return {
        "schema": "discovery/1",
        "effects": [effect_json(f) for f in named],
        "possible": [effect_json(f) for f in found.possible],
        "unnamed": [
            *(
                _encode_unnamed(f.structure, f)
                for f in found.findings
                if f.structure is not None
            ),
            *list_unexplained(found),
        ],
        "cannot_tell": [_undetermined_json(one) for one in found.undetermined],
        "gap": {
            "unit": "um",
            "before": found.gap.before_um,
            "after": found.gap.after_um,
            "noise_floor": found.gap.noise_floor_um,
            "expected": found.gap.expected_um,
            "on": "held-out segments",
        },
        "where": [{**_segment_json(s), "run": k} for s, k in worst[:_SEGMENTS]],
        "lines": [
            line
            for k, one in enumerate(found.residuals)
            for line in _list_lines(one, k)
        ],
        "explained_by": _shares_json(found.residuals[0]),
        "runs": [
            {
                "name": scene.run.name,
                "mode": scene.run.mode,
                "where": [_segment_json(s) for s in one.before.segments[:_SEGMENTS]],
                "explained_by": _shares_json(one),
            }
            for scene, one in zip(found.aligned, found.residuals, strict=True)
        ],
        "compared": found.compared,
        "provenance": {
            "run": found.run_names,
            "software": f"truepath {version('truepath')}",
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    }


def list_unexplained(found: Discovery) -> list[dict[str, Any]]:
    """What neither effects nor free forms explain; empty if nothing remains.

    In the gap, or counted as noise beyond the specification of the tracker.
    """
    gap, unexplained = found.gap, list[dict[str, Any]]()
    if found.leaves_gap:
        rms_um = float(np.sqrt(gap.after_um**2 - gap.expected_um**2))
        by = next(iter(found.residuals[0].after.shares), "line")
        text = (
            f"a displacement of {rms_um:.2g} µm (root mean square on held-out lines) "
            f"in no shape that was tried; it shows most by {by}"
        )
        unexplained.append({"depends_on": [by], "description": text, "rms_um": rms_um})
    counted, usual, cells = np.zeros(3), np.zeros(3), 0  # mm²
    for run in found.baseline.runs:
        cells += len(run.observations)
        for noise, sums in ((run.noise, counted), (run.noise.typical, usual)):
            for sigma_mm in split_sigma_mm(run.observations, noise):
                sums += (sigma_mm**2).sum(axis=0)
    for where, part in (("along", slice(0, 1)), ("across", slice(1, 3))):
        ratio = float(np.sqrt(counted[part].sum() / usual[part].sum()))
        more = (counted - usual)[part]
        if ratio < _NOISY or more.sum() < _VISIBLE * usual.sum():
            continue
        rms_um = float(1e3 * np.sqrt(more.mean() / cells))
        text = (
            f"deviations of {rms_um:.2g} µm {where} the beam, in no shape that was "
            f"tried: they are counted as noise, {ratio:.2g} times what the tracker is "
            "stated to have there"
        )
        unexplained.append({"depends_on": ["t"], "description": text, "rms_um": rms_um})
    return unexplained


def effect_json(finding: Finding) -> dict[str, Any]:
    """One effect with its parameters and its evidence."""
    words = finding.family.words["en"]
    return {
        **_key(finding.candidate),
        "grade": finding.grade,
        "parameters": parameters_json(finding.parameters),
        "evidence": {
            "log_bayes_factor": finding.evidence.log_bayes,
            "held_out_log_score": finding.evidence.held_out,
            "share_of_gap": finding.evidence.share,
        },
        "indistinguishable_from": [
            *map(_key, finding.alternatives),
            *([{"name": TRACKER}] if finding.is_imitated else []),
        ],
        "cause": words.cause,
        "looks_like": words.looks_like,
        "largest_um": 1e3 * finding.largest_mm,
        "is_small": finding.is_small,
        "remedy": describe_remedy(finding),
    }


def describe_remedy(finding: Finding) -> str:
    """Say what to do about an effect; nothing about one too small to matter."""
    if not finding.is_small:
        return finding.family.words["en"].remedy
    largest = format_number(1e3 * finding.largest_mm, 2)
    return f"Nothing at what was measured: it moves the target by {largest} µm at most."


def _encode_unnamed(family: Family, finding: Finding) -> dict[str, Any]:
    amplitude = finding.parameters.get("amplitude_um")
    rms = finding.parameters.get("rms_um")
    size = rms.value if rms else (amplitude.value / 2**0.5 if amplitude else 0.0)
    return {
        "structure": family.name,
        "depends_on": family.list_covariates(finding.candidate),
        "description": family.describe(finding.candidate, finding.parameters),
        "rms_um": size,
        **{k: v for k, v in effect_json(finding).items() if k not in ("name", "axis")},
    }


def _key(candidate: Candidate) -> dict[str, str]:
    key = {"name": candidate.family, **candidate.keys}
    if "motion" in candidate.keys:
        key["unit"] = "urad" if is_turn(candidate.keys["motion"]) else "um"
    return key


def _segment_json(segment: Segment) -> dict[str, Any]:
    content = asdict(segment)
    return {"segment": content.pop("row"), **content}


def _list_lines(one: RunResidual, run: int) -> list[dict[str, Any]]:
    observed = one.observations
    after = {(s.row, s.time_s): s.rms_um for s in one.after.segments}
    celsius = _average_temperatures(observed)
    return [
        {
            "run": run,
            "segment": s.row,
            "axis": s.axis,
            "direction": s.direction,
            "time_s": s.time_s,
            "feed_mm_min": s.feed_mm_min,
            "before_um": s.rms_um,
            "after_um": after[s.row, s.time_s],
            "temperature_degC": celsius.get(s.time_s, {}),
        }
        for s in sorted(one.before.segments, key=lambda s: s.time_s)
    ]


def _average_temperatures(observed: Observations) -> dict[float, dict[str, float]]:
    recorded = observed.at.recorded
    if recorded is None or recorded.temperature_degc is None:
        return {}
    means: dict[float, dict[str, float]] = {}
    for first, last in observed.lines:
        average = recorded.temperature_degc[first:last].mean(axis=0).tolist()
        at_s = float(observed.at.time_s[first:last].mean())
        means[at_s] = dict(zip(recorded.sensors, average, strict=True))
    return means


def _shares_json(shown: RunResidual) -> dict[str, dict[str, float]]:
    return {"before": shown.before.shares, "after": shown.after.shares}


def format_title(candidate: Candidate) -> str:
    """For example `Backlash of Y`."""
    return find_family(candidate.family).title(candidate.keys)


def describe_alternatives(finding: Finding) -> str:
    """Sentence on what else a finding may be; also where there is no alternative."""
    names = [format_title(c) for c in finding.alternatives]
    if finding.is_imitated:
        names.append(
            "errors of the tracker beyond its specification, which another place or "
            "the other face of it, or other feeds, would show"
        )
    if not names:
        return "no other effect of the catalogue explains the measurement as well"
    return f"this measurement cannot tell it from: {'; '.join(names)}"


def proposal_json(proposal: DiscriminationDesign, file: str) -> dict[str, Any]:
    """The questions, the lines that decide them, and the reason in words.

    file : the `path.csv` of the lines, next to `discovery.json`; `rows` are the same,
        as a measuring job takes them for its path
    """
    columns = list_columns(proposal.path)
    rows = zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True)
    return {
        "reason": explain_proposal(proposal),
        "questions": [
            {"between": [question.left, question.right], "expected_log_bayes": gain}
            for question, gain in zip(
                proposal.questions, proposal.expected, strict=True
            )
        ],
        "decides": proposal.decides,
        "path": file,
        "rows": [dict(zip(columns, row, strict=True)) for row in rows],
        "lines": proposal.lines,
        "duration_s": proposal.duration_s,
    }


def explain_proposal(proposal: DiscriminationDesign) -> str:
    """Why these lines, how long they take, and what they are expected to decide."""
    step = np.sign(np.diff(proposal.path.position, axis=0))
    turns = int(np.sum((step[1:] * step[:-1] < 0.0).any(axis=1)))
    feeds = sorted({round(float(f)) for f in proposal.path.feed_mm_min[1:]})
    gain = min(proposal.expected)
    enough = "decides" if proposal.decides else f"is less than the {DECIDED:.0f} wanted"
    questions = "; ".join(
        f"{q.left} and {q.right} explain the measurement alike"
        if q.right
        else f"the evidence for {q.left} is thin"
        for q in proposal.questions
    )
    return (
        f"{questions}. {proposal.lines} lines in "
        f"{proposal.duration_s:.0f} s, {turns} of them turning back, at "
        f"{', '.join(str(f) for f in feeds)} mm/min are expected to bring a log Bayes "
        f"factor of {gain:.0f}, which {enough}."
    )
