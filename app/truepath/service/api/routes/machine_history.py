"""A machine over its calibrations: history, changes, status; comparison of machines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field
from pydantic.json_schema import SkipJsonSchema

from truepath.answers.machine_history import (
    Calibration,
    changes_json,
    comparison_json,
    history_json,
)
from truepath.answers.machine_temperature import (
    machine_temperature_json,
    temperature_model_json,
)
from truepath.documents.file_model import encode_json
from truepath.errors import NotFound
from truepath.files.earlier.verdict import State as VerdictState
from truepath.service.api.models.base import (
    JOB_ID,
    OTHER_ID,
    Identifier,
    MachineId,
    MachinePath,
)
from truepath.service.api.models.machine_files import MachineFileOut, ModelNumbersOut
from truepath.service.api.models.tables import VerdictOut
from truepath.service.api.problems import declare_problems
from truepath.service.api.service import ServiceDep


class CalibrationOut(BaseModel):
    """One calibration of a machine."""

    job_id: str = Field(examples=[JOB_ID])
    run_ids: list[str]
    measured: str = Field(
        examples=["2026-05-04T09:30:00.000Z"],
        description="When its first Run began; when it was catalogued where no Run "
        "states it: such a one stands before all that are dated.",
    )
    machine_version: int | None = Field(
        description="Of the machine's configuration; null where nobody knows."
    )
    verdict: str | None = Field(examples=["usable"])


class HistoryEntry(BaseModel):
    """Which number a column is."""

    label: str = Field(
        examples=[""], description="`mean`, `p95` or `largest` of `volumetric`."
    )
    position: float | None = Field(description="Of the axis; null where there is none.")
    position_unit: str = Field(examples=["mm"])


class HistoryPoint(CalibrationOut):
    """A calibration with what it states of each entry."""

    value: list[float | None] = Field(description="One an entry; null if not stated.")
    uncertainty: list[float | None] = Field(description="Standard (k = 1).")
    expected_after: list[float | None] = Field(
        description="As full compensation is expected to leave it; told of "
        "`volumetric`, null of every other quantity."
    )
    expected_after_uncertainty: list[float | None] = Field(
        description="Standard (k = 1)."
    )


class HistoryOut(BaseModel):
    """A quantity over all calibrations of a machine, the oldest first."""

    schema_: Literal["machine-history/1"] = Field(alias="schema")
    machine: str = Field(examples=["mill-3"])
    quantity: str = Field(examples=["EXX"])
    unit: str = Field(examples=["um"])
    entries: list[HistoryEntry]
    calibrations: list[HistoryPoint]


class VolumetricChange(BaseModel):
    """One volumetric error less the other, without its best-fit rigid motion."""

    difference_um: float = Field(description="Root mean square over the travel.")
    by_chance_um: float = Field(
        description="What it stays below, with 97.5 %, where nothing has changed."
    )
    change_um: float = Field(description="What is left without the part of chance.")
    chance: float = Field(description="Of so large a difference without a change.")
    is_significant: bool


class ChangedEntryOut(BaseModel):
    """One table entry in both."""

    symbol: str = Field(examples=["EXX"])
    position: float | None
    position_unit: str
    unit: str = Field(examples=["um"])
    before: float
    after: float
    difference: float
    uncertainty: float = Field(description="Of the difference, standard (k = 1).")
    chance: float = Field(
        description="Of so large a difference anywhere in the tables without a change."
    )
    is_significant: bool


class ChangesOut(BaseModel):
    """What has changed between two calibrations, and how surely."""

    schema_: Literal["machine-changes/1"] = Field(alias="schema")
    machine: str = Field(examples=["mill-3"])
    since: CalibrationOut
    until: CalibrationOut
    has_changed: bool
    compensation_changed: bool = Field(
        False, description="The control compensated otherwise: that is no change."
    )
    chance: float = Field(
        examples=[0.05],
        description="Of saying so of a machine that has not changed, at most.",
    )
    factor: float = Field(
        description="Standard uncertainties that an entry has to differ by to count, "
        "since so many are looked at."
    )
    volumetric: VolumetricChange
    significant: list[ChangedEntryOut] = Field(
        description="Of each symbol that has changed the surest entry."
    )
    entries: list[ChangedEntryOut]
    not_compared: list[str] = Field(description="Symbols that only one of both states.")
    text: list[str] = Field(
        examples=[["EXX at 300 mm went from 4.1 to 9.8 µm, by +5.7 ± 1.2 µm (k = 2)."]]
    )


class ComparedMachine(CalibrationOut):
    """One machine by its newest usable calibration."""

    machine: str = Field(examples=["mill-3"])
    value: float
    uncertainty: float = Field(description="Standard (k = 1).")
    is_more_than: list[str] = Field(
        description="Machines whose number is less for sure."
    )
    tolerance_um: float | None


class MachineComparisonOut(BaseModel):
    """One quantity of several machines, the smallest first."""

    schema_: Literal["machine-comparison/1"] = Field(alias="schema")
    quantity: str = Field(examples=["volumetric"])
    label: str = Field(examples=["p95"])
    position: float | None
    unit: str = Field(examples=["um"])
    factor: float = Field(
        description="Combined standard uncertainties that two have to differ by."
    )
    machines: list[ComparedMachine]


class StandingOut(BaseModel):
    """How a machine stands by its newest usable calibration."""

    machine: str = Field(examples=["mill-3"])
    calibration: str | None = Field(examples=[OTHER_ID])
    is_alarm: bool = Field(description="Over its tolerance, or changed for sure.")
    tolerance: Literal["within", "over", "not-sure"] | None
    tolerance_text: str
    reference_job: str | None
    has_changed: bool | None
    change_text: str


router = APIRouter(prefix="/machines", tags=["machines"])

Quantity = Annotated[
    str,
    Query(
        pattern="^(volumetric|[A-Z][A-Z0][A-Z])$",
        examples=["EXX"],
        description="`volumetric`, or the symbol of an error motion, a squareness "
        "or a location.",
    ),
]
SensorName = Annotated[str, Field(pattern="^[A-Za-z0-9_]{1,64}$", examples=["X"])]
Sensors = Annotated[
    list[SensorName],
    Query(description="Thermometers whose mean counts; without them the scales'."),
]
ReferenceTemperature = Annotated[
    float, Query(ge=-50.0, le=100.0, description="That tables are stated at.")
]
ChosenJobs = Annotated[
    list[Identifier],
    Query(description="Only these calibrations; without them all usable ones."),
]
Position = Annotated[
    float | SkipJsonSchema[None],
    Query(allow_inf_nan=False, description="Of the axis; one of its table entries."),
]


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


class TemperatureModelOut(BaseModel, extra="allow"):
    """Content of `temperature.json`: a machine over temperature. More keys are there.

    `model` is the machine at the reference temperature, `per_kelvin` its change.
    """

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


@router.get("/{machine_id}/history", responses=declare_problems(404, 422))
def get_machine_history(
    machine_id: MachinePath,
    service: ServiceDep,
    quantity: Quantity = "volumetric",
    position: Position = None,
) -> HistoryOut:
    """Return a quantity over all calibrations of a machine, with its uncertainty."""
    service.setup.registry.get(machine_id)
    found = service.calibrations.list_of(machine_id)
    return HistoryOut(**history_json(machine_id, found, quantity, position))


@router.get("/{machine_id}/changes", responses=declare_problems(404, 422))
def get_machine_changes(
    machine_id: MachinePath,
    service: ServiceDep,
    since: Annotated[Identifier, Query(description="Job of the earlier calibration.")],
    until: Annotated[
        Identifier | SkipJsonSchema[None],
        Query(description="Job of the later one; without it the newest usable one."),
    ] = None,
) -> ChangesOut:
    """Return what has changed since a calibration, and how surely."""
    service.setup.registry.get(machine_id)
    before = service.calibrations.find(machine_id, since)
    if until is not None:
        after = service.calibrations.find(machine_id, until)
    else:
        usable = service.calibrations.list_usable(machine_id)
        if not usable:
            raise NotFound(f"machine {machine_id} has no usable calibration")
        after = usable[-1]
    return ChangesOut(**changes_json(before, after))


@router.get("/{machine_id}/temperature", responses=declare_problems(404, 422))
def get_machine_temperature(
    machine_id: MachinePath,
    service: ServiceDep,
    sensor: Sensors = [],  # noqa: B006
    reference_degC: ReferenceTemperature = 20.0,  # noqa: N803
    job: ChosenJobs = [],  # noqa: B006
) -> MachineTemperatureOut:
    """Return how the errors of a machine depend on its temperature.

    Refused (422) in words where its calibrations do not tell: fewer than three
    temperatures, too close together, other targets.
    """
    calibrations = _choose_calibrations(service, machine_id, job)
    return MachineTemperatureOut(
        **machine_temperature_json(machine_id, calibrations, sensor, reference_degC)
    )


@router.get(
    "/{machine_id}/temperature/temperature.json",
    response_model=TemperatureModelOut,
    responses=declare_problems(404, 422),
)
def download_machine_temperature(
    machine_id: MachinePath,
    service: ServiceDep,
    sensor: Sensors = [],  # noqa: B006
    reference_degC: ReferenceTemperature = 20.0,  # noqa: N803
    job: ChosenJobs = [],  # noqa: B006
) -> Response:
    """Return `temperature.json`: the machine at any temperature of a range.

    `truepath export` makes files of it at a temperature. Refused (422) as
    `/temperature`.
    """
    calibrations = _choose_calibrations(service, machine_id, job)
    content = temperature_model_json(calibrations, sensor, reference_degC)
    name = 'attachment; filename="temperature.json"'
    return Response(
        encode_json(content),
        media_type="application/json",
        headers={"Content-Disposition": name},
    )


def _choose_calibrations(
    service: ServiceDep, machine_id: str, jobs: Sequence[str]
) -> Sequence[Calibration]:
    service.setup.registry.get(machine_id)
    chosen = [service.calibrations.find(machine_id, one) for one in jobs]
    return chosen or service.calibrations.list_usable(machine_id)


@router.get("/{machine_id}/standing", responses=declare_problems(404))
def get_machine_standing(machine_id: MachinePath, service: ServiceDep) -> StandingOut:
    """Return whether a machine is within its tolerance and as it was."""
    service.setup.registry.get(machine_id)
    service.calibrations.update_status(machine_id)
    standing = service.calibrations.find_calibration_status(machine_id)
    if standing is None:
        raise NotFound(f"nothing is known of how machine {machine_id} stands")
    return StandingOut(**standing.describe())


comparison = APIRouter(tags=["machines"])


@comparison.get("/machines:compare", responses=declare_problems(404, 422))
def compare_machines(
    service: ServiceDep,
    quantity: Quantity = "volumetric",
    position: Position = None,
    machine: Annotated[
        list[MachineId], Query(description="Only these; without them all.")
    ] = [],  # noqa: B006
) -> MachineComparisonOut:
    """Compare machines by their newest usable calibrations."""
    registry = service.setup.registry
    records = [registry.get(i) for i in machine] or registry.list_all()
    usable = [service.calibrations.list_usable(record.id) for record in records]
    newest = [calibrations[-1] for calibrations in usable if calibrations]
    tolerances_um = {record.id: record.tolerance_um for record in records}
    found = comparison_json(newest, quantity, position, tolerances_um)
    return MachineComparisonOut(**found)
