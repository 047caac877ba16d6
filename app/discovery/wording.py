"""Findings in a metrologist's words."""

from __future__ import annotations

from app.discovery.discover import Finding
from app.kinematics.effects.catalogue import Candidate
from app.kinematics.symbols import meaning

_PLAIN = {
    "backlash": "backlash",
    "lateral-backlash": "lateral backlash",
    "screw-cyclic": "cyclic error of screw or scale",
    "thermal-growth": "thermal growth",
    "table-drift": "drift of tracker or table",
    "elastic-sag": "sag of a guide",
    "servo-mismatch": "servo mismatch",
    "reversal-spike": "spike at reversal",
    "squareness": "squareness",
    "tracker-eccentricity": "eccentric circle of the tracker",
    "tracker-range-offset": "range offset of the tracker",
    "setup-step": "step of the set-up",
    "vibration": "vibration",
}


def title(candidate: Candidate) -> str:
    """Return an effect in words: `Backlash of Y`."""
    name, keys = candidate.family, candidate.keys
    said = [_PLAIN.get(name, name.replace("-", " "))]
    if "axis" in keys and "motion" not in keys:
        said.append(f"of {keys['axis']}")
    if "motion" in keys:
        said.append(f"in {keys['motion']}, {meaning(keys['motion'])}")
    if "by" in keys:
        said.append(f"under {keys['by']}")
    if "plane" in keys:
        said.append(f"in the plane of {' and '.join(keys['plane'])}")
    if "direction" in keys:
        said.append(f"along {keys['direction']}")
    if "circle" in keys:
        said.append(f"({keys['circle']})")
    if "symbol" in keys:
        said.append(f"{keys['symbol']}, {meaning(keys['symbol'])}")
    text = " ".join(said)
    return text[0].upper() + text[1:]


def others(finding: Finding) -> str:
    """Say what else a finding may be."""
    if not finding.alternatives:
        return "no other effect of the catalogue explains the measurement as well"
    names = "; ".join(title(c) for c in finding.alternatives)
    return f"this measurement cannot tell it from: {names}"
