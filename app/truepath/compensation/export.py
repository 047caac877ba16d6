"""A result as files of a format, read back, and the account of what remains."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.compensation.active_files import GivenTables, find_basis
from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    Correction,
    Files,
)
from truepath.compensation.format_registry import load_format
from truepath.compensation.residual_error import (
    CLOSE,
    GRID,
    SIDES,
    ResidualError,
    compute_residual_error,
    remove_common_rigid_motion,
    sample_travel,
)
from truepath.compensation.rotary_residual import (
    describe_rotary,
    measure_over_axes,
    read_rotary_files,
)
from truepath.compensation.tables.error_map import (
    ErrorMap,
    MeasuredRange,
    Unmeasured,
    compute_measured_ranges,
    map_errors,
)
from truepath.compensation.tables.reference_temperature import (
    describe_lengths,
    find_measured_degc,
    state_lengths,
)
from truepath.compensation.tables.tabulation import (
    StatedTemperature,
    Tabulation,
    compute_interpolation_losses_mm,
)
from truepath.documents.file_model import as_object, encode_json, parse_json
from truepath.documents.whole_files import read_whole, replace_file
from truepath.errors import BadInput, BundleError
from truepath.files.earlier.temperature_file import read_result_at
from truepath.files.earlier.verdict import verdict_json
from truepath.files.units import UM_PER_MM
from truepath.kinematics.machine.symbols import is_positioning, is_turn
from truepath.kinematics.model import CatalogueEffect

SPACING_MM = 10.0
_UNDIRECTED = (
    "lost motion: the result does not state what the direction of travel does; what is "
    "left is stated without it"
)
_BETTER = 0.999  # of the error before: files with a larger remaining error are refused
_NOTHING_UM = 0.02  # rounding of the files, where there was no error
_NOTHING_GIVEN = GivenTables()
SCHEMA = "compensation/1"
_PLAIN_NAME = re.compile(r"[A-Za-z0-9._-]+")


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
    unmeasured: Unmeasured = Unmeasured.HOLD,
    choices: Mapping[str, str] | None = None,
    accept_verdict: bool = False,
    at_temperature_degc: float | None = None,
    given: GivenTables = _NOTHING_GIVEN,
) -> dict[str, Any]:
    """Write the files of a format next to `output`, and their account as `STEM.json`.

    A single file is written to `output` itself; the names of several begin with the
    stem of `output`. Returns the account, `files` as paths, their digests by name.

    unmeasured : content of tables where an axis was not measured
    choices : of the format, by name
    accept_verdict : write the files even if the result is not to be used
    at_temperature_degc : of a temperature model, which `result` may be as well
    given : tables of the control while the result was measured, if it compensated

    Raises BundleError with the place in the result, BadInput as `export_result` and
    `write_output`, NotUsable where the result is not to be used.
    """
    stem = _find_stem(output, load_format(name, choices).suffix)
    loaded, model = read_result_at(result, at_temperature_degc)
    if not accept_verdict:
        loaded.verdict.require_usable(f"{result}: the result")
    export = export_result(
        map_errors(loaded),
        name,
        stem,
        spacing_mm=spacing_mm,
        unmeasured=unmeasured,
        choices=choices,
        temperature=model and StatedTemperature(model, at_temperature_degc or 0.0),
        given=given,
    )
    return write_output(export.files, export.account, output, stem, source=result)


def export_result(
    errors: ErrorMap,
    name: str,
    stem: str,
    *,
    spacing_mm: float = SPACING_MM,
    unmeasured: Unmeasured = Unmeasured.HOLD,
    choices: Mapping[str, str] | None = None,
    temperature: StatedTemperature | None = None,
    given: GivenTables = _NOTHING_GIVEN,
) -> Export:
    """Files of a format and their account.

    name : of an installed format; stem : of the file names
    spacing_mm : of the rows, or the smallest that the controller's number of rows gives
    unmeasured : content of tables where an axis was not measured
    choices : of the format, by name
    temperature : where the errors are of a temperature model
    given : tables of the control while the errors were measured

    Raises BadInput for an unknown format or choice, where a part of the travel was not
    measured and is to be refused, or if the files, read back by the rule of the
    controller, do not make the error smaller.
    """
    kind = load_format(name, choices)
    chosen = {k: w[0] for k, w in kind.choices.items()} | dict(choices or {})
    provenance, machine = errors.result.provenance, errors.machine
    basis, active = find_basis(provenance, name, machine, chosen, given)
    measured = compute_measured_ranges(
        errors.machine, errors.result.measured, unmeasured
    )
    lengths_degc = find_measured_degc(provenance)
    if temperature:
        lengths_degc = temperature.at_degc, temperature.at_degc
    stamp = _write_stamp(errors, kind, name, measured, temperature, lengths_degc)
    stamp = (*stamp, f"holds {basis['holds']}: {basis['text']}")
    made = Tabulation(kind, stem, stamp, spacing_mm, measured, temperature, active)
    content, found = made.tabulate(errors), made.tabulate_found(errors)
    files = kind.write(content)
    added = kind.read(files, errors.machine)
    correction = made.subtract(added)
    rotary = read_rotary_files(kind, found, kind.write(found) if active else files)
    over = measure_over_axes(errors, correction, rotary)
    if over is not None:
        stamp = (*stamp, _describe_over_axes(over))
        files = kind.write(replace(content, stamp=stamp))
    tabulated = made.exclude_locations(errors)
    # Locations are in the correction only where it composes rotary and linear axes.
    corrected = errors if kind.composes_rotary else tabulated
    before = compute_residual_error(errors, measured)
    after = compute_residual_error(corrected, measured, correction)

    def reach_reversed_um() -> float:
        turned = made.subtract(lambda at, side: -added(at, side))
        left = compute_residual_error(corrected, measured, turned)
        return left.summarise_map(measured=True)["mean"]

    _require_gain(kind, before, after, over, reach_reversed_um)
    gaps = any(one.missing for one in measured.values())
    beyond_um = 0.0
    if gaps:
        every = made.extrapolate(corrected)
        reread = every.read_back(corrected)
        whole = compute_residual_error(corrected, every.measured, reread)
        beyond_um = after.compute_difference_um(whole)
    account = {
        "schema": SCHEMA,
        "format": name,
        "control": kind.control,
        "choices": chosen,
        "basis": basis,
        "files": list(files),
        **_describe_content(tabulated, kind, found.tables, measured),
        "over_all_axes_um": over,
        "rotary": describe_rotary(errors, rotary),
        "volumetric_error_um": _state_error(before, after),
        "left_um": _split_residual(tabulated, kind, found.tables, after, beyond_um),
        "note": kind.note,
        "stamp": list(stamp),
        "temperature": temperature
        and {
            "at_degC": temperature.at_degc,
            "measured_degC": list(temperature.model.measured_degc),
            "valid_degC": list(temperature.model.valid_degc),
            "carried": kind.temperature,
        },
        "effects": list(_evaluate_effects(errors, made, correction)),
        "lengths": state_lengths(lengths_degc),
    }
    return Export(files, account)


def _state_error(before: ResidualError, after: ResidualError) -> dict[str, Any]:
    return {
        "before": before.summarise_map(),
        "after": after.summarise(),
        "after_where_measured": after.summarise(measured=True),
        "on": f"mean over {CLOSE} positions that fill the travel evenly, largest "
        f"on a grid of {GRID} an axis too, coming up and coming down, without rigid "
        "motion of the whole; "
        "after: as the controller reads the files back, of errors that the "
        "measurement allows, drawn from its covariance; uncertainty k = 1",
    }


def _split_residual(
    errors: ErrorMap,
    kind: CompensationFormat,
    tables: tuple[AxisTable, ...],
    after: ResidualError,
    beyond_um: float,
) -> dict[str, float]:
    """Remaining error by its reasons, each as the root mean square of its length, µm.

    Squares of the parts that remain of the map add up to the square of `map`.
    """
    losses = compute_interpolation_losses_mm(errors, tables)
    squares = sum(3.0 * float(np.mean(np.square(lost))) for lost in losses)
    between_um = UM_PER_MM * math.sqrt(squares)
    rounding_um = kind.resolution_um * float(np.sqrt(len(tables) / 12.0))
    known = between_um**2 + rounding_um**2 + beyond_um**2
    return {
        "map": after.rms_um,
        "not_carried": float(np.sqrt(max(after.rms_um**2 - known, 0.0))),
        "between_rows": between_um,
        "rounding": rounding_um,
        "unmeasured_range": beyond_um,
        "not_known_by_the_measurement": after.unknown_um,
    }


def _require_gain(
    kind: CompensationFormat,
    before: ResidualError,
    after: ResidualError,
    over: Mapping[str, Any] | None,
    reach_reversed_um: Callable[[], float],
) -> None:
    """Raises BadInput if the files do not reduce the error where it was measured.

    over : the error over the travel of all axes, where some are rotary ones; it may
        improve alone, where linear axes do not get worse
    reach_reversed_um : mean error with the corrections reversed
    """
    before_um = before.summarise_map(measured=True)["mean"]
    after_um = after.summarise_map(measured=True)["mean"]
    gains = after_um <= _BETTER * before_um
    if over is not None and after_um <= before_um + _NOTHING_UM:
        gains |= over["after"] <= _BETTER * over["before"]
    if gains:
        return
    advice = "what it carries is below what it resolves: choose another format"
    if after_um > before_um + kind.resolution_um:
        advice = "choose another format, and run truepath plugins --check on this one"
        if (reversed_um := reach_reversed_um()) < before_um:
            advice = (
                f"with the opposite sign it would be {reversed_um:.2f} µm: the format "
                f"reverses the sign, in write or in read; {advice}"
            )
        else:
            advice = f"they make it worse: {advice}"
    raise BadInput(
        f"read back by the rule of {kind.control}, the files take the mean "
        f"volumetric error from {before_um:.2f} to {after_um:.2f} µm; {advice}"
    )


def _describe_content(
    errors: ErrorMap,
    kind: CompensationFormat,
    tables: tuple[AxisTable, ...],
    measured: Mapping[str, MeasuredRange],
) -> dict[str, Any]:
    machine = errors.machine
    losses = compute_interpolation_losses_mm(errors, tables)
    rotary = ", ".join(axis.name for axis in machine.rotary_axes)
    beyond = "rotary axes"
    if kind.carries_rotary:
        beyond = "what rotary axes do beside their positioning"
    if kind.composes_rotary:
        beyond = "the orientation of the tool by rotary axes"
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
        "units": kind.units,
        "directions": kind.directions,
        "carries": kind.carries,
        "not_carried": kind.not_carried + (f", {beyond} ({rotary})" if rotary else ""),
        "unobservable": [
            *errors.result.unobservable,
            *([] if errors.result.states_direction else [_UNDIRECTED]),
        ],
        "tables": {
            t.axis.name: {
                "points": len(t.position_mm),
                "spacing_mm": t.spacing_mm,
                "from_mm": t.axis.low,
                "to_mm": t.axis.high,
                "measured_from_mm": measured[t.axis.name].low,
                "measured_to_mm": measured[t.axis.name].high,
                "zero": f"at {t.position_mm[t.reference]:g} mm, come to in + direction",
            }
            for t in tables
        },
        "unmeasured": [
            one.describe() for one in measured.values() if not one.is_fully_measured
        ],
        "beyond_the_travel": "the controller holds the end values",
        "interpolation_loss_um": max(
            (UM_PER_MM * float(np.abs(lost).max()) for lost in losses), default=0.0
        ),
    }


def _evaluate_effects(
    errors: ErrorMap, made: Tabulation, correction: Correction
) -> Iterator[dict[str, Any]]:
    # What remains of each effect of the model. The files are written and read back
    # without it: the difference is its correction, whatever a format does with sag,
    # with a screw's wave between its rows, or with lost motion. 0 where the effect
    # depends on speed, temperature or the distance since a reversal.
    position, weight = sample_travel(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = made.read_back(other)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in SIDES]
        remains = [error + added for error, added in zip(own, done, strict=True)]
        before = _compute_rms(position, own, weight)
        after = _compute_rms(position, remains, weight)
        beyond = before < 1e-9
        if beyond:
            before = after = 0.0
        note = "depends on more than place and direction: no table has it"
        if effect.half_difference:
            note = "lost motion of a rotary axis: in the account of that axis"
        yield {
            "name": effect.family,
            **dict(effect.keys),
            "rms_um": {"before": UM_PER_MM * before, "after": UM_PER_MM * after},
            "note": note if beyond else "",
        }


def _compute_rms(
    position: Float64[np.ndarray, "n a"],
    error_mm: Sequence[Float64[np.ndarray, "n 3"]],
    weight: Float64[np.ndarray, " n"],
) -> float:
    every = remove_common_rigid_motion(position, error_mm, weight)
    return float(np.sqrt(weight @ (every**2).sum(axis=2).mean(axis=0)))


def _remove_effect(errors: ErrorMap, effect: CatalogueEffect) -> ErrorMap:
    theta = errors.result.theta.copy()
    theta[errors.result.model.slices[effect.name]] = 0.0
    halves, lost = dict(errors.result.halves), effect.half_difference
    # Lost motion of a rotary axis is in the account of that axis.
    if lost and not (is_positioning(lost.symbol) and is_turn(lost.symbol)):
        halves.pop(lost.symbol, None)
    result = replace(errors.result, theta=theta, halves=halves)
    return replace(errors, result=result)


def _write_stamp(
    errors: ErrorMap,
    kind: CompensationFormat,
    name: str,
    measured: Mapping[str, MeasuredRange],
    temperature: StatedTemperature | None,
    lengths_degc: tuple[float, float] | None,
) -> tuple[str, ...]:
    # The comments of files, in plain ASCII: their origin and content
    machine, provenance = errors.machine, errors.result.provenance
    verdict = errors.result.verdict
    celsius = f"measured at {_describe_temperature(provenance)}"
    if temperature:
        low, high = temperature.model.measured_degc
        celsius = (
            f"for a machine at {temperature.at_degc:.1f} degC, from results at "
            f"{low:.1f} to {high:.1f} degC"
        )
    offset = ", ".join(f"{v:g}" for v in machine.target().offset_mm)
    lines = (
        f"truepath compensation, format {name}",
        f"machine {machine.name}, chain {machine.chain}",
        f"for the tool at target offset {offset} mm",
        f"run {provenance.get('run', '')}, analysed {provenance.get('created', '')}",
        f"input {str(provenance.get('input_sha256', ''))[:16]}",
        celsius,
        describe_lengths(lengths_degc),
        f"valid over {', '.join(_list_ranges(errors, measured))}",
        f"units {kind.units}; directions of travel: {kind.directions}",
        f"carries {kind.carries}",
        f"sign ({'verified' if kind.sign_is_verified else 'to be tried'}): {kind.sign}",
        *(one.describe() for one in measured.values() if not one.is_fully_measured),
        *(["THE RESULT IS " + verdict.title.upper()] if verdict.objection else []),
    )
    kept = (line.encode("ascii", "replace").decode() for line in lines)
    return tuple(" ".join(line.replace("#", " ").split()) for line in kept)


def _describe_over_axes(over: Mapping[str, Any]) -> str:
    before, after = (
        f"{over[key]:.2f} +- {over[f'{word}_expanded_uncertainty']:.2f} um"
        for word, key in (("before", "before"), ("after", "after_expected"))
    )
    return (
        f"mean error over the travel of all axes {before}, with these files {after} "
        f"(k = {over['coverage_factor']:g})"
    )


def _list_ranges(
    errors: ErrorMap, measured: Mapping[str, MeasuredRange]
) -> Iterator[str]:
    for one in measured.values():
        travel = f"{one.low:g} to {one.high:g} mm"
        stated = travel if one.is_stated else "what the result does not state"
        yield f"{one.axis.name} {stated}"
    for axis in errors.machine.rotary_axes:
        low, high = errors.result.measured.get(axis.name, (axis.low, axis.high))
        yield f"{axis.name} {low:g} to {high:g} deg"


def _describe_temperature(provenance: Mapping[str, Any]) -> str:
    stated: Mapping[str, Sequence[float]] = provenance.get("temperature_degC") or {}
    shown = [f"{name} {low:.1f} to {high:.1f}" for name, (low, high) in stated.items()]
    return f"{', '.join(shown)} degC" if shown else "a temperature that nothing states"


def _find_stem(output: str | Path, suffix: str) -> str:
    place = Path(output)
    has_suffix = place.name.endswith(suffix)
    stem = place.name.removesuffix(suffix) if has_suffix else place.stem
    if _PLAIN_NAME.fullmatch(stem) is None:
        raise BadInput(
            f"{output}: {stem!r} stands in the files that controls read; use letters "
            "A to Z, digits, dots, dashes and underscores"
        )
    return stem


def write_output(
    files: Files,
    account: Mapping[str, Any],
    output: str | Path,
    stem: str,
    *,
    source: str | Path,
) -> dict[str, Any]:
    """Write files and their account, `STEM.json`; a single file to `output` itself.

    source : file that must not be overwritten

    Returns the account, `files` as paths, their digests by name.

    Raises BadInput where the files would replace the source, or the account a file that
    is none.
    """
    place = Path(output)
    beside = place.parent / f"{stem}.json"
    alone = len(files) == 1 and place.suffix != "" and place != beside
    targets = {
        place if alone else place.parent / file: text.encode("ascii")
        for file, text in files.items()
    }
    for target in (*targets, beside):
        if target.exists() and target.samefile(source):
            raise BadInput(
                f"{target}: would be written over, and is what the files are made of; "
                "give the output another name"
            )
    _require_account(beside)
    account = {
        **account,
        "files": [str(target) for target in targets],
        "files_sha256": {
            target.name: hashlib.sha256(data).hexdigest()
            for target, data in targets.items()
        },
    }
    text = encode_json(account, indent=1)  # before any file, for none without it
    place.parent.mkdir(parents=True, exist_ok=True)
    for target, data in targets.items():
        replace_file(target, data)
    replace_file(beside, text)
    return account


def _require_account(beside: Path) -> None:
    if not beside.exists():
        return
    try:
        schema = as_object(parse_json(read_whole(beside), str(beside))).get("schema")
    except BundleError:
        schema = None
    if schema != SCHEMA:
        raise BadInput(
            f"{beside}: the account of the files would be written over it, and it is "
            "none; give the output another name"
        )
