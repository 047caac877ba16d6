"""`truepath machines`: the registry of machines of a running service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from truepath.cli.summary import UNITS
from truepath.cli.terminal import (
    HERE,
    Address,
    CaFile,
    Json,
    KeyFile,
    open_client,
    print_json,
    print_table,
)
from truepath.errors import BadInput

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
K = 2.0
_LABELS = {"p95": "95 % of the places"}
_COLUMN_TEXTS = ("maker", "model", "serial_number", "control", "customer", "place")
_NONE = "–"


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
        _print_machines(every)


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
        _print_history(found)


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
        _print_comparison(found)


def _summarise(client: Client, record: Mapping[str, Any]) -> dict[str, Any]:
    from truepath.client import Problem

    history = client.get_machine_history(record["id"])
    usable = [c for c in history["calibrations"] if c["verdict"] != "not-usable"]
    if not usable:
        return {**record, "calibration": None, "standing": None}
    standing = None
    try:
        standing = client.get_machine_standing(record["id"])
    except Problem as error:
        if error.status != 404:  # its results cannot be judged
            raise
    newest = _summarise_calibration(usable[-1], history)
    return {**record, "calibration": newest, "standing": standing}


def _read_stated(stated: list[str] | None) -> dict[str, Any]:
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
    from truepath.files.bundle.machine_file import read_machine

    read_machine(file)  # names the file in its errors
    return _read_object(file)


def _read_object(file: Path) -> dict[str, Any]:
    from truepath.documents.file_model import as_object, parse_json
    from truepath.documents.whole_files import read_whole
    from truepath.errors import BundleError

    content = parse_json(read_whole(file, largest_bytes=_LARGEST_BYTES), str(file))
    found = dict(as_object(content))
    if not found:
        raise BundleError("is no object, {…}", file=str(file), remedy="write an object")
    return found


def _print_machines(every: Sequence[Mapping[str, Any]]) -> None:
    rows = [
        [
            one["id"],
            one["name"],
            _describe_state(one),
            *_describe_calibration(one["calibration"]),
            _describe_standing(one["standing"]),
        ]
        for one in every
    ]
    error = "volumetric error, µm"
    columns = ["machine", "name", "state", "calibrated", "age", error, "standing"]
    print_table("machines", columns, rows)


def _print_machine(one: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json({"schema": "machine-summary/1", **one})
        return
    measured, age, error = _describe_calibration(one["calibration"])
    devices = one["devices"]
    rows = [
        ("name", one["name"]),
        *((name.replace("_", " "), one[name]) for name in _COLUMN_TEXTS if one[name]),
        ("configured in", one["origin"]),
        ("state", _describe_state(one)),
        ("chain", str(one["machine_file"]["kinematic_chain"])),
        *_describe_axes(one["machine_file"]["axes"]),
        *((key, str(devices[key])) for key in sorted(devices) if devices[key]),
        (
            "version",
            f"{one['version']}, since {_show_time(one['versions'][0]['since'])}",
        ),
        ("calibrated", f"{measured} {age and f'({age} ago)'}".strip()),
        ("volumetric error, µm", error),
        ("tolerance, µm", _show_number(one["tolerance_um"])),
        *_describe_judgement(one["standing"]),
    ]
    width = max(len(name) for name, _ in rows)
    print(one["id"])
    for name, text in rows:
        print(f"  {name:{width}s}  {text}")


def _print_history(found: Mapping[str, Any]) -> None:
    columns = [
        "measured",
        *(_name_entry(e) for e in found["entries"]),
        "verdict",
        "job",
    ]
    rows = [
        [
            _show_time(one["measured"]),
            *(
                _show_estimate(value, u)
                for value, u in zip(one["value"], one["uncertainty"], strict=True)
            ),
            one["verdict"] or _NONE,
            one["job_id"],
        ]
        for one in found["calibrations"]
    ]
    title = f"{found['quantity']} of {found['machine']}, {UNITS[found['unit']]} (k = 2)"
    print_table(title, columns, rows)


def _print_comparison(found: Mapping[str, Any]) -> None:
    rows = [
        [
            one["machine"],
            _show_estimate(one["value"], one["uncertainty"]),
            _show_number(one["tolerance_um"]),
            ", ".join(one["is_more_than"]) or _NONE,
            _show_time(one["measured"]),
        ]
        for one in found["machines"]
    ]
    entry = {"label": found["label"], "position": found["position"]}
    unit = UNITS[found["unit"]]
    columns = ["machine", f"{unit} (k = 2)", "tolerance, µm", "more than", "measured"]
    print_table(f"{found['quantity']}, {_name_entry(entry)}", columns, rows)


def _summarise_calibration(
    newest: Mapping[str, Any], history: Mapping[str, Any]
) -> dict[str, Any]:
    at = next(i for i, e in enumerate(history["entries"]) if e["label"] == "p95")
    value, uncertainty = newest["value"][at], newest["uncertainty"][at]
    age = datetime.now(UTC) - datetime.fromisoformat(newest["measured"])
    return {
        "job_id": newest["job_id"],
        "measured": newest["measured"],
        "age_hours": max(0.0, age.total_seconds() / 3600.0),
        "verdict": newest["verdict"],
        "volumetric_error_p95_um": value,
        "expanded_uncertainty_um": None if uncertainty is None else K * uncertainty,
        "coverage_factor": K,
    }


def _describe_state(one: Mapping[str, Any]) -> str:
    if one["current_job"] is not None:
        return "measuring"
    return "not driven" if one["cell"] == "none" else str(one["cell"])


def _describe_calibration(one: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if one is None:
        return "never", "", _NONE
    hours = one["age_hours"]
    age = f"{hours:.0f} h" if hours < 48.0 else f"{hours / 24.0:.0f} d"
    value, expanded = one["volumetric_error_p95_um"], one["expanded_uncertainty_um"]
    half = None if expanded is None else expanded / K
    return _show_time(one["measured"]), age, _show_estimate(value, half)


def _describe_standing(standing: Mapping[str, Any] | None) -> str:
    if standing is None:
        return _NONE
    said = [f"tolerance: {standing['tolerance']}"] if standing["tolerance"] else []
    changed = standing["has_changed"]
    if changed is not None:
        said.append("changed" if changed else "unchanged")
    return ("ALARM: " if standing["is_alarm"] else "") + (", ".join(said) or _NONE)


def _describe_judgement(standing: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    if standing is None:
        return [("standing", _NONE)]
    texts = (standing["tolerance_text"], standing["change_text"])
    said = " ".join(text for text in texts if text)
    return [("standing", ("ALARM: " if standing["is_alarm"] else "") + said)]


def _describe_axes(axes: Mapping[str, Any]) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for name, axis in axes.items():
        unit = "deg" if axis["type"] == "rotary" else "mm"
        low, high = axis[f"min_{unit}"], axis[f"max_{unit}"]
        found.append((f"axis {name}", f"{low:g} to {high:g} {unit}"))
    return found


def _show_time(stamp: str) -> str:
    return f"{datetime.fromisoformat(stamp).astimezone():%Y-%m-%d %H:%M}"


def _name_entry(entry: Mapping[str, Any]) -> str:
    label, position = str(entry["label"]), entry["position"]
    if position is not None:
        return f"at {position:g} {entry.get('position_unit', '')}".strip()
    return _LABELS.get(label, label)


def _show_estimate(value: float | None, uncertainty: float | None) -> str:
    if value is None:
        return _NONE
    return f"{value:.1f} ± " + (
        _NONE if uncertainty is None else f"{K * uncertainty:.1f}"
    )


def _show_number(value: float | None) -> str:
    return _NONE if value is None else f"{value:g}"
