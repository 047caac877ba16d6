"""The estimated model in files (schema `model/1`), to and from a `MachineModel`.

Each effect has numbers that mean something without this program: the values of a spline
at its knots, an angle. They are linear in the parameters, s = G θ, so their covariance
is G C Gᵀ; G's columns are orthogonal, and reading computes θ = G⁺ s up to rounding. The
basis of a gauge depends on the linear algebra library and stays out of the file.
Covariances are text, exact and short.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import AfterValidator, ConfigDict, Field, ValidationInfo, model_validator

from truepath.documents.file_model import FileModel, Text, quote, reject, validate
from truepath.errors import BadInput
from truepath.files.units import scale_of, unit_of
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.error_motion import (
    list_axis_locations,
    list_squarenesses,
    make_error_motion_over,
)
from truepath.kinematics.effects.family import Family, find_family
from truepath.kinematics.machine.machine import Machine, position_unit
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    find_unit,
    list_error_motions,
)
from truepath.kinematics.model import (
    CatalogueEffect,
    EstimatedModel,
    MachineModel,
    restore_effect,
)

ENCODING = "base64, zlib, little-endian float64, lower triangle by rows"
AS_WRITTEN = "take the file as it was written"
_MOST = 20_000  # rows; a larger matrix would not fit in memory
SCHEMA = "model/1"
_FEWEST_KNOTS, _MOST_KNOTS = 3, 2_000
# In µm or µrad: no machine tool is off by a metre, or by a radian.
_Error = Annotated[float, Field(ge=-1e6, le=1e6)]

Stated = tuple[Effect, Float64[np.ndarray, " s"]]


class CovarianceFile(FileModel):
    """The covariance of the numbers of the effects, one effect after another."""

    size: int
    encoding: str
    data: Text

    def matrix(self, size: int) -> Float64[np.ndarray, "s s"]:
        """Raises a refusal unless it is of the size of all numbers of the effects."""
        if self.size != size or size > _MOST:
            problem = f"is {self.size}, the effects state {size} numbers"
            raise reject(problem, "", "covariance", "size")
        if self.encoding != ENCODING:
            remedy = f"write one of {ENCODING}"
            place = "covariance", "encoding"
            raise reject(f"is {quote(self.encoding)}", remedy, *place)
        try:
            covariance = unpack_symmetric(self.data, size)
        except ValueError as error:
            raise reject(str(error), AS_WRITTEN, "covariance", "data") from error
        if (np.diag(covariance) < 0.0).any():
            problem = "states a negative variance"
            raise reject(problem, AS_WRITTEN, "covariance", "data")
        return covariance


def pack_symmetric(matrix: Float64[np.ndarray, "p p"]) -> str:
    """Lower triangle of a symmetric matrix in `ENCODING`."""
    triangle = matrix[np.tril_indices(len(matrix))].astype("<f8")
    return base64.b64encode(zlib.compress(triangle.tobytes(), 6)).decode("ascii")


def unpack_symmetric(text: str, size: int) -> Float64[np.ndarray, "p p"]:
    """Inverse of `pack_symmetric`. Raises ValueError."""
    wanted = 8 * (size * (size + 1) // 2)
    unpacker = zlib.decompressobj()
    try:
        # Bounded, so that a short text cannot unpack to fill the memory.
        data = unpacker.decompress(base64.b64decode(text, validate=True), wanted + 1)
    except (ValueError, zlib.error) as error:
        raise ValueError(f"cannot be unpacked ({error})") from error
    if len(data) != wanted or not unpacker.eof:
        raise ValueError(f"does not hold a matrix of size {size}")
    triangle = np.frombuffer(data, "<f8").astype(np.float64)
    if not np.isfinite(triangle).all():
        raise ValueError("holds numbers that are not finite")
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = triangle
    return lower + np.tril(lower, -1).T


class ErrorMotionFile(FileModel):
    """An error motion: values of its spline at knots along its axis."""

    effect: Literal["error-motion"]
    symbol: str
    knots_mm: list[float] | None = None
    knots_deg: list[float] | None = None
    values_um: list[_Error] | None = None
    values_urad: list[_Error] | None = None

    def restore(self, machine: Machine) -> Stated:
        """The effect and its stated values, µm or µrad."""
        axes = {s: axis for axis in machine.axes for s in list_error_motions(axis.name)}
        _require_symbol(self.symbol, axes)
        axis = axes[self.symbol]
        knots = _read_numbers(self, key := f"knots_{position_unit(axis)}")
        few = not _FEWEST_KNOTS <= len(knots) <= _MOST_KNOTS
        if few or (np.diff(knots) <= 0).any():
            remedy = f"write {_FEWEST_KNOTS} to {_MOST_KNOTS}, in order"
            raise reject(f"are {len(knots)}, or not increasing", remedy, key)
        values = _read_numbers(self, key := f"values_{find_unit(self.symbol)}")
        if len(values) != len(knots):
            problem = f"are {len(values)} for {len(knots)} knots"
            raise reject(problem, "write one a knot", key)
        return make_error_motion_over(self.symbol, axis, knots), values


class NumberFile(FileModel):
    """A squareness or the location of a rotary axis: one number."""

    effect: Literal["squareness", "axis-location"]
    symbol: str
    value_um: _Error | None = None
    value_urad: _Error | None = None

    def restore(self, machine: Machine) -> Stated:
        """The effect and its stated value, µm or µrad."""
        effects = list_squarenesses(machine.axis_names)
        if self.effect == "axis-location":
            effects = [e for a in machine.rotary_axes for e in list_axis_locations(a)]
        known = {effect.symbol: effect for effect in effects}
        _require_symbol(self.symbol, known)
        value = _read_numbers(self, f"value_{find_unit(self.symbol)}")
        return known[self.symbol], value.reshape(1)


class CataloguedFile(FileModel):
    """An effect of the catalogue, with the keys of its family.

    numbers : that define the effect (a lead, a decay)
    values : its linear parameters, in the units that the file states with them
    """

    model_config = ConfigDict(extra="allow")

    effect: Literal["catalogued"]
    name: Text
    numbers: dict[str, float]
    values: list[float]

    def restore(self, machine: Machine) -> Stated:
        """The effect and its stated values, in units of the file."""
        try:
            family = find_family(self.name)
        except BadInput as error:
            remedy = "install what brings this effect"
            raise reject(str(error), remedy, "name") from error
        effect = self._restore_effect(family, machine)
        if len(self.values) != (count := len(effect.parameters)):
            problem = f"are {len(self.values)}, the effect has {count}"
            raise reject(problem, AS_WRITTEN, "values")
        return effect, np.array(self.values, np.float64)

    def _restore_effect(self, family: Family, machine: Machine) -> Effect:
        """Make the effect, and evaluate it once, which reveals impossible numbers."""
        stated = self.model_extra or {}
        keys = {key: stated[key] for key in family.keys if key in stated}
        for key, text in keys.items():
            if not isinstance(text, str):
                raise reject(f"is {quote(text)}", "write a text", key)
        middle_mm = [[0.5 * (axis.low + axis.high) for axis in machine.axes]]
        try:
            effect = restore_effect(family, machine, keys, self.numbers)
            at = make_standstill(machine, np.array(middle_mm))
            moved = np.zeros(0) if effect is None else effect.jacobian(at)
        except (KeyError, ValueError, ZeroDivisionError) as error:
            raise reject(
                f"{family.name} does not fit this machine ({error})",
                "give axis, direction and numbers of an effect of this machine",
                "name",
            ) from error
        if effect is None:
            problem = f"{family.name} belongs to the Run that it was found in"
            raise reject(problem, "take it out of the model", "name")
        if not np.isfinite(moved).all():
            raise reject(f"{family.name} has numbers that make no effect", "", "name")
        return effect


def _restore(
    file: ErrorMotionFile | NumberFile | CataloguedFile, info: ValidationInfo
) -> Stated:
    machine: Any = info.context
    return file.restore(machine)


EffectFile = Annotated[
    Annotated[
        ErrorMotionFile | NumberFile | CataloguedFile, Field(discriminator="effect")
    ],
    AfterValidator(_restore),
]


class ModelFile(FileModel):
    """The key `model`; validated with its machine as context."""

    schema_: Literal["model/1"] = Field(alias="schema")
    effects: list[EffectFile]
    confounded: list[Text] = Field(default_factory=list[Text])
    covariance: CovarianceFile

    @model_validator(mode="after")
    def _require_each_effect_once(self) -> ModelFile:
        names = [effect.name for effect, _ in self.stated]
        for index, name in enumerate(names):
            if name in names[:index]:
                remedy = "state each effect once"
                raise reject(f"repeats {name}", remedy, "effects", index)
        self.covariance.matrix(sum(len(values) for _, values in self.stated))
        return self

    @property
    def stated(self) -> list[Stated]:
        """Effects of the machine with their stated values."""
        return self.effects  # pyright: ignore[reportReturnType] (what _restore returns)


def model_from_json(content: object, machine: Machine, *, file: str) -> EstimatedModel:
    """From the key `model` of a file. Raises BundleError."""
    read = validate(ModelFile, content, file, key="model", context=machine)
    effects = tuple(effect for effect, _ in read.stated)
    model = MachineModel(machine, effects, frozenset(read.confounded))
    G = build_number_rows(model)
    back = (G / np.sum(G**2, axis=0)).T  # G⁺, its columns being orthogonal
    values = np.concatenate([*(v for _, v in read.stated), np.empty(0)])
    covariance = read.covariance.matrix(len(values))
    return EstimatedModel(model, back @ values, back @ covariance @ back.T)


def model_to_json(estimated: EstimatedModel) -> dict[str, Any]:
    """The model as JSON, lengths in mm, errors in µm and µrad.

    Parameters of the measurement (how the targets sit in the spindle) are integrated
    out: to the map of one target they add a shift, which is no machine error.
    """
    model = estimated.model
    own = tuple(e for e in model.effects if e.role is Role.MACHINE)
    kept = np.concatenate([np.arange(model.size)[model.slices[e.name]] for e in own])
    model = replace(model, effects=own)
    covariance = estimated.covariance[np.ix_(kept, kept)]
    G = build_number_rows(model)
    values = G @ estimated.theta[kept]
    catalogued = {e.name: e for e in model.catalogue_effects}
    ends = np.cumsum([len(_build_rows(effect)) for effect in model.effects])
    stated = zip(model.effects, np.split(values, ends[:-1]), strict=True)
    return {
        "schema": SCHEMA,
        "effects": [_effect_json(e, catalogued.get(e.name), v) for e, v in stated],
        "confounded": sorted(model.confounded),
        "covariance": {
            "of": "the numbers of the effects, one effect after another",
            "size": len(G),
            "encoding": ENCODING,
            "data": pack_symmetric(G @ covariance @ G.T),
        },
    }


def build_number_rows(model: MachineModel) -> Float64[np.ndarray, "s p"]:
    """G of all effects: their stated numbers per parameter."""
    blocks = [np.empty((0, model.size))]
    for effect in model.effects:
        rows = _build_rows(effect)
        blocks.append(np.zeros((len(rows), model.size)))
        blocks[-1][:, model.slices[effect.name]] = rows
    return np.concatenate(blocks)


def _read_numbers(file: FileModel, key: str) -> Float64[np.ndarray, "*n"]:
    if (stated := getattr(file, key)) is None:
        raise reject("is missing", "add it", key)
    return np.array(stated, np.float64)


def _require_symbol(symbol: str, known: dict[str, Any]) -> None:
    if symbol not in known:
        remedy = f"write one of {', '.join(known)}"
        raise reject(f"is {quote(symbol)}", remedy, "symbol")


def _build_rows(effect: Effect) -> Float64[np.ndarray, "s p"]:
    if motion := effect.motion:
        return scale_of(find_unit(motion.symbol)) * motion.gauge
    return np.diag([unit_of(p)[1] for p in effect.parameters])


def _effect_json(
    effect: Effect, known: CatalogueEffect | None, values: Float64[np.ndarray, " s"]
) -> dict[str, Any]:
    """`known` is the same effect where it has a family."""
    symbol = effect.iso_symbol
    if motion := effect.motion:
        return {
            "effect": "error-motion",
            "symbol": symbol,
            f"knots_{position_unit(motion.axis)}": motion.spline.knots.tolist(),
            f"values_{find_unit(symbol)}": values.tolist(),
        }
    if known:
        return {
            "effect": "catalogued",
            "name": known.family,
            **dict(known.keys),
            "numbers": dict(known.numbers),
            "values": values.tolist(),
            "units": [unit_of(p)[0] for p in effect.parameters],
        }
    if not symbol:
        raise TypeError(f"{effect.name} has no form in a result file")
    kind = "squareness" if symbol in SQUARENESS else "axis-location"
    key = f"value_{find_unit(symbol)}"
    return {"effect": kind, "symbol": symbol, key: float(values[0])}
