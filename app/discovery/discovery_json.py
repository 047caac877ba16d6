"""`discovery.json` (schema `discovery/1` of the file formats)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from app.discovery.discover import Discovery, Finding
from app.discovery.where import Segment, Where
from app.kinematics.effects.catalogue import Candidate, Measured
from app.kinematics.symbols import is_turn

SCHEMA = "discovery/1"
_SEGMENTS = 20  # the worst ones; all of them are in the report's plots


def discovery_json(found: Discovery) -> dict[str, Any]:
    """Return the content of the file."""
    named = [f for f in found.findings if not f.is_described]
    described = [f for f in found.findings if f.is_described]
    return {
        "schema": SCHEMA,
        "effects": [effect_json(f) for f in named],
        "unnamed": [_unnamed_json(f) for f in described],
        "gap": {
            "unit": "um",
            "before": found.gap.before_um,
            "after": found.gap.after_um,
            "noise_floor": found.gap.noise_floor_um,
            "on": "held-out segments",
        },
        "where": [_segment_json(s) for s in found.before.segments[:_SEGMENTS]],
        "explained_by": {
            "before": _shares(found.before),
            "after": _shares(found.after),
        },
        "compared": found.compared,
        "provenance": {
            "run": found.scene.run.name,
            "software": f"truepath {version('truepath')}",
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
        },
    }


def effect_json(finding: Finding) -> dict[str, Any]:
    """Return one effect with its parameters and its evidence."""
    words = finding.family.signature
    return {
        **_key(finding.candidate),
        "parameters": parameters_json(finding.parameters),
        "evidence": {
            "log_bayes_factor": finding.evidence.log_bayes,
            "held_out_log_score": finding.evidence.held_out,
            "share_of_gap": finding.evidence.share,
        },
        "indistinguishable_from": [_key(c) for c in finding.alternatives],
        "cause": words.cause,
        "looks_like": words.looks_like,
        "remedy": words.remedy,
    }


def parameters_json(found: Mapping[str, Measured]) -> dict[str, Any]:
    """Return values and uncertainties; `name[x]`, `name[y]` … make a list."""
    stated: dict[str, Any] = {}
    for name, m in found.items():
        whole, vector, _ = name.partition("[")
        if not vector:
            stated[name] = {"value": m.value, "uncertainty": m.uncertainty}
            continue
        parts = stated.setdefault(whole, {"value": [], "uncertainty": []})
        parts["value"].append(m.value)
        parts["uncertainty"].append(m.uncertainty)
    return stated


def _unnamed_json(finding: Finding) -> dict[str, Any]:
    amplitude = finding.parameters.get("amplitude_um")
    rms = finding.parameters.get("rms_um")
    size = rms.value if rms else (amplitude.value / 2**0.5 if amplitude else 0.0)
    return {
        "depends_on": depends_on(finding.candidate),
        "description": described(finding),
        "rms_um": size,
        **{k: v for k, v in effect_json(finding).items() if k not in ("name", "axis")},
    }


def depends_on(candidate: Candidate) -> list[str]:
    """Return what a structure without a name depends on."""
    if candidate.family == "time-wave":
        return ["t"]
    if candidate.family == "plane-error":
        return list(candidate.keys["plane"])
    return [candidate.keys["axis"]]


def described(finding: Finding) -> str:
    """Return a structure without a name in one sentence."""
    keys, found = finding.candidate.keys, finding.parameters
    if finding.candidate.family == "time-wave":
        return (
            f"a wave in time along {keys['direction']} with a period of "
            f"{found['period_s'].value:.3g} s and an amplitude of "
            f"{found['amplitude_um'].value:.2g} µm"
        )
    if finding.candidate.family == "position-wave":
        return (
            f"a wave along {keys['axis']} in the direction of {keys['direction']} with "
            f"a period of {found['period_mm'].value:.3g} mm and an amplitude of "
            f"{found['amplitude_um'].value:.2g} µm"
        )
    one, two = keys["plane"]
    return (
        f"a displacement along {keys['direction']} of {found['rms_um'].value:.2g} µm "
        f"(root mean square) that depends on {one} and {two} together"
    )


def _key(candidate: Candidate) -> dict[str, str]:
    key = {"name": candidate.family, **candidate.keys}
    if "motion" in candidate.keys:
        key["unit"] = "urad" if is_turn(candidate.keys["motion"]) else "um"
    return key


def _segment_json(segment: Segment) -> dict[str, Any]:
    return {
        "segment": segment.row,
        "axis": segment.axis,
        "direction": segment.direction,
        "region": segment.region,
        "time_s": segment.time_s,
        "feed_mm_min": segment.feed_mm_min,
        "rms_um": segment.rms_um,
    }


def _shares(where: Where) -> dict[str, float]:
    return dict(where.shares)
