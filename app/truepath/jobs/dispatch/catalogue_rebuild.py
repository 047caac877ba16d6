"""Recovery of a catalogue from the Runs and results on disk.

Recovered: Runs with the jobs that made them, and jobs with a result, a discovery or a
trend on disk. Not recovered: requests, plans that were not executed, jobs that failed
without a file, the history of states. Deleted jobs stay deleted.
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import func, select

from truepath.answers.machine_history import DISCOVERY, MODEL, RESULT
from truepath.catalogue import schema
from truepath.catalogue.database import Database
from truepath.catalogue.errors import (
    CatalogueDamaged,
    Interrupted,
    SchemaTooNew,
    StorageUnavailable,
)
from truepath.catalogue.job import Failure, Job, JobKind, Json, Stage, format_file_time
from truepath.catalogue.run_reader import RunReader
from truepath.catalogue.runs import RunCatalogue, RunRecord
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, NotFound
from truepath.jobs.dispatch.deletion import list_deleted_jobs
from truepath.jobs.workers.reanalysis import SUMMARY
from truepath.measurement.run_file.run_file import hash_file

TREND, VERIFICATION = "trend.json", "verification.json"
_KNOWN_POINTS = ", known points, "  # in the names of Runs that check a station
_KINDS = {
    RESULT: JobKind.ANALYSE,
    DISCOVERY: JobKind.DISCOVER,
    TREND: JobKind.TREND,
    SUMMARY: JobKind.REANALYSE,
    VERIFICATION: JobKind.VERIFY,
}
_OF_MEASUREMENT = {DISCOVERY: JobKind.MEASURE_EXTRA, VERIFICATION: JobKind.VERIFY}


@dataclass(frozen=True, slots=True)
class Recovered:
    """Counts of a recovery.

    aside : new path of the damaged file; None where it was intact
    runs, jobs, results, models : numbers added; each result and model is that of a job
    unreadable : reason by file that could not be read; these are kept
    """

    aside: Path | None
    runs: int
    jobs: int
    results: int
    models: int
    unreadable: Mapping[str, str]


def rebuild_catalogue(database: Database, runs: Path, results: Path) -> Recovered:
    """Set a damaged catalogue aside, and add what it lacks.

    An intact catalogue keeps all rows. No other process may use it meanwhile. Raises
    CatalogueReadOnly, SchemaTooOld, StorageUnavailable.
    """
    aside = _set_aside(database)
    database.migrate()
    with closing(RunReader()) as reader:
        catalogue = RunCatalogue(database, runs, reader)
        added, unreadable = _add_runs(catalogue)
    store = Store(database, lambda _: None)
    deleted = list_deleted_jobs(database, results)
    found, unreadable_results = _find_jobs(catalogue, results)
    standing = [job for job in found if job.id not in deleted]
    jobs = [job for job in standing if store.add_recovered(job, _plan(job, catalogue))]
    return Recovered(
        aside,
        added,
        len(jobs),
        sum(job.state is State.SUCCEEDED for job in jobs),
        sum((results / job.id / MODEL).is_file() for job in jobs),
        {**unreadable, **unreadable_results},
    )


def check_against_disk(
    database: Database, runs: Path, *, with_hashes: bool = False
) -> dict[str, Any]:
    """Schema and counts of a catalogue, its differences from the disk; read-only.

    with_hashes : read every Run, and name those changed since they were catalogued

    Raises CatalogueDamaged, CatalogueReadOnly, SchemaTooNew, SchemaTooOld.
    """
    revision = database.check()
    if revision is None:
        return {"revision": None}
    with database.read() as connection:
        count = select(func.count()).select_from(schema.jobs)
        jobs = connection.execute(count).scalar_one()
        query = select(schema.runs.c.id, schema.runs.c.file, schema.runs.c.sha256)
        rows = connection.execute(query).all()
    known = {run_id for run_id, _, _ in rows}
    there = [(run_id, runs / name, sha) for run_id, name, sha in rows]
    there = [row for row in there if row[1].is_file()]
    files = [*runs.glob("*.sqlite"), *runs.glob("*.zip")]
    return {
        "revision": revision,
        "jobs": jobs,
        "runs": len(rows),
        "runs_without_row": sorted({f.stem for f in files} - known),
        "rows_without_file": sorted(known - {run_id for run_id, _, _ in there}),
        "changed_files": [i for i, file, sha in there if hash_file(file) != sha]
        if with_hashes
        else None,
    }


def _set_aside(database: Database) -> Path | None:
    try:
        database.check()
    except (CatalogueDamaged, SchemaTooNew):
        file = database.file
        if file is None:
            raise
    else:
        return None
    database.close()
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    aside = file.with_name(f"{file.stem}.aside-{stamp}{file.suffix}")
    if aside.exists():
        raise BadInput(f"{aside} exists already; try again in a second")
    file.rename(aside)
    for end in ("-wal", "-shm"):
        with suppress(FileNotFoundError):
            file.with_name(file.name + end).rename(aside.with_name(aside.name + end))
    return aside


def _add_runs(catalogue: RunCatalogue) -> tuple[int, dict[str, str]]:
    left = [
        *((i, catalogue.read_measured) for i in catalogue.list_uncatalogued()),
        *((i, catalogue.read_uploaded) for i in catalogue.list_remaining_uploads()),
    ]
    unreadable: dict[str, str] = {}
    for run_id, read in sorted(left, key=lambda one: one[0]):
        _try_to_read(run_id, read, unreadable)
    return len(left) - len(unreadable), unreadable


def _try_to_read(
    run_id: str, read: Callable[[str], RunRecord], unreadable: dict[str, str]
) -> None:
    try:
        read(run_id)
    except StorageUnavailable:
        raise
    except Exception as error:  # any file may lie in the folder
        unreadable[f"run {run_id}"] = str(error) or type(error).__name__


def _find_jobs(
    catalogue: RunCatalogue, results: Path
) -> tuple[list[Job], dict[str, str]]:
    by_job: dict[str, list[RunRecord]] = defaultdict(list)
    records = catalogue.list_all()
    for record in records:
        if record.origin == "measured" and _KNOWN_POINTS not in record.name:
            by_job[catalogue.read_job_id(record.id)].append(record)
    found = {job_id: _measuring_job(job_id, own) for job_id, own in by_job.items()}
    names = {record.name: record.id for record in records}
    names |= {record.id: record.id for record in records}
    unreadable: dict[str, str] = {}
    for folder in sorted(results.iterdir()) if results.is_dir() else ():
        try:
            job = _job_of_result(folder, found.get(folder.name), names)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            unreadable[f"result {folder.name}"] = f"cannot be read ({error!r})"
            continue
        if job is not None:
            found[job.id] = job
    return [found[job_id] for job_id in sorted(found)], unreadable


def _measuring_job(job_id: str, own: list[RunRecord]) -> Job:
    first, *further = sorted(own, key=lambda r: (r.id != job_id, r.id))
    kind = JobKind.MEASURE_OTF if first.mode == "otf" else JobKind.MEASURE_STANDSTILL
    text = "found by its Run; the catalogue that knew how it ended is lost"
    return Job(
        kind,
        id=job_id,
        state=State.INTERRUPTED,
        desired_state=str(State.SUCCEEDED),
        stage=Stage.MEASURING,
        created=first.created,
        started=first.created,
        ended=first.created,
        run_id=first.id,
        further_run_ids=tuple(record.id for record in further),
        failure=Failure(Interrupted.__name__, text),
    )


def _job_of_result(
    folder: Path, measured: Job | None, names: Mapping[str, str]
) -> Job | None:
    for name, kind in _KINDS.items():
        file = folder / name
        if not file.is_file():
            continue
        content = json.loads(file.read_text(encoding="utf-8"))
        verdict = (content.get("verdict") or {}).get("state")
        run_ids = tuple(names[n] for n in _name_runs(content) if n in names)
        if measured is not None:
            kind = _OF_MEASUREMENT.get(name, measured.kind)
            own = measured.run_id
            further = tuple(i for i in run_ids if i != own)
        else:
            own, further = (run_ids[0] if run_ids else None), run_ids[1:]
        written = format_file_time(file)
        return Job(
            kind,
            id=folder.name,
            state=State.SUCCEEDED,
            desired_state=str(State.SUCCEEDED),
            stage=Stage.REPORTING,
            created=written if measured is None else measured.created,
            started=written if measured is None else measured.started,
            ended=written,
            run_id=own,
            further_run_ids=further,
            verdict=verdict,
        )
    return None


def _name_runs(content: Json) -> list[str]:
    return list(dict.fromkeys(str(run["name"]) for run in content.get("runs") or ()))


def _plan(job: Job, catalogue: RunCatalogue) -> Json | None:
    if not job.kind.measures or job.run_id is None:
        return None
    try:
        return catalogue.get(job.run_id).plan
    except NotFound:
        return None
