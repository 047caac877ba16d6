"""Findings in a metrologist's words."""

from __future__ import annotations

from app.discovery.findings import Finding
from app.kinematics.effects.catalogue import Candidate, find_family


def title(candidate: Candidate) -> str:
    """Return an effect in words: `Backlash of Y`."""
    return find_family(candidate.family).title(candidate.keys)


def others(finding: Finding) -> str:
    """Say what else a finding may be."""
    if not finding.alternatives:
        return "no other effect of the catalogue explains the measurement as well"
    names = "; ".join(title(c) for c in finding.alternatives)
    return f"this measurement cannot tell it from: {names}"
