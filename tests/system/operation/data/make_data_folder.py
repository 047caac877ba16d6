"""Makes a data folder as the service of today leaves it, for tests of later ones.

python tests/system/operation/data/make_data_folder.py FILE.zip

One Run that was uploaded and analysed, one that was measured here, jobs that have ended
well, by abort and by failure, a user, an API key and an audit log. The report of the
result is left out: nine tenths of it are a library of charts.
"""

import sys
import tempfile
import zipfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from truepath.catalogue.job import Failure, Job, JobKind
from truepath.catalogue.run_reader import RunReader
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.idempotency import IdempotencyKey
from truepath.catalogue.store.store import Store
from truepath.catalogue.transitions import State
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.jobs.workers.analysis_tasks import analyse_recorded
from truepath.jobs.workers.workers import Workers
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.motion.configurations import Configurations
from truepath.progress import ignore_progress
from truepath.users.access import Access, AccessRules
from truepath.users.audit import Entry
from truepath.users.roles import Role
from truepath_drivers.interfaces.records import Identity, TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

RATE_HZ = 50.0
PASSWORD = "a password of the fixture"


def record() -> Run:
    """Return a standstill Run of a small machine, at a tenth of the usual rate."""
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = RATE_HZ
    for axis in content["axes"].values():
        axis["min_mm"], axis["max_mm"] = 0.0, 120.0
    program = paths.standstill_points(parse_machine(content), 3, 30, dwell_s=0.8)
    recording = synthetic.record(content, program, 3, "standstill")
    machine, count = machine_from_json(content), len(recording)
    commanded = Configurations(machine.axis_names, program.position, program.dwell_s)
    samples = TrackerSamples(
        np.arange(count), recording.time_s, recording.position_mm, recording.status
    )
    return Run("from the shop floor", machine, commanded, samples)


def fill(folder: Path) -> None:
    run = record()
    (folder / "runs").mkdir(parents=True)
    with closing(Database(f"sqlite:///{folder / 'catalogue.sqlite'}")) as database:
        database.migrate()
        with closing(RunReader()) as reader:
            runs = RunCatalogue(database, folder / "runs", reader)
            store = Store(database, lambda _: None)
            add_analysis(run, runs, store, folder / "results")
            add_measurement(run, runs, store)
        end(store, Job(JobKind.PLAN), State.FAILED, Failure("PlanningError", "no time"))
        access = Access(database, AccessRules())
        add_people(access)
        access.close()


def add_analysis(run: Run, runs: RunCatalogue, store: Store, results: Path) -> None:
    upload = runs.make_upload_file()
    upload.write_bytes(zip_bundle(run))
    kept = runs.add_uploaded(upload, run.name)
    key = IdempotencyKey("fixture", b"{}")
    job, _ = store.create(Job(JobKind.ANALYSE, run_id=kept.id), key, {"request": {}})
    store.change(job.id, lambda j: replace(j, state=State.RUNNING))
    files, folder = [str(runs.file(kept.id))], str(results / job.id)
    choices = False, None, Workers()
    verdict = analyse_recorded(files, folder, *choices, on_progress=ignore_progress)
    (results / job.id / "report.html").unlink()
    store.change(job.id, lambda j: replace(j, state=State.SUCCEEDED, verdict=verdict))


def add_measurement(run: Run, runs: RunCatalogue, store: Store) -> None:
    """Record a Run as the cell does, of a job that was aborted."""
    job, _ = store.create(Job(JobKind.MEASURE_STANDSTILL))
    devices = {
        "tracker": Identity("Maker", "Tracker", "T-1", "1.0"),
        "motion": Identity("Maker", "Controller", "C-1", "2.0", has_watchdog=True),
    }
    what = "measured", run.machine, run.commanded, RATE_HZ, devices
    header = RunHeader(*what, run.machine.axis_names, job_id=job.id)
    recorder = Recorder(runs.name_run_file(job.id), header)
    for begin in range(0, len(run.tracker), 50):
        recorder.put_tracker(run.tracker.select(slice(begin, begin + 50)))
    recorder.close("finished")
    kept = runs.read_measured(job.id)
    for state in (State.PREPARING, State.READY, State.RUNNING, State.ABORTING):
        store.change(job.id, lambda j, s=state: replace(j, state=s))
    store.change(job.id, lambda j: replace(j, state=State.ABORTED, run_id=kept.id))


def end(store: Store, new: Job, state: State, failure: Failure) -> None:
    job, _ = store.create(new)
    store.change(job.id, lambda j: replace(j, state=State.RUNNING))
    store.change(job.id, lambda j: replace(j, state=state, failure=failure))


def add_people(access: Access) -> None:
    access.accounts.add("ada", Role.ADMINISTRATOR, PASSWORD)
    access.tokens.create_key("gauge-7", Role.SERVICE)
    who, what = ("ada", Role.ADMINISTRATOR, "127.0.0.1"), ("POST /api/v1/jobs", "202")
    for number in range(3):
        made = {"made": f"/api/v1/jobs/{number}"}
        entry = Entry(*who, f"r{number}", *what, old=None, new=made)
        access.audit_writer.record(entry).result(10)


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "data"
        fill(folder)
        names = [f for f in sorted(folder.rglob("*")) if f.is_file()]
        with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED) as archive:
            for file in names:
                archive.write(file, file.relative_to(folder))


if __name__ == "__main__":
    main()
