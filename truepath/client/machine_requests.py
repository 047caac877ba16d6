"""The requests to machines: who they are, how they stand, what holds them."""

from __future__ import annotations

from typing import Any, cast

from truepath.client.bodies import Condition, Json, Machine, MachineRecord
from truepath.client.requests import (
    PREFIX,
    Request,
    get,
    read_items,
    read_json,
    read_nothing,
)


def connect(machine_id: str) -> Request[Json]:
    """Open the ports; moves nothing."""
    return Request("POST", f"{PREFIX}/machines/{machine_id}:connect", read_json)


def get_machine() -> Request[Json]:
    """Ask for the machine file and who has answered."""
    return get("/machines/current", read_json)


def list_conditions(machine_id: str) -> Request[list[Condition]]:
    """Ask what has to be so before the machine moves."""
    return cast(
        Request[list[Condition]], get(f"/machines/{machine_id}/conditions", read_items)
    )


def list_machines() -> Request[list[Machine]]:
    """Ask for all machines."""
    return cast(Request[list[Machine]], get("/machines", read_items))


def get_machine_record(machine_id: str) -> Request[MachineRecord]:
    """Ask for a machine of the registry, with its configuration."""
    return cast(Request[MachineRecord], get(f"/machines/{machine_id}", read_json))


def add_machine(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Add a machine to the registry. Again would be refused, as it is known then."""
    content = {"id": machine_id, **body}
    return Request(
        "POST", f"{PREFIX}/machines", read_json, body=content, may_repeat=False
    )


def change_machine(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Change who a machine is, its tolerance or its reference."""
    return Request("PATCH", f"{PREFIX}/machines/{machine_id}", read_json, body=body)


def remove_machine(machine_id: str, version: int) -> Request[None]:
    """Remove a machine, as it was read. If the answer is lost, list the machines."""
    return Request(
        "DELETE",
        f"{PREFIX}/machines/{machine_id}",
        read_nothing,
        headers={"If-Match": f'"{version}"'},
        may_repeat=False,
    )


def set_machine_file(machine_id: str, machine_file: Json) -> Request[MachineRecord]:
    """Describe a machine anew."""
    path, body = f"/machines/{machine_id}/machine-file", {"machine_file": machine_file}
    return Request("PUT", f"{PREFIX}{path}", read_json, body=body)


def set_machine_devices(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Choose drivers and options of a machine."""
    path = f"{PREFIX}/machines/{machine_id}/devices"
    return Request("PUT", path, read_json, body=body)


def get_machine_history(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """Ask for a quantity over all calibrations of a machine."""
    return get(f"/machines/{machine_id}/history", read_json, **query)


def get_machine_changes(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """Ask what has changed between two calibrations of a machine."""
    return get(f"/machines/{machine_id}/changes", read_json, **query)


def get_machine_temperature(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """Ask how the errors of a machine depend on its temperature."""
    return get(f"/machines/{machine_id}/temperature", read_json, **query)


def get_machine_standing(machine_id: str) -> Request[Json]:
    """Ask how a machine stands by its newest usable calibration."""
    return get(f"/machines/{machine_id}/standing", read_json)


def compare_machines(query: dict[str, Any]) -> Request[Json]:
    """Ask for one quantity of several machines."""
    return get("/machines:compare", read_json, **query)
