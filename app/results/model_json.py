"""The estimated model in files: knots, control values and their covariance.

Each effect states numbers that mean something without this program: the values of a
spline at its knots, an angle. They are linear in the parameters, s = G θ, so their
covariance is G C Gᵀ; G's columns are orthogonal, and reading takes θ = G⁺ s back to
rounding. The basis of a gauge is a matter of the linear algebra at hand and stays out
of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.files.json_fields import Field, Fields
from app.kinematics.effects.axis_location import AxisLocation, axis_locations
from app.kinematics.effects.base import Effect, Role
from app.kinematics.effects.catalogued import Catalogued
from app.kinematics.effects.error_motion import ErrorMotion, error_motion_over
from app.kinematics.effects.squareness import squareness_between
from app.kinematics.machine import Axis, Machine, RotaryAxis
from app.kinematics.model import MachineModel
from app.kinematics.symbols import SQUARENESS, error_motions, is_turn, unit
from app.results.catalogued_json import (
    CATALOGUED,
    catalogued_from_json,
    catalogued_json,
    unit_of,
)
from app.results.error_tables import MICRO, MILLI
from app.results.packing import ENCODING, pack_symmetric, unpack_symmetric

SCHEMA = "model/1"
_MOST = 20_000  # stated numbers; a larger covariance would not fit in memory
_FEWEST_KNOTS, _MOST_KNOTS = 3, 2_000


@dataclass(frozen=True, slots=True)
class SavedModel:
    """Parameters of a model with their covariance, as read from a file."""

    model: MachineModel
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]


def model_to_json(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> dict[str, Any]:
    """Return the model as JSON, lengths in mm, errors in µm and µrad.

    What belongs to the measurement (how the targets sit in the spindle) is integrated
    out: to the map of one target it adds a shift, which is no machine error.
    """
    model, theta, covariance = _of_the_machine(model, theta, covariance)
    G = stated(model)
    values = G @ theta
    catalogued = {e.name: e for e in model.catalogued}
    effects: list[dict[str, Any]] = []
    begin = 0
    for effect in model.effects:
        size = _rows(effect).shape[0]
        known = catalogued.get(effect.name)
        effects.append(_effect_json(effect, known, values[begin : begin + size]))
        begin += size
    return {
        "schema": SCHEMA,
        "effects": effects,
        "covariance": {
            "of": "the numbers of the effects, one effect after another",
            "size": len(values),
            "encoding": ENCODING,
            "data": pack_symmetric(G @ covariance @ G.T),
        },
    }


def model_from_json(field: Field, machine: Machine) -> SavedModel:
    """Return the model that the file states. Raises BundleError with the place."""
    content = field.mapping()
    content.child("schema").choice((SCHEMA,))
    effects: list[Effect] = []
    numbers: list[Float64[np.ndarray, " k"]] = []
    for element in content.child("effects").elements():
        effect, values = _effect_from_json(element, machine)
        if effect.name in (e.name for e in effects):
            raise element.error(f"repeats {effect.name}", "state each effect once")
        effects.append(effect)
        numbers.append(values)
    model = MachineModel(machine, tuple(effects))
    G = stated(model)
    back = (G / np.sum(G**2, axis=0)).T  # G⁺, its columns being orthogonal
    values = np.concatenate([*numbers, np.empty(0)])
    covariance = _covariance(content.child("covariance").mapping(), len(values))
    return SavedModel(model, back @ values, back @ covariance @ back.T)


def _of_the_machine(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[MachineModel, Float64[np.ndarray, " m"], Float64[np.ndarray, "m m"]]:
    effects = tuple(e for e in model.effects if e.role is Role.MACHINE)
    kept = np.concatenate(
        [np.arange(model.size)[model.slices[e.name]] for e in effects]
    )
    machine_model = MachineModel(model.machine, effects)
    return machine_model, theta[kept], covariance[np.ix_(kept, kept)]


def stated(model: MachineModel) -> Float64[np.ndarray, "s p"]:
    """Return G of all effects: their stated numbers per parameter."""
    blocks = [_rows(effect) for effect in model.effects]
    G = np.zeros((sum(len(b) for b in blocks), model.size))
    begin = 0
    for effect, block in zip(model.effects, blocks, strict=True):
        G[begin : begin + len(block), model.slices[effect.name]] = block
        begin += len(block)
    return G


def _rows(effect: Effect) -> Float64[np.ndarray, "s p"]:
    if motion := effect.motion:
        return (MICRO if is_turn(motion.symbol) else MILLI) * motion.gauge
    return np.diag([unit_of(p)[1] for p in effect.parameters])


def _effect_json(
    effect: Effect, known: Catalogued | None, values: Float64[np.ndarray, " s"]
) -> dict[str, Any]:
    """Return one effect with its stated values. known : it, if it has a family."""
    symbol = effect.iso_symbol
    if motion := effect.motion:
        return {
            "effect": "error-motion",
            "symbol": symbol,
            _knots_key(motion.axis): motion.spline.knots.tolist(),
            _values_key(symbol): values.tolist(),
        }
    if known:
        return catalogued_json(known, values)
    if not symbol:
        raise TypeError(f"{effect.name} has no form in a result file")
    kind = "squareness" if symbol in SQUARENESS else "axis-location"
    key = f"value_{unit(symbol)}"
    return {"effect": kind, "symbol": symbol, key: float(values[0])}


def _knots_key(axis: Axis) -> str:
    return "knots_deg" if isinstance(axis, RotaryAxis) else "knots_mm"


def _values_key(symbol: str) -> str:
    return "values_urad" if is_turn(symbol) else "values_um"


def _effect_from_json(
    field: Field, machine: Machine
) -> tuple[Effect, Float64[np.ndarray, " s"]]:
    content = field.mapping()
    kind = content.child("effect").choice(
        ("error-motion", "squareness", "axis-location", CATALOGUED)
    )
    if kind == "error-motion":
        return _error_motion(content, machine)
    if kind == CATALOGUED:
        return catalogued_from_json(content, machine)
    if kind == "axis-location":
        return _axis_location(content, machine)
    known = {s.symbol: s for s in squareness_between(machine.axis_names)}
    symbol = content.child("symbol").choice(tuple(known))
    return known[symbol], np.array([content.child("value_urad").number()])


def _axis_location(
    content: Fields, machine: Machine
) -> tuple[AxisLocation, Float64[np.ndarray, " s"]]:
    places = {e.symbol: e for a in machine.rotary_axes for e in axis_locations(a)}
    symbol = content.child("symbol").choice(tuple(places))
    value = content.child(f"value_{unit(symbol)}").number()
    return places[symbol], np.array([value])


def _error_motion(
    content: Fields, machine: Machine
) -> tuple[ErrorMotion, Float64[np.ndarray, " s"]]:
    axes = {s: axis for axis in machine.axes for s in error_motions(axis.name)}
    symbol = content.child("symbol").choice(tuple(axes))
    knots_field = content.child(_knots_key(axes[symbol]))
    knots_mm = knots_field.numbers()
    few = not _FEWEST_KNOTS <= len(knots_mm) <= _MOST_KNOTS
    if few or (np.diff(knots_mm) <= 0).any():
        raise knots_field.error(
            f"are {len(knots_mm)}, or not increasing",
            f"write {_FEWEST_KNOTS} to {_MOST_KNOTS}, in order",
        )
    values_field = content.child(_values_key(symbol))
    values = values_field.numbers()
    if len(values) != len(knots_mm):
        raise values_field.error(
            f"are {len(values)} for {len(knots_mm)} knots", "write one a knot"
        )
    return error_motion_over(symbol, axes[symbol], knots_mm), values


def _covariance(content: Fields, size: int) -> Float64[np.ndarray, "s s"]:
    stated = content.child("size")
    if stated.value != size or size > _MOST:
        raise stated.error(f"is {stated.value}, the effects state {size} numbers")
    content.child("encoding").choice((ENCODING,))
    data = content.child("data")
    try:
        covariance = unpack_symmetric(data.text(), size)
    except ValueError as error:
        raise data.error(str(error), "take the file as it was written") from error
    if (np.diag(covariance) < 0.0).any():
        raise data.error(
            "states a negative variance", "take the file as it was written"
        )
    return covariance
