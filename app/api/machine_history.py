"""A machine over its calibrations: history, changes, standing; machines compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from truepath.app.api.models.base import Identifier, MachineId, MachinePath
from truepath.app.api.models.machine_history import (
    ChangesOut,
    HistoryOut,
    MachineComparisonOut,
    StandingOut,
)
from truepath.app.api.models.machine_temperature import (
    MachineTemperatureOut,
    TemperatureModelOut,
)
from truepath.app.api.problems import declare_problems
from truepath.app.api.service import ServiceDep
from truepath.app.errors import NotFound
from truepath.app.files.file_model import encode_json
from truepath.app.results.machine_documents import (
    Calibration,
    changes_json,
    comparison_json,
    history_json,
)
from truepath.app.results.machine_temperature_document import (
    machine_temperature_json,
    temperature_model_json,
)

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
    """Return those of the jobs; all usable ones of the machine without any."""
    service.setup.registry.get(machine_id)
    chosen = [service.calibrations.find(machine_id, one) for one in jobs]
    return chosen or service.calibrations.list_usable(machine_id)


@router.get("/{machine_id}/standing", responses=declare_problems(404))
def get_machine_standing(machine_id: MachinePath, service: ServiceDep) -> StandingOut:
    """Return whether a machine is within its tolerance and as it was."""
    service.setup.registry.get(machine_id)
    service.calibrations.judge(machine_id)
    standing = service.calibrations.find_standing(machine_id)
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
