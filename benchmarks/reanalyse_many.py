"""A thousand small Runs analysed again as one job: time, memory, growth with number.

python benchmarks/reanalyse_many.py RUN.zip [COUNT] [WORKERS]

The Run is a zipped bundle; it is taken in COUNT times. Prints how long each tenth took
and the most memory of the service's process and of its workers.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from truepath.catalogue.database import Database
from truepath.catalogue.job import JobKind
from truepath.catalogue.run_reader import RunReader
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.running.active_job import EventBus
from truepath.jobs.running.context import JobContext
from truepath.jobs.workers.analysis_tasks import analyse_recorded, prepare
from truepath.jobs.workers.executor import ProcessExecutor


def measure(bundle: Path, count: int, workers: int, folder: Path) -> None:
    """Take the Runs in, analyse them again, and print what that took."""
    executor = ProcessExecutor(workers, prepare)
    url = f"sqlite:///{folder / 'catalogue.sqlite'}"
    with closing(Database(url)) as database, closing(RunReader()) as reader:
        database.migrate()
        bus = EventBus()
        runs = RunCatalogue(database, folder / "runs", reader)
        store = Store(database, bus.publish)
        context = JobContext(
            store, runs, folder / "results", executor, analyse_recorded
        )
        begun_s = time.monotonic()
        for number in range(count):
            upload = runs.make_upload_file()
            upload.write_bytes(bundle.read_bytes())
            runs.add_uploaded(upload, f"run {number}")
        print(f"{count} Runs taken in within {time.monotonic() - begun_s:.1f} s")
        with closing(Dispatcher(context, bus)) as dispatcher:
            asked = RequestedJob(JobKind.REANALYSE, runs.list_of_machine(None, None))
            job, _ = dispatcher.create(asked)
            follow(store, job.id, count)
    executor.close()
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    theirs = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    size = sum(f.stat().st_size for f in (folder / "results").rglob("*.json"))
    print(f"most memory: service {own:.0f} MB, worker {theirs:.0f} MB")
    print(f"results: {size / 1e6:.1f} MB")


def follow(store: Store, job_id: str, count: int) -> None:
    begun_s = last_s = time.monotonic()
    tenth = 1
    while not (job := store.get(job_id)).is_final:
        if job.progress.done >= tenth * count / 10:
            now_s = time.monotonic()
            print(f"  {tenth}0 %: {now_s - last_s:.1f} s", flush=True)
            last_s, tenth = now_s, tenth + 1
        time.sleep(0.2)
    print(f"{job.state}: {time.monotonic() - begun_s:.1f} s")


if __name__ == "__main__":
    given = dict(enumerate(sys.argv))
    with tempfile.TemporaryDirectory() as place:
        measure(
            Path(given[1]), int(given.get(2, 1000)), int(given.get(3, 1)), Path(place)
        )
