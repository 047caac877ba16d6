"""A result as files of a format, read back, and the account of what stays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.carried import carried_effects
from app.compensation.format import CompensationFormat, Correction
from app.compensation.order import (
    AxisTable,
    CompensationOrder,
    axis_table,
)
from app.compensation.places import (
    ANYWHERE,
    GRID,
    positions,
    without_rigid,
)
from app.compensation.source import Source
from app.errors import BadInput
from app.files.units import UM_PER_MM
from app.plugins import load

GROUP = "truepath.compensation_formats"
SPACING_MM = 10.0
SCHEMA = "compensation/1"
_BETTER = 0.999  # of the error before: a file that leaves more is not worth loading


@dataclass(frozen=True, slots=True)
class Export:
    """Files by name, and what goes with them.

    account : content of the JSON beside the files
    """

    files: dict[str, str]
    account: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Left:
    """Length of the volumetric error without its rigid motion, in µm."""

    mean_um: float
    largest_um: float


def suffix_of(name: str) -> str:
    """Return the suffix of a format's files. Raises BadInput for an unknown one."""
    return _format(name).suffix


def export_result(
    source: Source, name: str, stem: str, *, spacing_mm: float = SPACING_MM
) -> Export:
    """Return the files of a format and their account.

    name : of an installed format; stem : of the file names
    spacing_mm : of the rows, or the smallest that the controller's number of rows gives

    Raises BadInput for an unknown format, or if the files, read back by the rule of the
    controller, do not make the error smaller.
    """
    kind = _format(name)
    stamp = _stamp(source, name)

    def ordered(of: Source) -> CompensationOrder:
        most = kind.most_points
        tables = tuple(axis_table(of, axis, spacing_mm, most) for axis in of.axes)
        return CompensationOrder(stem, of.machine, tables, stamp)

    order = ordered(source)
    files = kind.write(order)
    correction = kind.read(files, source.machine)
    before, after = _left(source, None), _left(source, correction)
    if after.mean_um > _BETTER * before.mean_um:
        raise BadInput(
            f"read back by the rule of {kind.control}, the files take the mean "
            f"volumetric error from {before.mean_um:.2f} to {after.mean_um:.2f} µm; "
            "what it carries is below what it resolves: choose another format"
        )
    account = _account(source, name, kind, order.tables, before, after, list(files))
    effects = [
        one.in_words() for one in carried_effects(source, kind, ordered, correction)
    ]
    return Export(files, {**account, "effects": effects})


def _format(name: str) -> CompensationFormat:
    return load(GROUP, name)()


def _left(source: Source, correction: Correction | None) -> Left:
    """Return what δ and the correction leave, coming up and coming down."""
    position = positions(source)
    lengths: list[Float64[np.ndarray, " n"]] = []
    for direction in (1.0, -1.0):
        error = source.error_mm(position, direction)
        if correction is not None:
            error = error + correction(position, direction)
        lengths.append(np.linalg.norm(without_rigid(position, error), axis=1))
    every = UM_PER_MM * np.concatenate(lengths)
    return Left(float(every.mean()), float(every.max()))


def _interpolation_loss_um(source: Source, tables: tuple[AxisTable, ...]) -> float:
    """Return what straight lines between rows lose at most, along the middle."""
    worst = 0.0
    for table in tables:
        at = 0.5 * (table.position_mm[1:] + table.position_mm[:-1])
        place = np.tile(source.middle_mm(), (len(at), 1))
        place[:, source.machine.axis_names.index(table.axis.name)] = at
        error = source.error_mm(place)
        between = 0.5 * (table.mean_mm[1:] + table.mean_mm[:-1])
        lost = error - error.mean(axis=0) - between + between.mean(axis=0)
        worst = max(worst, float(np.abs(lost).max()))
    return UM_PER_MM * worst


def _stamp(source: Source, name: str) -> tuple[str, ...]:
    """Return what comments of the files say, in plain ASCII."""
    result = source.result
    offsets = "; ".join(
        ", ".join(f"{v:g}" for v in target.offset_mm)
        for target in source.machine.targets
    )
    lines = (
        f"truepath compensation, format {name}",
        f"machine {source.machine.name}, chain {source.machine.chain}",
        f"target offset {offsets} mm",
        f"run {result.provenance.get('run', '')}, analysed "
        f"{result.provenance.get('created', '')}",
        f"input {str(result.provenance.get('input_sha256', ''))[:16]}",
    )
    kept = (line.encode("ascii", "replace").decode() for line in lines)
    return tuple(" ".join(line.replace("#", " ").split()) for line in kept)


def _account(
    source: Source,
    name: str,
    kind: CompensationFormat,
    tables: tuple[AxisTable, ...],
    before: Left,
    after: Left,
    files: list[str],
) -> dict[str, Any]:
    machine = source.machine
    rotary = [axis.name for axis in machine.rotary_axes]
    return {
        "schema": SCHEMA,
        "format": name,
        "control": kind.control,
        "files": files,
        "machine": machine.name,
        "kinematic_chain": machine.chain,
        "target_offset_mm": [list(t.offset_mm) for t in machine.targets],
        "provenance": source.result.provenance,
        "sign": {"rule": kind.sign, "verified": kind.sign_is_verified},
        "carries": kind.carries,
        "not_carried": kind.not_carried
        + (f", rotary axes {', '.join(rotary)}" if rotary else ""),
        "unobservable": list(source.result.unobservable),
        "tables": {
            t.axis.name: {
                "points": len(t.position_mm),
                "spacing_mm": t.spacing_mm,
                "from_mm": t.axis.min_mm,
                "to_mm": t.axis.max_mm,
            }
            for t in tables
        },
        "beyond_the_travel": "the controller holds the end values",
        "interpolation_loss_um": _interpolation_loss_um(source, tables),
        "volumetric_error_um": {
            "before": {"mean": before.mean_um, "largest": before.largest_um},
            "after": {"mean": after.mean_um, "largest": after.largest_um},
            "on": f"{GRID} positions an axis and {ANYWHERE} random ones in the "
            "travel, coming up and coming down, without the rigid motion of the whole; "
            "of the map of the result, read back by the rule of the controller",
        },
        "note": kind.note,
    }
