"""Runs read in a separate process, within limits of memory and time.

An uploaded file may exhaust the process that reads it. So the service only stores the
file; a process with limits reads it, and is replaced where it reached one.
"""

from __future__ import annotations

import gc
import os
import resource
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import pyarrow as pa

from truepath.child_process import BACKGROUND_NICENESS, WorkerProcess
from truepath.errors import BundleError, WorkerDied
from truepath.files.bundle.bundle import MAX_BYTES, check_archive, read_bundle
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.bundle.one_machine import TimedRun
from truepath.files.bundle.run import Run
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.progress import Progress

T = TypeVar("T", covariant=True)


class _Task(Protocol[T]):
    def __call__(self, *, on_progress: Progress) -> T: ...


@dataclass(frozen=True, slots=True)
class RunFacts:
    """What the catalogue stores of a Run.

    machine : its name; plan : what was commanded, as JSON
    """

    name: str
    mode: str
    machine: str
    samples: int
    lost_samples: int
    plan: Mapping[str, Any]

    @staticmethod
    def of(run: Run) -> RunFacts:
        """Counts samples and lost samples."""
        lost_samples = np.maximum(np.diff(run.tracker.sequence) - 1, 0).sum()
        return RunFacts(
            run.name,
            run.mode,
            run.machine.name,
            len(run.tracker),
            int(lost_samples),
            encode_commanded_json(run.commanded),
        )


@dataclass(frozen=True, slots=True)
class ReadingLimits:
    """Limits on reading one Run.

    memory_mb : in addition to the process at its start; in MiB
    patience_s : after it the process is killed
    """

    memory_mb: int = 2048
    patience_s: float = 120.0


class RunReader:
    """The process that reads; started with the first Run. Thread-safe.

    One Run is read at a time: two would need the memory of two.
    """

    def __init__(self, limits: ReadingLimits | None = None) -> None:
        self._limits = limits or ReadingLimits()
        self._turn = threading.Lock()
        self._process: WorkerProcess | None = None

    def read_facts(self, bundle: Path, largest_bytes: int = MAX_BYTES) -> RunFacts:
        """Facts of a zipped bundle. Raises BundleError.

        largest_bytes : that it may unpack to
        """
        return self._call(partial(_read_facts, bundle, largest_bytes), "bundle")

    def read_times(self, run_file: Path, name: str) -> TimedRun:
        """Raises BadInput if the Run has no samples, BundleError."""
        return self._call(partial(_read_times, run_file, name), run_file.name)

    def close(self) -> None:
        """Kill the process, also while it reads. A later call starts another."""
        if (process := self._process) is not None:
            process.kill()
        with self._turn:
            self._end()

    def _call(self, task: _Task[T], file: str) -> T:
        reached, is_late = [file], threading.Event()
        with self._turn:
            process = self._process = self._process or self._start()
            try:
                with self._patience(process, is_late):
                    return process.call(task, lambda _, name: reached.append(name))
            except (WorkerDied, MemoryError) as error:
                self._end()
                raise self._reject(reached[-1], is_late=is_late.is_set()) from error

    def _start(self) -> WorkerProcess:
        prepare = partial(_limit_memory, self._limits.memory_mb << 20)
        return WorkerProcess(
            "run-reader", niceness=BACKGROUND_NICENESS, prepare=prepare
        )

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.close()
            self._process = None

    @contextmanager
    def _patience(
        self, process: WorkerProcess, is_late: threading.Event
    ) -> Iterator[None]:
        def end() -> None:
            is_late.set()
            process.kill()

        timer = threading.Timer(self._limits.patience_s, end)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            timer.join()

    def _reject(self, file: str, *, is_late: bool) -> BundleError:
        limits = self._limits
        if is_late:
            problem = f"cannot be read within {limits.patience_s:g} s"
            remedy = "send less"
        else:
            problem = f"cannot be read within {limits.memory_mb} MiB of memory"
            remedy = "send less, or raise upload_memory_mb"
        return BundleError(problem, file=file, remedy=remedy)


def _read_facts(bundle: Path, largest_bytes: int, *, on_progress: Progress) -> RunFacts:
    check_archive(bundle, largest_bytes)
    return RunFacts.of(read_bundle(bundle, partial(on_progress, 0.0)))


def _read_times(run_file: Path, name: str, *, on_progress: Progress) -> TimedRun:
    return TimedRun.of(open_recorded(run_file), name)


def _limit_memory(more_bytes: int) -> None:
    """Limit this process to so much more than it has, and let it be killed first.

    Arrow's own allocator reserves addresses by the gigabyte, so that of the system
    replaces it.
    """
    pa.set_memory_pool(pa.system_memory_pool())
    Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * os.sysconf("SC_PAGE_SIZE") + more_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
