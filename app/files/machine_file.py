"""`machine.json` (schema `machine/1` of the file formats) to and from a `Machine`.

Keys that the schema does not know are tolerated and kept out. Anything wrong with a
known key is one BundleError that names file, key, value and remedy.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from app.errors import BundleError
from app.files.json_fields import Field, Fields, parse_json, shown
from app.files.whole_files import read_whole
from app.kinematics.machine import (
    Axis,
    LinearAxis,
    Machine,
    RotaryAxis,
    Target,
    TrackerNoise,
)

SCHEMA = "machine/1"
LINEAR_NAMES = ("X", "Y", "Z")
ROTARY_NAMES = ("A", "B", "C")
_DIRECTIONS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}
_SIDES = ("tool", "workpiece")
_STANDS = ("workpiece", "base")


def read_machine(path: str | Path) -> Machine:
    """Read a machine file from disk."""
    return decode_machine(read_whole(path), file=Path(path).name)


def decode_machine(data: bytes, *, file: str = "machine.json") -> Machine:
    """Return the machine that the bytes of a machine file state."""
    return machine_from_json(parse_json(data, file), file=file)


def machine_from_json(
    content: object, *, file: str = "machine.json", key: str = ""
) -> Machine:
    """Return the machine that parsed JSON states.

    key : where in the file the machine stands, empty for a file of its own
    """
    top = Field(file, key, content).mapping()
    schema = top.child("schema")
    if schema.value != SCHEMA:
        raise schema.error(f"is {shown(schema.value)}", f'write "schema": "{SCHEMA}"')
    axes = _axes(top.child("axes").mapping())
    workpiece_side, tool_side = _chain(top.child("kinematic_chain"), axes)
    return Machine(
        name=top.child("name", default="machine").text(),
        workpiece_side=workpiece_side,
        tool_side=tool_side,
        axes=axes,
        targets=_targets(top),
        tracker=_tracker(top.child("tracker", default={}).mapping()),
    )


def machine_to_json(machine: Machine) -> dict[str, Any]:
    """Return the content of the machine file of a machine."""
    noise = machine.tracker
    return {
        "schema": SCHEMA,
        "name": machine.name,
        "kinematic_chain": machine.chain,
        "axes": {axis.name: _axis_json(axis) for axis in machine.axes},
        **_targets_json(machine.targets),
        "tracker": {
            "range_sigma_um": noise.range_sigma_um,
            "range_ppm": noise.range_ppm,
            "angle_sigma_urad": noise.angle_sigma_urad,
            "transverse_sigma_um": noise.transverse_sigma_um,
            "rate_hz": noise.rate_hz,
            "stands_on": noise.stands_on,
        },
    }


def encode_machine(machine: Machine) -> bytes:
    """Return the bytes of the machine file of a machine."""
    text = json.dumps(machine_to_json(machine), indent=1, ensure_ascii=False)
    return (text + "\n").encode()


def _axes(fields: Fields) -> tuple[Axis, ...]:
    found = {key: _axis(key, field) for key, field in fields.children()}
    missing = [name for name in LINEAR_NAMES if name not in found]
    if missing:
        raise BundleError(
            f"axes.{missing[0]} is missing", file=fields.file, remedy="add the axis"
        )
    return tuple(found[n] for n in LINEAR_NAMES + ROTARY_NAMES if n in found)


def _axis(name: str, field: Field) -> Axis:
    if name not in LINEAR_NAMES + ROTARY_NAMES:
        raise field.error(
            "is an unknown axis", "linear axes are X, Y, Z; rotary axes are A, B, C"
        )
    fields = field.mapping()
    kind = fields.child("type")
    wanted = "linear" if name in LINEAR_NAMES else "rotary"
    if kind.value != wanted:
        raise kind.error(f"is {shown(kind.value)}", f'axis {name} is "{wanted}"')
    return _linear(name, fields) if wanted == "linear" else _rotary(name, fields)


def _linear(name: str, fields: Fields) -> LinearAxis:
    return LinearAxis(name, *_travel(fields, "min_mm", "max_mm"))


def _rotary(name: str, fields: Fields) -> RotaryAxis:
    direction = fields.child("direction", default=_DIRECTIONS[name])
    vector = direction.vector()
    length = math.hypot(*vector)
    if length == 0:
        raise direction.error("is [0, 0, 0]", "write a direction of any length")
    x, y, z = (component / length for component in vector)
    return RotaryAxis(
        name,
        *_travel(fields, "min_deg", "max_deg"),
        origin_mm=fields.child("origin_mm", default=(0.0, 0.0, 0.0)).vector(),
        direction=(x, y, z),
    )


def _travel(fields: Fields, low: str, high: str) -> tuple[float, float]:
    lowest, highest = fields.child(low).number(), fields.child(high)
    if highest.number() <= lowest:
        raise highest.error(
            f"is {highest.number():g}", f"it must exceed {low}, {lowest:g}"
        )
    return lowest, highest.number()


def _chain(
    field: Field, axes: tuple[Axis, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split `w-…-b-…-t` at the base."""
    text = field.text()
    parts = text.split("-")
    if parts[0] != "w" or parts[-1] != "t" or parts.count("b") != 1:
        raise field.error(
            f"is {shown(text)}", "write w-…-b-…-t, workpiece to tool, one base"
        )
    base = parts.index("b")
    sides = tuple(parts[1:base]), tuple(parts[base + 1 : -1])
    named, known = sorted(sides[0] + sides[1]), sorted(axis.name for axis in axes)
    if named != known:
        raise field.error(
            f"is {shown(text)} but the axes are {', '.join(known)}",
            "name every axis once",
        )
    return sides


def _targets(top: Fields) -> tuple[Target, ...]:
    """Return the targets; the target of `tool_offset_mm` has no name."""
    if "targets" not in top:
        offset = top.child("tool_offset_mm")
        return (Target("", "tool", offset.vector()),)
    if "tool_offset_mm" in top:
        raise top.child("tool_offset_mm").error(
            "stands beside targets", "keep one of the two"
        )
    fields = top.child("targets").mapping().children()
    if not fields:
        raise top.child("targets").error("is empty", "name at least one target")
    return tuple(_target(name, field) for name, field in fields)


def _target(name: str, field: Field) -> Target:
    if not name.strip():
        raise field.error("has no name", "name every target")
    fields = field.mapping()
    side = fields.child("on").choice(_SIDES)
    return Target(name, side, fields.child("offset_mm").vector())


def _tracker(fields: Fields) -> TrackerNoise:
    plain = TrackerNoise()
    transverse = fields.child("transverse_sigma_um", default=plain.transverse_sigma_um)
    angle = fields.child("angle_sigma_urad", default=plain.angle_sigma_urad)
    along = fields.child("range_sigma_um", default=plain.range_sigma_um)
    rate = fields.child("rate_hz", default=plain.rate_hz)
    if transverse.number(lowest=0.0) == angle.number(lowest=0.0) == 0.0:
        raise transverse.error(
            "and angle_sigma_urad are both 0", "state the noise across the beam"
        )
    return TrackerNoise(
        range_sigma_um=along.number(lowest=0.0, above=True),
        range_ppm=fields.child("range_ppm", default=plain.range_ppm).number(lowest=0.0),
        angle_sigma_urad=angle.number(),
        transverse_sigma_um=transverse.number(),
        rate_hz=rate.number(lowest=0.0, above=True),
        stands_on=fields.child("stands_on", default=plain.stands_on).choice(_STANDS),
    )


def _axis_json(axis: Axis) -> dict[str, Any]:
    if isinstance(axis, LinearAxis):
        return {"type": "linear", "min_mm": axis.min_mm, "max_mm": axis.max_mm}
    return {
        "type": "rotary",
        "min_deg": axis.min_deg,
        "max_deg": axis.max_deg,
        "origin_mm": list(axis.origin_mm),
        "direction": list(axis.direction),
    }


def _targets_json(targets: tuple[Target, ...]) -> dict[str, Any]:
    if len(targets) == 1 and not targets[0].name and targets[0].on == "tool":
        return {"tool_offset_mm": list(targets[0].offset_mm)}
    return {
        "targets": {
            target.name: {"on": target.on, "offset_mm": list(target.offset_mm)}
            for target in targets
        }
    }
