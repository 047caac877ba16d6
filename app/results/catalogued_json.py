"""Effects of the catalogue as model files state them: name, keys, numbers, values.

`numbers` make the effect (a lead, a decay), `values` are its linear parameters in the
units beside them, in which the file's covariance is stated as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.errors import BadInput
from app.files.json_fields import Field, Fields
from app.kinematics.conditions import standstill
from app.kinematics.effects.base import Effect, Parameter
from app.kinematics.effects.catalogue import Family, Measured
from app.kinematics.effects.catalogued import Catalogued, catalogued
from app.kinematics.machine import Machine
from app.plugins import load

CATALOGUED = "catalogued"
# Inside unit -> unit in files and its number in one of the inside unit.
_UNITS = {
    "mm": ("um", 1e3),
    "rad": ("urad", 1e6),
    "s": ("ms", 1e3),
    "mm/s": ("um_per_s", 1e3),
    "1/K": ("um_per_m_K", 1e6),
    "1": ("um_per_m", 1e6),
}
_KEYS = ("axis", "by", "direction", "motion", "plane", "symbol", "circle")


def unit_of(parameter: Parameter) -> tuple[str, float]:
    """Return the unit that files state, and how many of it are one inside."""
    return _UNITS.get(parameter.unit, (parameter.unit, 1.0))


def catalogued_json(
    effect: Catalogued, values: Float64[np.ndarray, " p"]
) -> dict[str, Any]:
    """Return the effect with its values."""
    return {
        "effect": CATALOGUED,
        "name": effect.family,
        **dict(effect.keys),
        "numbers": dict(effect.numbers),
        "values": values.tolist(),
        "units": [unit_of(p)[0] for p in effect.parameters],
    }


def parameters_json(found: Mapping[str, Measured]) -> dict[str, Any]:
    """Return values and uncertainties; `name[x]`, `name[y]` … make a list."""
    stated: dict[str, Any] = {}
    for name, m in found.items():
        whole, vector, _ = name.partition("[")
        if not vector:
            stated[name] = {"value": m.value, "uncertainty": m.uncertainty}
            continue
        parts = stated.setdefault(whole, {"value": [], "uncertainty": []})
        parts["value"].append(m.value)
        parts["uncertainty"].append(m.uncertainty)
    return stated


def catalogued_from_json(
    content: Fields, machine: Machine
) -> tuple[Effect, Float64[np.ndarray, " p"]]:
    """Return the effect and its stated values. Raises BundleError with the place."""
    name = content.child("name")
    family = _family(name)
    keys = {k: content.child(k).text() for k in _KEYS if k in content}
    stated = content.child("numbers").mapping()
    numbers = {key: field.number() for key, field in stated.children()}
    effect = _made(name, family, machine, keys, numbers)
    values_field = content.child("values")
    values = values_field.numbers()
    if len(values) != len(effect.parameters):
        raise values_field.error(
            f"are {len(values)}, the effect has {len(effect.parameters)}",
            "take the file as it was written",
        )
    return effect, values


def _family(name: Field) -> Family:
    try:
        return load("truepath.effects", name.text())()
    except BadInput as error:
        raise name.error(str(error), "install what brings this effect") from error


def _made(
    name: Field,
    family: Family,
    machine: Machine,
    keys: dict[str, str],
    numbers: dict[str, float],
) -> Effect:
    """Make the effect, and ask it once: numbers that cannot be show themselves."""
    try:
        effect = catalogued(family, machine, keys, numbers)
        if effect is None:
            raise name.error(
                f"{family.name} belongs to the Run that it was found in",
                "take it out of the model",
            )
        asked = effect.jacobian(standstill(machine, _middle_mm(machine)))
    except (KeyError, ValueError, ZeroDivisionError) as error:
        raise name.error(
            f"{family.name} does not fit this machine ({error})",
            "give axis, direction and numbers of an effect of this machine",
        ) from error
    if not np.isfinite(asked).all():
        raise name.error(f"{family.name} has numbers that make no effect")
    return effect


def _middle_mm(machine: Machine) -> Float64[np.ndarray, "1 a"]:
    return np.array([[0.5 * (axis.low + axis.high) for axis in machine.axes]])
