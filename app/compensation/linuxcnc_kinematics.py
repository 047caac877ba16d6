"""LinuxCNC `xyzac-trt-kins`, `xyzbc-trt-kins`: where the axes of a trunnion are.

The C axis stands at (x, y)-rot-point; the tilting axis is off it by y-offset (A) or
x-offset (B), and z-offset above z-rot-point. The table turns right-handed where
`conventional-directions` is off, as it is where nobody sets it. Source: LinuxCNC
`src/emc/kinematics/trtfuncs.c`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from truepath.app.compensation.rotary_tables import AxisPlace, list_stated_locations
from truepath.app.errors import BadInput
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import LINEAR

_PIN = re.compile(r"setp (xyz[ab]c-trt-kins)\.([xyz]-(?:rot-point|offset)) (\S+)")
# The direction across both axes, in which they are off each other.
_ACROSS = {"A": 1, "B": 0}
_DIRECTIONS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}


def find_tilting_axis(machine: Machine) -> str | None:
    """Return A or B of a C table on a trunnion, w-C-A-…-b; None of another machine."""
    names = machine.workpiece_side[:2]
    if len(machine.rotary_axes) != 2 or names[:1] != ("C",) or len(names) < 2:
        return None
    straight = all(
        one.direction == _DIRECTIONS[one.name] for one in machine.rotary_axes
    )
    return names[1] if names[1] in _ACROSS and straight else None


def list_pin_places(machine: Machine, places: Sequence[AxisPlace]) -> frozenset[str]:
    """Return the locations that the pins have, of those that the result has.

    None where there is no trunnion, or where nothing is known of one of its axes: the
    pins would be those of the drawing.
    """
    tilting = find_tilting_axis(machine)
    if tilting is None or not all(place.known for place in places):
        return frozenset()
    across = LINEAR[_ACROSS[tilting]]
    pins = {"XOC", "YOC", f"{across}O{tilting}", f"ZO{tilting}"}
    return list_stated_locations(places) & pins


def write_kinematics(machine: Machine, places: tuple[AxisPlace, ...]) -> Iterator[str]:
    """Yield the lines that set the pins; nothing where they would state nothing."""
    tilting = find_tilting_axis(machine)
    if tilting is None or not list_pin_places(machine, places):
        return
    at = {place.axis.name: place.origin_mm for place in places}
    module, across = f"xyz{tilting.lower()}c-trt-kins", _ACROSS[tilting]
    turn, tilt = at["C"], at[tilting]
    for k, letter in enumerate("xyz"):
        yield f"setp {module}.{letter}-rot-point {turn[k]:.6f}"
    for k in (across, 2):
        yield f"setp {module}.{'xyz'[k]}-offset {tilt[k] - turn[k]:.6f}"


def read_kinematics(name: str, text: str, machine: Machine) -> dict[str, float]:
    """Return the location errors that the pins stand for, mm. Raises BadInput."""
    tilting = find_tilting_axis(machine)
    lines = [line for line in text.splitlines() if line and line[0] != "#"]
    pins: dict[str, float] = {}
    for line in lines:
        pin = _PIN.fullmatch(line)
        if pin is None or pin[1] != f"xyz{(tilting or '?').lower()}c-trt-kins":
            raise BadInput(f"{name}: {line!r} is no pin of this machine's kinematics")
        pins[pin[2]] = float(pin[3])
    if tilting is None or len(pins) != 5:
        raise BadInput(f"{name}: five pins are wanted, x-rot-point to z-offset")
    across = _ACROSS[tilting]
    point = np.array([pins[f"{letter}-rot-point"] for letter in "xyz"])
    letter = "xyz"[across]
    turn, tilt = (np.array(machine.rotary(one).origin_mm) for one in ("C", tilting))
    return {
        "XOC": float(point[0] - turn[0]),
        "YOC": float(point[1] - turn[1]),
        f"{letter.upper()}O{tilting}": float(
            point[across] + pins[f"{letter}-offset"] - tilt[across]
        ),
        f"ZO{tilting}": float(point[2] + pins["z-offset"] - tilt[2]),
    }
