"""A data folder that was kept while somebody measured into it."""

import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from job_builders import begin_run, make_samples
from scripted_cell import ReaderHere
from truepath.catalogue.database import Database
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.locks import hold_folder
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import State
from truepath.files.bundle.machine_file import machine_from_json
from truepath.operation.backup import BackupContent, make_backup
from truepath.settings import load_settings
from truepath_simulators.machine_file import load_machine

DATA = Path(__file__).parent / "data"
ANALYSED = "01a220f2-f399-7474-b15c-e45c29842872"


class Backups(NamedTuple):
    """`folder` and `one.zip` in a folder, of its `data`, and who measured meanwhile."""

    folder: Path
    kept: BackupContent
    measuring: str


def unpack(place: Path, revision: str = "0014") -> Path:
    with zipfile.ZipFile(DATA / f"data_folder_v{revision}.zip") as archive:
        archive.extractall(place)
    return place


@pytest.fixture(scope="module", autouse=True)
def logged_plainly(plain_log):
    """The commands set the log up; it is put back."""


@contextmanager
def measuring(data: Path, machine) -> Iterator[str]:
    """Hold a data folder as the service does that measures into it; give the job."""
    with (
        hold_folder(data),
        closing(Database(f"sqlite:///{data / 'catalogue.sqlite'}")) as database,
    ):
        store = Store(database, lambda _: None)
        job, _ = store.create(Job(JobKind.MEASURE_OTF))
        for state in (State.PREPARING, State.READY, State.RUNNING):
            store.change(job.id, lambda j, state=state: replace(j, state=state))
        runs = RunCatalogue(database, data / "runs", ReaderHere())
        recorder = begin_run(runs, machine, job.id, job.id)
        recorder.put_tracker(make_samples(range(50)))
        yield job.id
        recorder.close("aborted")


@pytest.fixture(scope="session")
def backups(tmp_path_factory) -> Backups:
    folder = tmp_path_factory.mktemp("backup")
    data = unpack(folder / "data")
    settings = load_settings(data_dir=data, port=0)
    machine = machine_from_json(load_machine("demo"))
    with measuring(data, machine) as job_id:
        kept = make_backup(settings, folder / "folder")
        make_backup(settings, folder / "one.zip")
    return Backups(folder, kept, job_id)
