"""A result as files of a format, read back, and the account of what remains."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.compensation.error_map import ErrorMap, map_errors, tabulate_axis
from app.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
)
from app.compensation.remaining_error import (
    GRID,
    RANDOM,
    evaluate_effects,
    measure_lengths,
)
from app.errors import BadInput
from app.files.file_model import encode_json
from app.files.result_file import read_result
from app.files.units import UM_PER_MM
from app.files.verdict import verdict_json
from app.files.whole_files import replace_file
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
    before, after = measure_lengths(errors), measure_lengths(errors, correction)
    _require_gain(kind, before["mean"], after["mean"])
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
        "effects": list(evaluate_effects(errors, kind, tabulate, correction)),
    }
    return Export(files, account)


def _require_gain(kind: CompensationFormat, before_um: float, after_um: float) -> None:
    """Refuse files that do not make the error smaller."""
    if after_um > _BETTER * before_um:
        raise BadInput(
            f"read back by the rule of {kind.control}, the files take the mean "
            f"volumetric error from {before_um:.2f} to {after_um:.2f} µm; "
            "what it carries is below what it resolves: choose another format"
        )


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
