"""Temperature models (schema `temperature-model/1`), read.

A file has the keys of a model file, for the machine at the reference temperature, and
in addition the change per kelvin in the same form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64
from pydantic import Field

from truepath.documents.file_model import (
    FileModel,
    Text,
    as_object,
    parse_json,
    validate,
)
from truepath.documents.whole_files import read_whole
from truepath.errors import BadInput, BundleError
from truepath.files.earlier.model_file import (
    AS_WRITTEN,
    build_number_rows,
    model_from_json,
    unpack_symmetric,
)
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    MODEL_SCHEMA,
    CalibrationResult,
    result_from_json,
)
from truepath.kinematics.machine.machine import Machine

SCHEMA = "temperature-model/1"


@dataclass(frozen=True)
class TemperatureModel:
    """Errors at any temperature of a range.

    reference : the result at `reference_degc`
    per_kelvin, coefficient_covariance : change of its parameters
    between : covariance of both, plus its transpose
    measured_degc : lowest and highest temperature of the results
    valid_degc : range of validity
    grows : axes whose positioning depends on temperature for sure
    """

    reference: CalibrationResult
    per_kelvin: Float64[np.ndarray, " p"]
    coefficient_covariance: Float64[np.ndarray, "p p"]
    between: Float64[np.ndarray, "p p"]
    reference_degc: float
    measured_degc: tuple[float, float]
    valid_degc: tuple[float, float]
    grows: frozenset[str]

    @property
    def machine(self) -> Machine:
        """With the measured targets."""
        return self.reference.machine

    def at(self, temperature_degc: float) -> CalibrationResult:
        """The result at a temperature. Raises BadInput beyond the range."""
        low, high = self.valid_degc
        if not low - 1e-9 <= temperature_degc <= high + 1e-9:
            raise BadInput(
                f"{temperature_degc:g} °C is beyond the {low:.1f} to {high:.1f} °C "
                "that the temperature model holds for; measure there, or state with "
                "`temperature --range` how far its line is taken to go on"
            )
        off_k = temperature_degc - self.reference_degc
        return replace(
            self.reference,
            theta=self.reference.theta + off_k * self.per_kelvin,
            covariance=self.reference.covariance
            + off_k * self.between
            + off_k**2 * self.coefficient_covariance,
        )

    @property
    def coefficients(self) -> CalibrationResult:
        """The change per kelvin in the form of a result: its errors are per K."""
        return replace(
            self.reference,
            theta=self.per_kelvin,
            covariance=self.coefficient_covariance,
            halves={},
        )


class _Between(FileModel):
    encoding: Literal["base64, zlib, little-endian float64, lower triangle by rows"]
    data: Text


class _Expansion(FileModel):
    is_significant: bool


Ends = Annotated[list[float], Field(min_length=2, max_length=2)]


class _TemperatureFile(FileModel):
    reference_degc: float = Field(alias="reference_degC")
    measured_degc: Ends = Field(alias="measured_degC")
    valid_degc: Ends = Field(alias="valid_degC")
    per_kelvin: Any
    between: _Between
    expansion: dict[str, _Expansion]


def temperature_model_from_json(
    content: Mapping[str, Any], *, file: str
) -> TemperatureModel:
    """From the content of a file. Raises BundleError."""
    stated = validate(_TemperatureFile, content, file)
    as_model = {**content, "schema": MODEL_SCHEMA, "version": 1.0}
    reference = result_from_json(as_model, file=file)
    change = model_from_json(stated.per_kelvin, reference.machine, file=file)
    G = build_number_rows(reference.model)
    try:
        between = unpack_symmetric(stated.between.data, len(G))
    except ValueError as error:
        problem = f"between.data {error}"
        raise BundleError(problem, file=file, remedy=AS_WRITTEN) from error
    back = (G / np.sum(G**2, axis=0)).T
    return TemperatureModel(
        reference,
        change.theta,
        change.covariance,
        back @ between @ back.T,
        stated.reference_degc,
        (stated.measured_degc[0], stated.measured_degc[1]),
        (stated.valid_degc[0], stated.valid_degc[1]),
        frozenset(a for a, one in stated.expansion.items() if one.is_significant),
    )


def read_result_at(
    file: str | Path, temperature_degc: float | None
) -> tuple[CalibrationResult, TemperatureModel | None]:
    """Read a result, or a temperature model at a temperature.

    Raises BadInput where a model is given without a temperature or a result with one,
    or beyond the range of the model; BundleError with the place in the file.
    """
    content = parse_json(read_whole(file, largest_bytes=LARGEST_BYTES), str(file))
    if as_object(content).get("schema") != SCHEMA:
        if temperature_degc is not None:
            raise BadInput(
                f"{file} holds for the temperature it was measured at; give a "
                "temperature.json of `truepath temperature`, or leave the temperature "
                "out"
            )
        return result_from_json(content, file=str(file)), None
    model = temperature_model_from_json(as_object(content), file=str(file))
    if temperature_degc is None:
        low, high = model.valid_degc
        raise BadInput(
            f"{file} holds for {low:.1f} to {high:.1f} °C; state which by "
            "--at-temperature"
        )
    return model.at(temperature_degc), model
