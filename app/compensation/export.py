"""A result as files of a format, read back, and the account of what remains.

The error that remains is computed on a grid and between the rows of the tables. For an
effect the files are written and read back once more without it: the difference is its
correction. That needs no knowledge of what a format does with sag, with a screw's wave
between its rows, or with lost motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.error_map import ErrorMap, map_errors, tabulate_axis
from app.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
    Correction,
)
from app.errors import BadInput
from app.files.file_model import encode_json
from app.files.result_file import read_result
from app.files.units import UM_PER_MM
from app.files.verdict import verdict_json
from app.files.whole_files import replace_file
from app.kinematics.model import CatalogueEffect
from app.kinematics.symbols import is_positioning
from app.numerics.rigid import cross_matrix
from app.plugins import load

GROUP = "truepath.compensation_formats"
SPACING_MM = 10.0
SCHEMA = "compensation/1"
_BETTER = 0.999  # of the error before: files that leave more are refused
GRID, RANDOM = 5, 400  # positions an axis of the grid; random positions
_NOTHING_MM = 1e-9
_SIDES = (1.0, -1.0)  # + and − direction


@dataclass(frozen=True, slots=True)
class Export:
    """Files by name, and their account.

    account : content of the JSON beside the files
    """

    files: dict[str, str]
    account: dict[str, Any]


def export_files(
    result: str | Path,
    name: str,
    output: str | Path,
    *,
    spacing_mm: float = SPACING_MM,
    accept_verdict: bool = False,
) -> dict[str, Any]:
    """Write the files of a format beside `output`, and their account as `STEM.json`.

    A single file is written to `output` itself; the names of several begin with the
    stem of `output`. Returns the account, `files` as paths.

    accept_verdict : write the files of a result that is not to be used all the same

    Raises BundleError with the place in the result, BadInput as `export_result`,
    NotUsable where the result is not to be used.
    """
    suffix, place = _load_format(name).suffix, Path(output)
    loaded = read_result(result)
    if not accept_verdict:
        loaded.verdict.require_usable(f"{result}: the result")
    errors = map_errors(loaded)
    export = export_result(errors, name, place.stem, spacing_mm=spacing_mm)
    place.parent.mkdir(parents=True, exist_ok=True)
    alone = len(export.files) == 1 and place.suffix not in ("", suffix)
    written: list[str] = []
    for file, text in export.files.items():
        target = place if alone else place.parent / file
        replace_file(target, text.encode("ascii"))
        written.append(str(target))
    account = {**export.account, "files": written}
    beside = place.parent / f"{place.stem}.json"
    replace_file(beside, encode_json(account, indent=1))
    return account


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
    before, after = _measure_lengths(errors), _measure_lengths(errors, correction)
    if after["mean"] > _BETTER * before["mean"]:
        raise BadInput(
            f"read back by the rule of {kind.control}, the files take the mean "
            f"volumetric error from {before['mean']:.2f} to {after['mean']:.2f} µm; "
            "what it carries is below what it resolves: choose another format"
        )
    account = {
        "schema": SCHEMA,
        "format": name,
        "control": kind.control,
        "files": list(files),
        **_describe_content(errors, kind, content.tables),
        "volumetric_error_um": {
            "before": before,
            "after": after,
            "on": f"{GRID} positions an axis and {RANDOM} random ones in the "
            "travel, coming up and coming down, without the rigid motion of the whole; "
            "of the map of the result, read back by the rule of the controller",
        },
        "note": kind.note,
        "effects": list(_evaluate_effects(errors, kind, tabulate, correction)),
    }
    return Export(files, account)


def _load_format(name: str) -> CompensationFormat:
    return load(GROUP, name)()


def _find_interpolation_loss_um(
    errors: ErrorMap, tables: tuple[AxisTable, ...]
) -> float:
    """Return the largest error of straight lines between rows, along the middle."""
    worst = 0.0
    for table in tables:
        at = 0.5 * (table.position_mm[1:] + table.position_mm[:-1])
        error = errors.error_mm(errors.move_axis(table.axis, at, errors.middle_mm))
        between = 0.5 * (table.mean_mm[1:] + table.mean_mm[:-1])
        lost = error - error.mean(axis=0) - between + between.mean(axis=0)
        worst = max(worst, float(np.abs(lost).max()))
    return UM_PER_MM * worst


def _write_stamp(errors: ErrorMap, name: str) -> tuple[str, ...]:
    """Return the comments of the files, in plain ASCII."""
    machine, provenance = errors.machine, errors.result.provenance
    verdict = errors.result.verdict
    offset = ", ".join(f"{v:g}" for v in machine.target().offset_mm)
    lines = (
        f"truepath compensation, format {name}",
        f"machine {machine.name}, chain {machine.chain}",
        f"for the tool at target offset {offset} mm",
        f"run {provenance.get('run', '')}, analysed {provenance.get('created', '')}",
        f"input {str(provenance.get('input_sha256', ''))[:16]}",
        *(["THE RESULT IS " + verdict.title.upper()] if verdict.objection else []),
    )
    kept = (line.encode("ascii", "replace").decode() for line in lines)
    return tuple(" ".join(line.replace("#", " ").split()) for line in kept)


def _describe_content(
    errors: ErrorMap, kind: CompensationFormat, tables: tuple[AxisTable, ...]
) -> dict[str, Any]:
    machine = errors.machine
    rotary = [axis.name for axis in machine.rotary_axes]
    return {
        "machine": machine.name,
        "kinematic_chain": machine.chain,
        "target_offset_mm": [list(t.offset_mm) for t in machine.targets],
        "holds_for": {
            "target": machine.target().name,
            "offset_mm": list(machine.target().offset_mm),
            "confounded": sorted(errors.result.model.confounded),
        },
        "provenance": errors.result.provenance,
        "verdict": verdict_json(errors.result.verdict),
        "sign": {"rule": kind.sign, "verified": kind.sign_is_verified},
        "carries": kind.carries,
        "not_carried": kind.not_carried
        + (f", rotary axes {', '.join(rotary)}" if rotary else ""),
        "unobservable": list(errors.result.unobservable),
        "tables": {
            t.axis.name: {
                "points": len(t.position_mm),
                "spacing_mm": t.spacing_mm,
                "from_mm": t.axis.low,
                "to_mm": t.axis.high,
            }
            for t in tables
        },
        "beyond_the_travel": "the controller holds the end values",
        "interpolation_loss_um": _find_interpolation_loss_um(errors, tables),
    }


def _sample_positions(errors: ErrorMap) -> Float64[np.ndarray, "n a"]:
    """Return a grid over the travel, and random positions between rows."""
    low = np.array([axis.low for axis in errors.axes])
    high = np.array([axis.high for axis in errors.axes])
    places = np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * len(low), indexing="ij")
    unit = np.stack(places, -1).reshape(-1, len(low))
    random = np.random.default_rng(0).random((RANDOM, len(low)))
    position = np.tile(errors.middle_mm, (len(unit) + RANDOM, 1))
    position[:, : len(low)] = low + np.vstack([unit, random]) * (high - low)
    return position


def remove_rigid_motion(
    position_mm: Float64[np.ndarray, "n a"], error_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Remove the best-fit rigid motion, which is not an error of the machine."""
    point = position_mm[:, :3] - position_mm[:, :3].mean(axis=0)
    shifts = np.broadcast_to(np.eye(3), (len(point), 3, 3))
    flat = np.concatenate([shifts, cross_matrix(point)], axis=2).reshape(-1, 6)
    fit, *_ = np.linalg.lstsq(flat, error_mm.reshape(-1), rcond=None)
    return error_mm - (flat @ fit).reshape(-1, 3)


def _measure_lengths(
    errors: ErrorMap, correction: Correction | None = None
) -> dict[str, float]:
    """Return mean and largest length, µm, of δ plus correction in both directions."""
    position = _sample_positions(errors)
    lengths: list[Float64[np.ndarray, " n"]] = []
    for side in _SIDES:
        error = errors.error_mm(position, side)
        if correction is not None:
            error = error + correction(position, side)
        lengths.append(np.linalg.norm(remove_rigid_motion(position, error), axis=1))
    every = UM_PER_MM * np.concatenate(lengths)
    return {"mean": float(every.mean()), "largest": float(every.max())}


def _evaluate_effects(
    errors: ErrorMap,
    kind: CompensationFormat,
    tabulate: Callable[[ErrorMap], CompensationTables],
    correction: Correction,
) -> Iterator[dict[str, Any]]:
    """Yield what remains of each effect of the model, as the account states it.

    tabulate : makes the tables that the format writes; correction : of its files

    The root mean square is that over both directions without rigid motion; it is 0
    where the effect depends on speed, temperature or the distance since a reversal.
    """
    position = _sample_positions(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = kind.read(kind.write(tabulate(other)), errors.machine)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in _SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in _SIDES]
        remains = [error + added for error, added in zip(own, done, strict=True)]
        before, after = _compute_rms(position, own), _compute_rms(position, remains)
        beyond = before < _NOTHING_MM
        if beyond:
            before = after = 0.0
        yield {
            "name": effect.family,
            **dict(effect.keys),
            "rms_um": {"before": UM_PER_MM * before, "after": UM_PER_MM * after},
            "note": "depends on more than place and direction: no table has it"
            if beyond
            else "",
        }


def _compute_rms(
    position: Float64[np.ndarray, "n a"], error_mm: Sequence[Float64[np.ndarray, "n 3"]]
) -> float:
    """Return the root mean square over both directions, without rigid motion."""
    every = remove_rigid_motion(np.vstack([position, position]), np.vstack(error_mm))
    return float(np.sqrt(3.0 * np.mean(every**2)))


def _remove_effect(errors: ErrorMap, effect: CatalogueEffect) -> ErrorMap:
    """Return the error map of the model without the effect."""
    theta = errors.result.theta.copy()
    theta[errors.result.model.slices[effect.name]] = 0.0
    half_um = dict(errors.result.half_difference_um)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half_um.pop(lost.axis.name, None)
    result = replace(errors.result, theta=theta, half_difference_um=half_um)
    return replace(errors, result=result)
