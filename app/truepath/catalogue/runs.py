"""The catalogue of Runs: what was recorded here and what was uploaded.

A Run is one file in the folder of runs, `<id>.sqlite` as the cell recorded it or
`<id>.zip` as it was uploaded, named in the catalogue by its SHA-256. The file is the
truth; a row of the catalogue can be made from it again.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Select, insert, select, update

from truepath.catalogue.database import Database
from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import format_file_time, format_utc, format_utc_now, make_id
from truepath.catalogue.run_reader import RunFacts, RunReader
from truepath.catalogue.schema import deletions, runs
from truepath.documents.whole_files import replace_file, sync_to_disk
from truepath.errors import NotFound
from truepath.files.bundle.bundle import MAX_BYTES, zip_bundle
from truepath.files.bundle.one_machine import TimedRun
from truepath.measurement.run_file.run_file import hash_file
from truepath.measurement.run_file.run_loader import (
    name_known_lengths,
    open_recorded,
    open_run,
    read_job_id,
    repair_run,
)

log = structlog.get_logger(__name__)

_NAME_LENGTH = 200


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One Run of the catalogue.

    origin : `measured` here or `uploaded`; complete : whether it got to its end
    """

    seq: int
    id: str
    name: str
    origin: str
    file: str
    sha256: str
    bytes: int
    mode: str
    machine: str
    samples: int
    lost_samples: int
    complete: bool
    plan: Mapping[str, Any]
    created: str
    note: str | None = None


class RunCatalogue:
    """Runs in a folder and their rows; thread-safe.

    reader : of what was not recorded here
    """

    def __init__(self, database: Database, folder: Path, reader: RunReader) -> None:
        self._database, self._folder, self._reader = database, folder, reader
        self._packing = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)

    def name_run_file(self, run_id: str) -> Path:
        """Where the cell records the Run."""
        return self._folder / f"{run_id}.sqlite"

    def name_known_lengths(self, run_id: str) -> Path:
        """Of known lengths that were sent after the Run."""
        return name_known_lengths(self.name_run_file(run_id))

    def store_known_lengths(self, run_id: str, data: bytes | None) -> None:
        """Store known lengths with a Run, None to remove them. Raises NotFound."""
        self.get(run_id)
        kept = self.name_known_lengths(run_id)
        packed = self._folder / "bundles" / f"{run_id}.zip"
        with self._packing:
            if data is None:
                kept.unlink(missing_ok=True)
            else:
                replace_file(kept, data)
            packed.unlink(missing_ok=True)

    def add_measured(self, run_id: str) -> RunRecord | None:
        """Catalogue what the cell has recorded, once; None if nothing can be read.

        No process may be writing to it: the file of a killed writer is repaired first.
        Raises nothing: how a measurement ended matters more than its file.
        """
        if not self.name_run_file(run_id).is_file():
            return None
        try:
            return self.read_measured(run_id)
        except StorageUnavailable as error:
            log.warning("the Run is not catalogued yet", reason=str(error))
            return None
        except Exception:
            log.exception("the Run cannot be read; its file is kept")
            return None

    def read_measured(self, run_id: str) -> RunRecord:
        """Catalogue what the cell has recorded, as `add_measured`.

        Raises BundleError, OSError, sqlite3.Error or StorageUnavailable where it cannot
        be read, repaired or catalogued, now or ever.
        """
        file = self.name_run_file(run_id)
        with suppress(NotFound):
            return self.get(run_id)
        repair_run(file)
        run = open_run(file)
        complete = run.provenance.get("outcome") == "finished"
        created = format_utc(datetime.fromisoformat(str(run.provenance["started"])))
        own = {"id": run_id, "origin": "measured", "complete": complete}
        facts = RunFacts.of(run)
        return self._insert(facts, file, run.name, created=created, **own)

    def read_uploaded(self, run_id: str) -> RunRecord:
        """Catalogue a bundle that was uploaded before, once. Raises BundleError."""
        with suppress(NotFound):
            return self.get(run_id)
        file = self._folder / f"{run_id}.zip"
        facts, created = self._reader.read_facts(file), format_file_time(file)
        own = {"id": run_id, "origin": "uploaded", "complete": True}
        return self._insert(facts, file, facts.name, created=created, **own)

    def list_remaining_uploads(self) -> list[str]:
        """Runs of uploaded bundles without a row, the oldest first."""
        found = sorted(file.stem for file in self._folder.glob("*.zip"))
        deleted = self._list_deleted()
        return [i for i in found if i not in deleted and not self.find([i])]

    def list_uncatalogued(self) -> list[str]:
        """Runs of recorded files without a row, the oldest first."""
        query = select(runs.c.id).where(runs.c.origin == "measured")
        known = set(self._read_ids(query))
        recorded = sorted(file.stem for file in self._folder.glob("*.sqlite"))
        known |= self._list_deleted()
        return [run_id for run_id in recorded if run_id not in known]

    def remove_files(self, run_id: str) -> None:
        """Remove the files of a Run without a row. Raises OSError."""
        ends = (".sqlite", ".sqlite-wal", ".sqlite-shm", ".sqlite-journal", ".zip")
        for name in (*(f"{run_id}{end}" for end in ends), f"bundles/{run_id}.zip"):
            (self._folder / name).unlink(missing_ok=True)
        self.name_known_lengths(run_id).unlink(missing_ok=True)
        sync_to_disk(self._folder)

    def read_job_id(self, run_id: str) -> str:
        """The job that has recorded a Run: as in the file, else the Run's own name."""
        return read_job_id(self.name_run_file(run_id)) or run_id

    def add_uploaded(
        self, bundle: Path, name: str, largest_bytes: int = MAX_BYTES
    ) -> RunRecord:
        """Check a zipped bundle, store and catalogue it. Raises BundleError.

        bundle : a file of ours in the folder of runs; it is moved
        largest_bytes : that it may unpack to
        """
        run_id, facts = make_id(), self._reader.read_facts(bundle, largest_bytes)
        file = self._folder / f"{run_id}.zip"
        os.replace(bundle, file)
        sync_to_disk(self._folder)
        own = {"id": run_id, "origin": "uploaded", "complete": True}
        now = format_utc_now()
        return self._insert(facts, file, name or facts.name, created=now, **own)

    def get(self, run_id: str) -> RunRecord:
        """Raises NotFound."""
        query = select(runs).where(runs.c.id == run_id)
        for record in self._read(query):
            return record
        raise NotFound(f"there is no run {run_id}")

    def find(self, run_ids: Sequence[str]) -> list[str]:
        """Those that are in the catalogue, in the same order."""
        query = select(runs.c.id).where(runs.c.id.in_(run_ids))
        known = set(self._read_ids(query))
        return [i for i in run_ids if i in known]

    def list_files(self) -> dict[str, tuple[str, Path, str]]:
        """Name and file of every Run, and the SHA-256 that it is catalogued by.

        The file need not exist.
        """
        query = select(runs.c.id, runs.c.name, runs.c.file, runs.c.sha256)
        with self._database.read() as connection:
            rows = connection.execute(query).all()
        return {
            i: (name, self._folder / file, sha256) for i, name, file, sha256 in rows
        }

    def list_of_machine(self, machine: str | None, since: datetime | None) -> list[str]:
        """Runs since a time, the oldest first; machine None: of all."""
        query = select(runs.c.id).order_by(runs.c.id)
        if machine is not None:
            query = query.where(runs.c.machine == machine)
        if since is not None:
            query = query.where(runs.c.created >= format_utc(since))
        return self._read_ids(query)

    def list_page(
        self,
        limit: int,
        *,
        before_seq: int | None = None,
        name: str | None = None,
        machines: Collection[str] | None = None,
        modes: Collection[str] = (),
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> list[RunRecord]:
        """Runs, the newest first, older than `before_seq`.

        name : a part of it, in small letters or capitals
        machines : names in machine files
        since, until : created not before the one and before the other, with a zone
        """
        query = select(runs).order_by(runs.c.seq.desc()).limit(limit)
        if before_seq is not None:
            query = query.where(runs.c.seq < before_seq)
        if name is not None:
            query = query.where(runs.c.name.icontains(name, autoescape=True))
        if machines is not None:
            query = query.where(runs.c.machine.in_(machines))
        if modes:
            query = query.where(runs.c.mode.in_(modes))
        if since is not None:
            query = query.where(runs.c.created >= format_utc(since))
        if until is not None:
            query = query.where(runs.c.created < format_utc(until))
        return self._read(query)

    def rename(self, run_id: str, name: str | None, note: str | None) -> RunRecord:
        """None leaves name or note as it is. Raises NotFound."""
        given = {"name": name, "note": note}
        values = {column: text for column, text in given.items() if text is not None}
        if values:
            query = update(runs).where(runs.c.id == run_id).values(**values)
            self._database.write(lambda connection: connection.execute(query).rowcount)
        return self.get(run_id)

    def list_all(self) -> list[RunRecord]:
        """In the order of their identifiers, which is that of time."""
        return self._read(select(runs).order_by(runs.c.id))

    def file(self, run_id: str) -> Path:
        """Raises NotFound, also where the file was removed."""
        file = self._folder / self.get(run_id).file
        if not file.is_file():
            raise NotFound(f"the file of run {run_id} has gone from the folder of runs")
        return file

    def read_times(self, run_id: str) -> TimedRun:
        """Raises NotFound, BadInput."""
        name = f"{self.get(run_id).name} ({run_id})"
        return self._reader.read_times(self.file(run_id), name)

    def bundle(self, run_id: str) -> Path:
        """The Run as a zipped measurement bundle, packed once and stored."""
        file = self.file(run_id)
        if file.suffix == ".zip" and not self.name_known_lengths(run_id).is_file():
            return file
        packed = self._folder / "bundles" / f"{run_id}.zip"
        with self._packing:
            if not packed.is_file():
                packed.parent.mkdir(exist_ok=True)
                replace_file(packed, zip_bundle(open_recorded(file)))
        return packed

    def make_upload_file(self) -> Path:
        """A new empty file in the folder of runs, for an upload to fill."""
        handle, name = tempfile.mkstemp(".upload", dir=self._folder)
        os.close(handle)
        return Path(name)

    def remove_uploads(self) -> None:
        """Remove the files of interrupted uploads."""
        for left in self._folder.glob("*.upload"):
            left.unlink(missing_ok=True)

    def _list_deleted(self) -> set[str]:
        query = select(deletions.c.id).where(deletions.c.kind == "run")
        return set(self._read_ids(query))

    def _read(self, query: Select[Any]) -> list[RunRecord]:
        with self._database.read() as connection:
            return [RunRecord(**row) for row in connection.execute(query).mappings()]

    def _read_ids(self, query: Select[Any]) -> list[str]:
        with self._database.read() as connection:
            return list(connection.execute(query).scalars())

    def _insert(self, facts: RunFacts, file: Path, name: str, **own: Any) -> RunRecord:
        query = insert(runs).values(
            **own,
            name=name[:_NAME_LENGTH],
            file=file.name,
            sha256=hash_file(file),
            bytes=file.stat().st_size,
            mode=facts.mode,
            machine=facts.machine[:_NAME_LENGTH],
            samples=facts.samples,
            lost_samples=facts.lost_samples,
            plan=facts.plan,
        )
        self._database.write(lambda connection: connection.execute(query).rowcount)
        return self.get(own["id"])
