"""Reanalysis of many Runs by the present code, as one job.

Each Run is a separate task, so that other jobs get their turn in between, and leaves
its outcome in a separate folder, so that a restarted service continues with the
remaining ones. A Run that fails is named with its reason and does not affect others.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from truepath.answers.machine_history import RESULT
from truepath.catalogue.errors import Aborted, TaskFailed
from truepath.catalogue.job import Json, Progress
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.documents.whole_files import replace_file
from truepath.errors import WorkerDied
from truepath.jobs.workers.executor import (
    Computation,
    OfUnchangedRuns,
    ProcessExecutor,
    Task,
)
from truepath_drivers import host_clock

SUMMARY, OUTCOME, RUNS = "reanalysis.json", "outcome.json", "runs"
_SAME_UM = 1e-9


@dataclass(frozen=True, slots=True)
class RunOrder:
    """One Run to analyse again.

    file : empty where it is missing
    before_job : the newest job that has analysed it alone; before_file : its result
    folder : of its outcome
    sha256 : of the file when it was catalogued; empty where it is missing
    """

    run_id: str
    name: str
    file: str
    before_job: str | None
    before_file: str
    folder: str
    sha256: str


def list_orders(
    run_ids: Sequence[str],
    folder: Path,
    *,
    runs: RunCatalogue,
    store: Store,
    results: Path,
) -> list[RunOrder]:
    """Orders for the Runs, in the given order.

    folder : of the job
    """
    files, before = runs.list_files(), store.find_analyses_of_one()
    orders: list[RunOrder] = []
    for run_id in run_ids:
        name, file, sha256 = files.get(run_id, ("", Path(), ""))
        job_id = before.get(run_id)
        orders.append(
            RunOrder(
                run_id,
                name,
                str(file) if file.is_file() else "",
                job_id,
                str(results / job_id / RESULT) if job_id else "",
                str(folder / RUNS / run_id),
                sha256,
            )
        )
    return orders


@dataclass(eq=False, slots=True)
class Reanalysis:
    """The tasks of many Runs, run by the thread that calls `result`.

    task : called with a `RunOrder` and its further arguments
    started : called when the first task begins; report : with each finished Run
    """

    executor: ProcessExecutor
    task: Task
    orders: Sequence[RunOrder]
    arguments: Sequence[object]
    started: Callable[[], object]
    report: Callable[[Progress], None]
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    _computations: set[Computation] = field(default_factory=set, init=False)
    _is_cancelled: bool = field(default=False, init=False)
    _has_started: bool = field(default=False, init=False)

    def result(self) -> list[Json]:
        """Outcome of every Run, in order. Raises Aborted if cancelled."""
        todo = [order for order in self.orders if _read_outcome(order) is None]
        clock = _Clock(len(self.orders), len(self.orders) - len(todo))
        self.report(clock.read())
        with ThreadPoolExecutor(self.executor.count, "reanalysis") as pool:
            for _ in pool.map(lambda order: self._analyse(order, clock), todo):
                pass
        return [_read_outcome(order) or {} for order in self.orders]

    def cancel(self) -> None:
        """End it now. Idempotent, any thread."""
        with self._lock:
            self._is_cancelled = True
            under_way = list(self._computations)
        for computation in under_way:
            computation.cancel()

    def _analyse(self, order: RunOrder, clock: _Clock) -> None:
        if self._is_cancelled:
            raise Aborted("cancelled before it began")
        if not order.file:
            text = "its file has gone from the folder of runs"
            store_outcome(order, failure=("NotFound", text))
        else:
            self._compute(order)
        with self._lock:
            clock.count()
            self.report(clock.read())

    def _compute(self, order: RunOrder) -> None:
        computation = self.executor.submit(
            OfUnchangedRuns(self.task, {order.file: order.sha256}),
            order,
            *self.arguments,
            on_progress=lambda _share, _stage: None,
            started=self._start,
        )
        with self._lock:
            self._computations.add(computation)
            if self._is_cancelled:
                computation.cancel()
        try:
            computation.result()
        except TaskFailed as error:  # a changed file, or a defect of ours
            store_outcome(order, failure=(error.family, error.text))
        except WorkerDied as error:
            store_outcome(order, failure=(type(error).__name__, str(error)))
        finally:
            with self._lock:
                self._computations.discard(computation)

    def _start(self) -> None:
        with self._lock:
            is_first, self._has_started = not self._has_started, True
        if is_first:
            self.started()


def store_outcome(
    order: RunOrder,
    *,
    after: Json | None = None,
    failure: tuple[str, str] | None = None,
    took_s: float = 0.0,
) -> None:
    """Write the outcome of a Run, which marks it as done."""
    outcome = {
        "run_id": order.run_id,
        "name": order.name,
        "truepath": version("truepath"),
        "before_job": order.before_job,
        "before": _read_figures(Path(order.before_file)) if order.before_file else None,
        "after": after,
        "failure": dict(zip(("family", "detail"), failure, strict=True))
        if failure
        else None,
        "took_s": round(took_s, 3),
    }
    folder = Path(order.folder)
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / OUTCOME, json.dumps(outcome).encode())


def figures_of(result: Json) -> Json:
    """Summary of a result: its verdict and volumetric error."""
    mean = result["volumetric_error"]["before"]["mean"]
    return {
        "verdict": (result.get("verdict") or {}).get("state"),
        "volumetric_error_um": mean["value_um"],
        "uncertainty_um": mean["uncertainty_um"],
    }


def write_summary(folder: Path, outcomes: Sequence[Json]) -> None:
    """Write `reanalysis.json`: every Run before and after, number of changes."""
    compared = [o for o in outcomes if o.get("before") and o.get("after")]
    changes: dict[str, int] = {}
    for one in compared:
        before, after = one["before"]["verdict"], one["after"]["verdict"]
        if before != after:
            change = f"{before} -> {after}"
            changes[change] = changes.get(change, 0) + 1
    moved = [
        abs(o["after"]["volumetric_error_um"] - o["before"]["volumetric_error_um"])
        for o in compared
    ]
    content = {
        "schema": "reanalysis/1",
        "truepath": version("truepath"),
        "total": len(outcomes),
        "analysed": sum(o.get("after") is not None for o in outcomes),
        "failed": sum(o.get("failure") is not None for o in outcomes),
        "compared": len(compared),
        "unchanged": sum(um <= _SAME_UM for um in moved),
        "largest_change_um": max(moved, default=None),
        "verdict_changes": changes,
        "analyses": list(outcomes),
    }
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / SUMMARY, json.dumps(content).encode())


class _Clock:
    def __init__(self, total: int, done: int) -> None:
        self._total, self._done, self._before = total, done, done
        self._begun_s = host_clock.now_s()

    def count(self) -> None:
        self._done += 1

    def read(self) -> Progress:
        elapsed_s = host_clock.now_s() - self._begun_s
        own = self._done - self._before
        left_s = elapsed_s * (self._total - self._done) / own if own else None
        return Progress(
            float(self._done), float(self._total), "runs", left_s, elapsed_s
        )


def _read_outcome(order: RunOrder) -> Json | None:
    """None where it is still to be analysed. An outcome of another version of the
    service does not count.
    """
    try:
        content: dict[str, Any] = json.loads(
            (Path(order.folder) / OUTCOME).read_text(encoding="utf-8")
        )
    except (OSError, ValueError):
        return None
    return content if content.get("truepath") == version("truepath") else None


def _read_figures(file: Path) -> Json | None:
    try:
        return figures_of(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError):
        return None  # of a version that stated no such number, or it has gone
