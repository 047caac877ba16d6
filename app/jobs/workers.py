"""Who computes the blocks of a large sum: a `concurrent.futures.Executor`, whichever.

Science that can be cut into blocks asks for no more than that interface. Two adapters
give it: processes on this computer, and Dask for those who outgrow it
(`truepath[dask]`; imported only where it is chosen). A block depends on its number
alone, so the answer is the same on either, whatever the number of workers.

Why not the pool of the standard library: an aborted job's process is killed, and such a
pool would leave its workers waiting for ever and its semaphores behind. Here a worker
is a process at the end of a pipe: it ends when the pipe does.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Literal, TypeVar

from app.errors import BadInput
from app.jobs.errors import WorkerDied
from app.jobs.executor import limit_threads
from app.settings import Settings

T = TypeVar("T")
Ordered = Callable[[Callable[[int], T], Iterable[int]], Iterator[T]]


@dataclass(frozen=True, slots=True)
class Workers:
    """Which executor to open.

    count : calls under way together; 0 for one a core, or a thread of the cluster
    scheduler : address of the Dask scheduler; patience_s : how long it may take to
        answer
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


def workers_of(settings: Settings) -> Workers:
    """Return the workers that are set."""
    return Workers(
        settings.executor, settings.executor_workers, settings.dask_scheduler
    )


@contextmanager
def opened(workers: Workers) -> Iterator[Ordered[Any]]:
    """Open the executor; yield a `map` over it that keeps the order of the numbers.

    Calls are under way ahead of what was asked for, one a worker. At the end what is
    under way is dropped.

    Raises BadInput if Dask is not installed, WorkersAway if its scheduler is not there.
    """
    workers.check()
    if workers.kind == "dask":
        from app.jobs.dask_workers import dask_executor

        with dask_executor(workers.scheduler, workers.patience_s) as (
            executor,
            threads,
        ):
            yield in_order(executor, workers.count or threads)
        return
    count = workers.count or os.cpu_count() or 1
    executor = ProcessWorkers(count)
    try:
        yield in_order(executor, count)
    finally:
        executor.shutdown(cancel_futures=True)


def in_order(executor: Executor, width: int) -> Ordered[Any]:
    """Return a `map` that keeps so many calls under way and yields in their order."""

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
    """Spawned processes on this computer, each with a thread here that feeds it."""

    def __init__(self, count: int) -> None:
        limit_threads()
        self._own = threading.local()
        self._workers: list[tuple[BaseProcess, Connection]] = []
        self._threads = ThreadPoolExecutor(count, "worker", self._start)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Call a function of a module in one of the processes."""
        return self._threads.submit(self._there, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after what they do, or now if that is to be dropped."""
        if cancel_futures:
            for process, _ in self._workers:
                process.kill()
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process, link in self._workers:
            link.close()
            process.join()

    def _start(self) -> None:
        context = get_context("spawn")
        link, other = context.Pipe()
        process = context.Process(target=_work, args=(other,), daemon=True)
        process.start()
        other.close()
        self._workers.append((process, link))
        self._own.link = link

    def _there(
        self, fn: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> T:
        try:
            self._own.link.send((fn, args, kwargs))
            error, value = self._own.link.recv()
        except (EOFError, OSError) as gone:
            raise WorkerDied(
                "a computing process ended without an answer: killed, or out of "
                "memory; run it again, or with fewer workers"
            ) from gone
        if error is not None:
            raise error
        return value


def _work(link: Connection) -> None:
    """Body of a process: call what comes until nobody is there to ask."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            fn, args, kwargs = link.recv()
        except (EOFError, OSError):
            return
        try:
            answer = None, fn(*args, **kwargs)
        except Exception as error:
            answer = error, None
        try:
            link.send(answer)
        except OSError:
            return
