"""Effects of the catalogue in a metrologist's words."""

from __future__ import annotations

from collections.abc import Mapping

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


def effect_title(name: str, keys: Mapping[str, str]) -> str:
    """Return an effect in words: `Backlash of Y`."""
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
