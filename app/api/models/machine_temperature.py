"""What is said of how a machine depends on its temperature."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from truepath.app.api.models.machine_file import MachineFileOut
from truepath.app.api.models.machine_history import CalibrationOut
from truepath.app.api.models.model_file import ModelNumbersOut
from truepath.app.api.models.tables import VerdictOut
from truepath.app.files.verdict import State as VerdictState

# ruff: noqa: N815


class CalibrationAtTemperature(CalibrationOut):
    """A calibration with the temperature that the machine had."""

    temperature_degC: float = Field(examples=[21.4])
    temperature_uncertainty_K: float = Field(description="Standard (k = 1).")


class ChiSquares(BaseModel):
    """Squares of residuals by their variances, by degrees of freedom."""

    without_temperature: float
    with_temperature: float


class DependenceOut(BaseModel):
    """Whether an error motion, squareness or location depends on temperature."""

    symbol: str = Field(examples=["EXX"])
    is_significant: bool
    chance: float = Field(description="Of so large a coefficient without dependence.")
    largest: float = Field(description="Coefficient by its standard uncertainty.")
    chi2_per_freedom: ChiSquares
    widened_by: float = Field(
        description="Factor of the uncertainties, for what set-ups scatter."
    )
    effective_freedom: float | None = Field(description="null without scatter.")


class ExpansionOut(BaseModel):
    """Growth of an axis, the straight part of its positioning per kelvin."""

    value_um_per_m_K: float = Field(examples=[11.2])
    uncertainty_um_per_m_K: float = Field(description="Standard (k = 1).")
    is_significant: bool


class VolumetricPerKelvin(BaseModel):
    """Root mean square over the travel of the change per kelvin, µm/K."""

    value: float
    uncertainty: float = Field(description="Standard (k = 1).")


class CoefficientOut(BaseModel):
    """A table of the change per kelvin, or one number; units in the keys."""

    position_mm: list[float] | None = None
    position_deg: list[float] | None = None
    value_um_per_K: list[float] | float | None = None
    uncertainty_um_per_K: list[float] | float | None = None
    value_urad_per_K: list[float] | float | None = None
    uncertainty_urad_per_K: list[float] | float | None = None


class MachineTemperatureOut(BaseModel):
    """How the errors of a machine depend on its temperature."""

    schema_: Literal["machine-temperature/1"] = Field(alias="schema")
    machine: str = Field(examples=["mill-3"])
    verdict: VerdictState = Field(
        description="Doubtful where a drift over time would look the same."
    )
    reference_degC: float = Field(examples=[20.0])
    measured_degC: list[float] = Field(examples=[[18.1, 24.9]])
    calibrations: list[CalibrationAtTemperature]
    dependences: list[DependenceOut]
    expansion: dict[str, ExpansionOut] = Field(description="By axis.")
    volumetric_um_per_K: VolumetricPerKelvin
    coefficients: dict[str, CoefficientOut] = Field(description="By symbol.")
    text: list[str] = Field(description="The answer in sentences.")
    not_told: list[str]


class TemperatureModelOut(BaseModel):
    """Content of `temperature.json`: a machine over temperature. More keys are there.

    `model` is the machine at the reference temperature, `per_kelvin` its change.
    """

    model_config = ConfigDict(extra="allow")

    schema_: Literal["temperature-model/1"] = Field(alias="schema")
    machine: MachineFileOut
    verdict: VerdictOut
    reference_degC: float = Field(examples=[20.0])
    measured_degC: list[float] = Field(examples=[[18.1, 24.9]])
    valid_degC: list[float] = Field(
        description="Where it is taken to hold.", examples=[[18.1, 24.9]]
    )
    model: ModelNumbersOut
    per_kelvin: ModelNumbersOut
