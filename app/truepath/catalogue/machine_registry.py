"""The machines of the catalogue: their identity, and each configuration they had.

A configuration is the machine file with the devices; a changed one is a new version,
which jobs and Runs name. Passwords among the options of a device set in the settings
are not stored.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Connection, insert, select, update

from truepath.catalogue.database import Database
from truepath.catalogue.errors import MachineKnown
from truepath.catalogue.job import Job, Json, format_utc_now
from truepath.catalogue.schema import jobs, machine_versions, machines, runs
from truepath.errors import NotFound
from truepath.files.bundle.identity_file import (
    OF_ONE_MEASUREMENT,
    Identity,
    read_stored_identities,
    rename_earlier,
    write_stored_identities,
)

IDENTITY = ("name", "maker", "model", "serial_number", "control", "customer", "place")
SETTINGS, CATALOGUE, REMOVED = "settings", "catalogue", "removed"
HIDDEN = "***"
_SECRET = ("pass", "secret", "token", "credential", "api_key", "private_key")


@dataclass(frozen=True, slots=True)
class MachineVersion:
    """One configuration of a machine, since when it holds."""

    number: int
    sha256: str
    machine_file: Mapping[str, Any]
    devices: Mapping[str, Any]
    since: str


@dataclass(frozen=True, slots=True)
class MachineRecord:
    """One machine of the catalogue.

    origin : `settings` or `catalogue`: where it is configured; `removed` where only its
        history is left
    tolerance_um : for the 95th percentile of the volumetric error
    reference_job : whose result it is compared with; None for the one before
    stated : further entries of certificates, by the names of `identity_file.FIELDS`
    versions : the newest first
    """

    id: str
    origin: str
    name: str
    maker: str
    model: str
    serial_number: str
    control: str
    customer: str
    place: str
    tolerance_um: float | None
    reference_job: str | None
    created: str
    stated: Mapping[str, str] = field(default_factory=dict[str, str])
    versions: tuple[MachineVersion, ...] = ()


class MachineRegistry:
    """Machines of the catalogue; thread-safe."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def list_all(self) -> list[MachineRecord]:
        """Every machine that was not removed, the oldest first."""
        return [one for one in self._list_known() if one.origin != REMOVED]

    def _list_known(self) -> list[MachineRecord]:
        query = select(machines.c.id).order_by(machines.c.created, machines.c.id)
        with self._database.read() as connection:
            ids = connection.execute(query).scalars().all()
            return [_read_record(connection, machine_id) for machine_id in ids]

    def get(self, machine_id: str) -> MachineRecord:
        """Removed ones too. Raises NotFound."""
        with self._database.read() as connection:
            return _read_record(connection, machine_id)

    def find_version(self, machine_id: str, number: int) -> MachineVersion | None:
        """None where machine or version is unknown."""
        try:
            versions = self.get(machine_id).versions
        except NotFound:
            return None
        return next((one for one in versions if one.number == number), None)

    def find_by_name(self, name: str) -> MachineRecord | None:
        """The machine whose newest machine file has this name; None without one."""
        for record in self._list_known():
            if record.versions and record.versions[0].machine_file.get("name") == name:
                return record
        return None

    def add(self, machine_id: str, origin: str, identity: Mapping[str, str]) -> None:
        """Also restores a removed machine. Raises MachineKnown."""

        def change(connection: Connection) -> None:
            if not _is_known(connection, machine_id):
                _insert_machine(connection, machine_id, origin, identity)
                return
            if _read_record(connection, machine_id).origin != REMOVED:
                raise MachineKnown(f"there is a machine {machine_id} already")
            values = {"origin": origin, **identity}
            own = machines.c.id == machine_id
            connection.execute(update(machines).where(own).values(**values))

        self._database.write(change)

    def record_configuration(
        self, machine_id: str, origin: str, machine_file: Json, devices: Json
    ) -> int:
        """Version of a configuration; a changed one is a new version.

        The machine is added where it is not known. Its jobs from before it had an
        identifier, known by the name in the machine file, become its own.
        """
        content = {"machine_file": machine_file, "devices": devices}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        name = str(machine_file.get("name", machine_id))

        def change(connection: Connection) -> int:
            if not _is_known(connection, machine_id):
                _insert_machine(connection, machine_id, origin, {"name": name})
            record = _read_record(connection, machine_id)
            if record.origin == REMOVED:  # the settings name it again
                own = machines.c.id == machine_id
                connection.execute(update(machines).where(own).values(origin=origin))
            known = record.versions
            if known and known[0].sha256 == sha256:
                return known[0].number
            number = known[0].number + 1 if known else 1
            row = {"machine_id": machine_id, "number": number, "sha256": sha256}
            row |= content | {"since": format_utc_now()}
            connection.execute(insert(machine_versions).values(**row))
            of_name = select(runs.c.id).where(runs.c.machine == name)
            older = jobs.c.machine.is_(None) & jobs.c.run_id.in_(of_name)
            connection.execute(update(jobs).where(older).values(machine=machine_id))
            return number

        return self._database.write(change)

    def change(self, machine_id: str, **values: Any) -> MachineRecord:
        """Identity, tolerance or reference. Raises NotFound."""
        query = update(machines).where(machines.c.id == machine_id).values(**values)

        def change(connection: Connection) -> None:
            _read_record(connection, machine_id)
            if values:
                connection.execute(query)

        self._database.write(change)
        return self.get(machine_id)


def hide_secrets(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with `***` in place of passwords."""
    return {
        name: HIDDEN if any(word in name.lower() for word in _SECRET) else value
        for name, value in options.items()
    }


def _is_known(connection: Connection, machine_id: str) -> bool:
    query = select(machines.c.id).where(machines.c.id == machine_id)
    return connection.execute(query).first() is not None


def _insert_machine(
    connection: Connection, machine_id: str, origin: str, identity: Mapping[str, str]
) -> None:
    texts = {name: identity.get(name, "") for name in IDENTITY}
    row = {"id": machine_id, "origin": origin, **texts, "created": format_utc_now()}
    connection.execute(insert(machines).values(**row))


def _read_record(connection: Connection, machine_id: str) -> MachineRecord:
    query = select(machines).where(machines.c.id == machine_id)
    row = connection.execute(query).mappings().first()
    if row is None:
        raise NotFound(f"there is no machine {machine_id}")
    own = machine_versions.c.machine_id == machine_id
    newest = select(machine_versions).where(own)
    newest = newest.order_by(machine_versions.c.number.desc())
    versions = tuple(
        MachineVersion(**{k: v for k, v in one.items() if k != "machine_id"})
        for one in connection.execute(newest).mappings()
    )
    return MachineRecord(**row, versions=versions)


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
