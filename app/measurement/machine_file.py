"""`machine.json` (schema `machine/1` of the file formats) to and from a `Machine`.

Keys that the schema does not know are tolerated and kept out. Anything wrong with a
known key is one BundleError that names file, key, value and remedy.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from app.errors import BundleError
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

Json = Mapping[str, Any]


def read_machine(path: str | Path) -> Machine:
    """Read a machine file from disk."""
    file = Path(path)
    try:
        data = file.read_bytes()
    except OSError as error:
        raise BundleError(
            f"cannot be read ({error.strerror})",
            file=str(path),
            remedy="check the path",
        ) from error
    return decode_machine(data, file=file.name)


def decode_machine(data: bytes, *, file: str = "machine.json") -> Machine:
    """Return the machine that the bytes of a machine file state."""
    try:
        content = json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise BundleError(
            f"is not text in UTF-8 (byte {error.start})",
            file=file,
            remedy="save as UTF-8",
        ) from error
    except json.JSONDecodeError as error:
        raise BundleError(
            f"is not JSON: {error.msg} at character {error.colno}",
            file=file,
            row=error.lineno,
            remedy="correct that line",
        ) from error
    except RecursionError as error:
        raise BundleError("is nested too deeply", file=file) from error
    return machine_from_json(content, file=file)


def machine_from_json(content: object, *, file: str = "machine.json") -> Machine:
    """Return the machine that parsed JSON states."""
    top = _Field(file, "", content).mapping()
    schema = top.child("schema")
    if schema.value != SCHEMA:
        raise schema.error(f"is {_shown(schema.value)}", f'write "schema": "{SCHEMA}"')
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


class _Field:
    """A value of the file and the way to it, `axes.X.min_mm`."""

    def __init__(self, file: str, path: str, value: object) -> None:
        self.file, self.path, self.value = file, path, value

    def error(self, problem: str, remedy: str = "") -> BundleError:
        where = f"{self.path} " if self.path else ""
        return BundleError(f"{where}{problem}", file=self.file, remedy=remedy)

    def mapping(self) -> _Fields:
        if not isinstance(self.value, Mapping):
            raise self.error(f"is {_shown(self.value)}", "write an object, {…}")
        return _Fields(self.file, self.path, self.value)

    def text(self) -> str:
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"is {_shown(self.value)}", "write a text")
        return self.value

    def number(self, *, lowest: float = -math.inf, above: bool = False) -> float:
        """Return a finite number, not below (with `above`, greater than) `lowest`."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"is {_shown(value)}", "write a number")
        if not -sys.float_info.max <= value <= sys.float_info.max:
            raise self.error("is not finite", "write a finite number")
        if value < lowest or (above and value <= lowest):
            bound = f"above {lowest:g}" if above else f"{lowest:g} or more"
            raise self.error(f"is {value:g}", f"it must be {bound}")
        return float(value)

    def vector(self) -> tuple[float, float, float]:
        value = self.value
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise self.error(f"is {_shown(value)}", "write three numbers, [x, y, z]")
        x, y, z = (
            _Field(self.file, f"{self.path}[{i}]", v).number()
            for i, v in enumerate(value)
        )
        return x, y, z

    def choice(self, allowed: tuple[str, ...]) -> str:
        if self.value not in allowed:
            raise self.error(
                f"is {_shown(self.value)}", f"write one of {', '.join(allowed)}"
            )
        return str(self.value)


class _Fields:
    """An object of the file and the way to it."""

    def __init__(self, file: str, path: str, values: Json) -> None:
        self.file, self.path, self.values = file, path, values

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def child(self, key: str, *, default: object = None) -> _Field:
        value = self.values.get(key, default)
        path = f"{self.path}.{key}" if self.path else key
        if value is None:
            raise BundleError(f"{path} is missing", file=self.file, remedy="add it")
        return _Field(self.file, path, value)

    def children(self) -> list[tuple[str, _Field]]:
        return [(key, self.child(key)) for key in self.values]


def _shown(value: object) -> str:
    """Quote a value as JSON, shortened."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "…"


def _axes(fields: _Fields) -> tuple[Axis, ...]:
    found = {key: _axis(key, field) for key, field in fields.children()}
    missing = [name for name in LINEAR_NAMES if name not in found]
    if missing:
        raise BundleError(
            f"axes.{missing[0]} is missing", file=fields.file, remedy="add the axis"
        )
    return tuple(found[n] for n in LINEAR_NAMES + ROTARY_NAMES if n in found)


def _axis(name: str, field: _Field) -> Axis:
    if name not in LINEAR_NAMES + ROTARY_NAMES:
        raise field.error(
            "is an unknown axis", "linear axes are X, Y, Z; rotary axes are A, B, C"
        )
    fields = field.mapping()
    kind = fields.child("type")
    wanted = "linear" if name in LINEAR_NAMES else "rotary"
    if kind.value != wanted:
        raise kind.error(f"is {_shown(kind.value)}", f'axis {name} is "{wanted}"')
    return _linear(name, fields) if wanted == "linear" else _rotary(name, fields)


def _linear(name: str, fields: _Fields) -> LinearAxis:
    return LinearAxis(name, *_travel(fields, "min_mm", "max_mm"))


def _rotary(name: str, fields: _Fields) -> RotaryAxis:
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


def _travel(fields: _Fields, low: str, high: str) -> tuple[float, float]:
    lowest, highest = fields.child(low).number(), fields.child(high)
    if highest.number() <= lowest:
        raise highest.error(
            f"is {highest.number():g}", f"it must exceed {low}, {lowest:g}"
        )
    return lowest, highest.number()


def _chain(
    field: _Field, axes: tuple[Axis, ...]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split `w-…-b-…-t` at the base."""
    text = field.text()
    parts = text.split("-")
    if parts[0] != "w" or parts[-1] != "t" or parts.count("b") != 1:
        raise field.error(
            f"is {_shown(text)}", "write w-…-b-…-t, workpiece to tool, one base"
        )
    base = parts.index("b")
    sides = tuple(parts[1:base]), tuple(parts[base + 1 : -1])
    named, known = sorted(sides[0] + sides[1]), sorted(axis.name for axis in axes)
    if named != known:
        raise field.error(
            f"is {_shown(text)} but the axes are {', '.join(known)}",
            "name every axis once",
        )
    return sides


def _targets(top: _Fields) -> tuple[Target, ...]:
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


def _target(name: str, field: _Field) -> Target:
    if not name.strip():
        raise field.error("has no name", "name every target")
    fields = field.mapping()
    side = fields.child("on").choice(_SIDES)
    return Target(name, side, fields.child("offset_mm").vector())


def _tracker(fields: _Fields) -> TrackerNoise:
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
