"""A result as files of a format, read back, and the account of what remains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.axis_tables import (
    AxisTable,
    CompensationTables,
    tabulate_axis,
)
from app.compensation.effect_residuals import evaluate_effects
from app.compensation.error_map import ErrorMap
from app.compensation.format import CompensationFormat, Correction
from app.compensation.sample_positions import (
    GRID,
    RANDOM,
    remove_rigid_motion,
    sample_positions,
)
from app.errors import BadInput
from app.files.units import UM_PER_MM
from app.plugins import load

GROUP = "truepath.compensation_formats"
SPACING_MM = 10.0
SCHEMA = "compensation/1"
_BETTER = 0.999  # of the error before: files that leave more are refused


@dataclass(frozen=True, slots=True)
class Export:
    """Files by name, and their account.

    account : content of the JSON beside the files
    """

    files: dict[str, str]
    account: dict[str, Any]


@dataclass(frozen=True, slots=True)
class ErrorLength:
    """Length of the volumetric error without its rigid motion, µm."""

    mean_um: float
    largest_um: float


def find_suffix(name: str) -> str:
    """Return the suffix of a format's files. Raises BadInput for an unknown one."""
    return _load_format(name).suffix


def export_result(
    errors: ErrorMap, name: str, stem: str, *, spacing_mm: float = SPACING_MM
) -> Export:
    """Return the files of a format and their account.

    name : of an installed format; stem : of the file names
    spacing_mm : of the rows, or the smallest that the controller's number of rows gives

    Raises BadInput for an unknown format, or if the files, read back by the rule of the
    controller, do not make the error smaller.
    """
    kind = _load_format(name)
    stamp = _write_stamp(errors, name)

    def tabulate(of: ErrorMap) -> CompensationTables:
        most = kind.most_points
        tables = tuple(tabulate_axis(of, axis, spacing_mm, most) for axis in of.axes)
        return CompensationTables(stem, of.machine, tables, stamp)

    content = tabulate(errors)
    files = kind.write(content)
    correction = kind.read(files, errors.machine)
    before, after = _measure(errors, None), _measure(errors, correction)
    if after.mean_um > _BETTER * before.mean_um:
        raise BadInput(
            f"read back by the rule of {kind.control}, the files take the mean "
            f"volumetric error from {before.mean_um:.2f} to {after.mean_um:.2f} µm; "
            "what it carries is below what it resolves: choose another format"
        )
    account = _write_account(
        errors, name, kind, content.tables, before, after, list(files)
    )
    effects = [
        one.to_json() for one in evaluate_effects(errors, kind, tabulate, correction)
    ]
    return Export(files, {**account, "effects": effects})


def _load_format(name: str) -> CompensationFormat:
    return load(GROUP, name)()


def _measure(errors: ErrorMap, correction: Correction | None) -> ErrorLength:
    """Return the length of δ plus correction over both directions."""
    position = sample_positions(errors)
    lengths: list[Float64[np.ndarray, " n"]] = []
    for direction in (1.0, -1.0):
        error = errors.error_mm(position, direction)
        if correction is not None:
            error = error + correction(position, direction)
        lengths.append(np.linalg.norm(remove_rigid_motion(position, error), axis=1))
    every = UM_PER_MM * np.concatenate(lengths)
    return ErrorLength(float(every.mean()), float(every.max()))


def _find_interpolation_loss_um(
    errors: ErrorMap, tables: tuple[AxisTable, ...]
) -> float:
    """Return the largest error of straight lines between rows, along the middle."""
    worst = 0.0
    for table in tables:
        at = 0.5 * (table.position_mm[1:] + table.position_mm[:-1])
        place = np.tile(errors.middle_mm, (len(at), 1))
        place[:, errors.machine.axis_names.index(table.axis.name)] = at
        error = errors.error_mm(place)
        between = 0.5 * (table.mean_mm[1:] + table.mean_mm[:-1])
        lost = error - error.mean(axis=0) - between + between.mean(axis=0)
        worst = max(worst, float(np.abs(lost).max()))
    return UM_PER_MM * worst


def _write_stamp(errors: ErrorMap, name: str) -> tuple[str, ...]:
    """Return the comments of the files, in plain ASCII."""
    result = errors.result
    offsets = "; ".join(
        ", ".join(f"{v:g}" for v in target.offset_mm)
        for target in errors.machine.targets
    )
    lines = (
        f"truepath compensation, format {name}",
        f"machine {errors.machine.name}, chain {errors.machine.chain}",
        f"target offset {offsets} mm",
        f"run {result.provenance.get('run', '')}, analysed "
        f"{result.provenance.get('created', '')}",
        f"input {str(result.provenance.get('input_sha256', ''))[:16]}",
    )
    kept = (line.encode("ascii", "replace").decode() for line in lines)
    return tuple(" ".join(line.replace("#", " ").split()) for line in kept)


def _write_account(
    errors: ErrorMap,
    name: str,
    kind: CompensationFormat,
    tables: tuple[AxisTable, ...],
    before: ErrorLength,
    after: ErrorLength,
    files: list[str],
) -> dict[str, Any]:
    machine = errors.machine
    rotary = [axis.name for axis in machine.rotary_axes]
    return {
        "schema": SCHEMA,
        "format": name,
        "control": kind.control,
        "files": files,
        "machine": machine.name,
        "kinematic_chain": machine.chain,
        "target_offset_mm": [list(t.offset_mm) for t in machine.targets],
        "provenance": errors.result.provenance,
        "sign": {"rule": kind.sign, "verified": kind.sign_is_verified},
        "carries": kind.carries,
        "not_carried": kind.not_carried
        + (f", rotary axes {', '.join(rotary)}" if rotary else ""),
        "unobservable": list(errors.result.unobservable),
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
        "interpolation_loss_um": _find_interpolation_loss_um(errors, tables),
        "volumetric_error_um": {
            "before": {"mean": before.mean_um, "largest": before.largest_um},
            "after": {"mean": after.mean_um, "largest": after.largest_um},
            "on": f"{GRID} positions an axis and {RANDOM} random ones in the "
            "travel, coming up and coming down, without the rigid motion of the whole; "
            "of the map of the result, read back by the rule of the controller",
        },
        "note": kind.note,
    }
