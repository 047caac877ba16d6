"""`truepath machines`: the registry of machines of a running service."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truepath.app.cli.machine_tables import (
    print_comparison,
    print_history,
    print_machine,
    print_machines,
    summarise_machine,
)
from truepath.app.cli.service_client import HERE, Address, CaFile, KeyFile, open_client
from truepath.app.cli.terminal import Json, print_json
from truepath.app.errors import BadInput

if TYPE_CHECKING:
    from truepath.client import Client

machines = typer.Typer(help="The machines of a running service.", no_args_is_help=True)

_LARGEST_BYTES = 1 << 20
_TEXTS = ("name", "maker", "model", "serial_number", "control", "customer", "place")
_FIELDS = (*_TEXTS, "tolerance_um", "reference_job")

MachineName = Annotated[str, typer.Argument(metavar="MACHINE", help="Its identifier.")]
State = Annotated[
    list[str] | None,
    typer.Option(
        "--state",
        metavar="FIELD=TEXT",
        help=f"One of {', '.join(_FIELDS)}; nothing after = takes it back.",
    ),
]
DeviceFile = Annotated[
    Path | None,
    typer.Option(
        "--devices",
        metavar="DEVICES.json",
        help="Drivers and their options, as `PUT /machines/{id}/devices` takes them.",
    ),
]
Quantity = Annotated[
    str,
    typer.Option(
        metavar="SYMBOL", help="volumetric, or the symbol of an error: EXX, C0Y, …"
    ),
]
Position = Annotated[
    float | None, typer.Option(help="Of the axis; one of the table's entries.")
]


@machines.command("list")
def list_machines(
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """State, last calibration and its age, volumetric error with its uncertainty."""
    with open_client(address, key_file, ca_file) as client:
        every = [_summarise(client, entry) for entry in client.list_machines()]
    if json:
        print_json({"schema": "machines-summary/1", "machines": every})
    else:
        print_machines(every)


@machines.command("show")
def show_machine(
    machine: MachineName,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Who a machine is, its axes, its devices, and how it stands."""
    with open_client(address, key_file, ca_file) as client:
        record = client.get_machine_record(machine)
        found = _summarise(client, record)
    _print_machine(found, as_json=json)


@machines.command("add")
def add_machine(
    machine: MachineName,
    machine_file: Annotated[Path, typer.Argument(metavar="MACHINE.json")],
    state: State = None,
    devices: DeviceFile = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Add a machine; with its devices the service drives it at once."""
    content, identity = _read_machine_file(machine_file), _read_stated(state)
    chosen = None if devices is None else _read_object(devices)
    with open_client(address, key_file, ca_file) as client:
        record = client.add_machine(machine, machine_file=content, identity=identity)
        if chosen is not None:
            record = client.set_machine_devices(machine, **chosen)
        found = _summarise(client, record)
    _print_machine(found, as_json=json)


@machines.command("change")
def change_machine(
    machine: MachineName,
    state: State = None,
    machine_file: Annotated[
        Path | None,
        typer.Option(metavar="MACHINE.json", help="Describes its axes anew."),
    ] = None,
    devices: DeviceFile = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Change who a machine is, its tolerance, its machine file or its devices."""
    identity = _read_stated(state)
    content = None if machine_file is None else _read_machine_file(machine_file)
    chosen = None if devices is None else _read_object(devices)
    if not identity and content is None and chosen is None:
        raise BadInput("nothing to change; give --state, --machine-file or --devices")
    with open_client(address, key_file, ca_file) as client:
        if content is not None:
            client.set_machine_file(machine, content)
        if chosen is not None:
            client.set_machine_devices(machine, **chosen)
        record = client.change_machine(machine, **identity)
        found = _summarise(client, record)
    _print_machine(found, as_json=json)


@machines.command("history")
def show_history(
    machine: MachineName,
    quantity: Quantity = "volumetric",
    position: Position = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """A quantity over all calibrations of a machine, the oldest first."""
    with open_client(address, key_file, ca_file) as client:
        found = client.get_machine_history(
            machine, quantity=quantity, position=position
        )
    if json:
        print_json(found)
    else:
        print_history(found)


@machines.command("compare")
def compare_machines(
    machine: Annotated[
        list[str] | None, typer.Argument(metavar="MACHINE...", help="Else all.")
    ] = None,
    quantity: Quantity = "volumetric",
    position: Position = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Machines by their newest usable calibration, the smallest first."""
    with open_client(address, key_file, ca_file) as client:
        found = client.compare_machines(
            machine=machine or None, quantity=quantity, position=position
        )
    if json:
        print_json(found)
    else:
        print_comparison(found)


def _summarise(client: Client, record: Any) -> dict[str, Any]:
    history = client.get_machine_history(record["id"])
    found = summarise_machine(record, history)
    if found["calibration"] is not None:
        found["standing"] = _find_standing(client, record["id"])
    return found


def _find_standing(client: Client, machine_id: str) -> dict[str, Any] | None:
    from truepath.client import Problem

    try:
        return client.get_machine_standing(machine_id)
    except Problem as error:  # its results cannot be judged
        if error.status == 404:
            return None
        raise


def _print_machine(found: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json({"schema": "machine-summary/1", **found})
    else:
        print_machine(found)


def _read_stated(stated: list[str] | None) -> dict[str, Any]:
    """Return what `FIELD=TEXT` state. Raises BadInput naming the field."""
    content: dict[str, Any] = {}
    for each in stated or ():
        name, equals, text = (part.strip() for part in each.partition("="))
        if not equals or name not in _FIELDS:
            known = ", ".join(_FIELDS)
            raise BadInput(f"--state {each!r}: write FIELD=TEXT with one of {known}")
        content[name] = _read_number(text) if name == "tolerance_um" else text or None
    return content


def _read_number(text: str) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        raise BadInput(f"--state tolerance_um={text}: is no number of µm") from None


def _read_machine_file(file: Path) -> dict[str, Any]:
    from truepath.app.files.machine_file import read_machine

    read_machine(file)  # says what is wrong by the name of the file
    return _read_object(file)


def _read_object(file: Path) -> dict[str, Any]:
    from truepath.app.errors import BundleError
    from truepath.app.files.file_model import as_object, parse_json
    from truepath.app.files.whole_files import read_whole

    content = parse_json(read_whole(file, largest_bytes=_LARGEST_BYTES), str(file))
    found = dict(as_object(content))
    if not found:
        raise BundleError("is no object, {…}", file=str(file), remedy="write an object")
    return found
