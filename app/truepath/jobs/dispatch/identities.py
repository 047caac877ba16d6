"""Certificate entries of a machine, kept in the registry of machines.

Maker, model, serial number, control, customer and location are columns of the machine;
other entries (tracker, operator, laboratory, …) are stored in addition.
"""

from __future__ import annotations

from pathlib import Path

import structlog

from truepath.catalogue.job import Job
from truepath.catalogue.machine_registry import MachineRecord, MachineRegistry
from truepath.errors import NotFound
from truepath.files.bundle.identity_file import (
    OF_ONE_MEASUREMENT,
    Identity,
    read_stored_identities,
    rename_earlier,
    write_stored_identities,
)

log = structlog.get_logger(__name__)

_OWN = {
    "machine_maker": "maker",
    "machine_model": "model",
    "serial_number": "serial_number",
    "control": "control",
    "customer": "customer",
    "place": "place",
}
"""Fields of an identity that are columns of the registry."""


def find_machine(
    job: Job, name: str, registry: MachineRegistry
) -> MachineRecord | None:
    """The job's machine, else the one of that name."""
    if job.machine is not None:
        try:
            return registry.get(job.machine)
        except NotFound:
            return None
    return registry.find_by_name(name)


def describe_identity(record: MachineRecord | None) -> Identity:
    """Stored certificate entries; empty for an unregistered machine."""
    if record is None:
        return {}
    own = {field: getattr(record, column) for field, column in _OWN.items()}
    return {
        **rename_earlier(record.stated),
        **{field: text for field, text in own.items() if text},
    }


def store_identity(
    record: MachineRecord | None, given: Identity, registry: MachineRegistry
) -> Identity:
    """Merge new entries into the stored ones; gives all of them.

    Entries for a single measurement, and those of an unregistered machine, are not
    stored.
    """
    before = describe_identity(record)
    lasting = {k: v for k, v in given.items() if k not in OF_ONE_MEASUREMENT}
    if record is not None and lasting.items() - before.items():
        own = {_OWN[field]: text for field, text in lasting.items() if field in _OWN}
        other = {k: v for k, v in lasting.items() if k not in _OWN}
        registry.change(
            record.id, **own, stated={**rename_earlier(record.stated), **other}
        )
    return {**before, **given}


def take_over_identities(data_folder: Path, registry: MachineRegistry) -> None:
    """Move entries of earlier versions from `identities.json` into the registry.

    The registry takes precedence. Machines that are not registered stay in the file
    until they are. Raises BundleError on a damaged file.
    """
    file = data_folder / "identities.json"
    kept = read_stored_identities(file)
    left = dict(kept)
    for name, stated in kept.items():
        record = registry.find_by_name(name)
        if record is not None:
            store_identity(record, {**stated, **describe_identity(record)}, registry)
            del left[name]
            log.info("identity taken over", machine=record.id)
    if left != kept:
        write_stored_identities(file, left)
