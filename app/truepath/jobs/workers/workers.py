"""Executors of the blocks of a large sum: local processes, or Dask.

Dask (`truepath[dask]`) is imported only where it is chosen. A block depends on its
number alone, so the answer is the same on either, whatever the number of workers.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any, Literal, TypeVar

from truepath.child_process import WorkerProcess
from truepath.errors import BadInput
from truepath.settings import Settings

T = TypeVar("T")
Ordered = Callable[[Callable[[int], T], Iterable[int]], Iterator[T]]


@dataclass(frozen=True, slots=True)
class Workers:
    """Executor to open; for Dask its scheduler's address and reply time.

    count : concurrent calls; 0 for one per core, or per thread of the cluster
    """

    kind: Literal["processes", "dask"] = "processes"
    count: int = 0
    scheduler: str = ""
    patience_s: float = 10.0

    def check(self) -> None:
        """Raise BadInput if this cannot be opened on this computer."""
        if self.kind == "dask" and find_spec("distributed") is None:
            raise BadInput(
                "setting executor: dask is not installed; "
                "install truepath[dask], or set executor to processes"
            )
        if self.kind == "dask" and not self.scheduler:
            raise BadInput(
                "setting dask_scheduler: is empty; "
                "give the address of the scheduler, tcp://host:8786"
            )


def choose_workers(settings: Settings) -> Workers:
    """The executor of the settings."""
    return Workers(
        settings.executor, settings.executor_workers, settings.dask_scheduler
    )


@contextmanager
def open_workers(workers: Workers) -> Iterator[Ordered[Any]]:
    """Open the executor; yield a `map` over it that keeps the order of the numbers.

    At the end active calls are dropped. Raises BadInput, WorkersAway.
    """
    workers.check()
    if workers.kind == "dask":
        from truepath.jobs.workers.dask_workers import dask_map

        with dask_map(
            workers.scheduler,
            workers.count,
            workers.patience_s,
            lambda: ProcessWorkers(os.cpu_count() or 1),
        ) as mapper:
            yield mapper
        return
    count = workers.count or os.cpu_count() or 1
    executor = ProcessWorkers(count)
    try:
        yield map_in_order(executor, count)
    finally:
        executor.shutdown(cancel_futures=True)


def map_in_order(executor: Executor, width: int) -> Ordered[Any]:
    """A `map` with `width` concurrent calls that yields in their order."""

    def run(function: Callable[[int], T], numbers: Iterable[int]) -> Iterator[T]:
        ahead: deque[Future[T]] = deque()
        try:
            for number in numbers:
                ahead.append(executor.submit(function, number))
                if len(ahead) >= width:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for future in ahead:
                future.cancel()

    return run


class ProcessWorkers(Executor):
    """Worker processes on this computer, each with a thread here that feeds it."""

    def __init__(self, count: int) -> None:
        self._own = threading.local()
        self._workers: list[WorkerProcess] = []
        self._threads = ThreadPoolExecutor(count, "block-worker", self._start)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call a function of a module in one of the processes."""
        return self._threads.submit(self._call, partial(fn, *args, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their calls, or now if these are to be dropped."""
        if cancel_futures:
            for worker in self._workers:
                worker.kill()
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for worker in self._workers:
            worker.close()

    def _start(self) -> None:
        self._own.worker = WorkerProcess("block-worker")
        self._workers.append(self._own.worker)

    def _call(self, call: Callable[[], Any]) -> Any:
        return self._own.worker.call(call)
