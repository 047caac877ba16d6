"""Blocks of a large sum on a Dask cluster. The only module that imports Dask.

`Client.get_executor` is an executor of the standard library. Data common to all blocks
(the bound arguments of a partial function, megabytes of arrays) are sent to the workers
once, not with every block. A worker that dies costs its current block, which another
one computes again. If the scheduler or the last worker is lost, the remaining blocks
are computed on this computer: a block depends on its number alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import TimeoutError as NotYet
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, TypeVar, cast

import structlog
from distributed import Client, KilledWorker
from distributed.client import ClosedClientError
from distributed.comm.core import CommClosedError

from truepath.catalogue.errors import WorkersAway
from truepath.errors import WorkerDied
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)
T = TypeVar("T")
_RETRIES = 2
_LOOK_S = 1.0
_AWAY = (OSError, TimeoutError, RuntimeError, ClosedClientError)


class ClusterLost(Exception):
    """No worker of the cluster is reachable any more."""


@contextmanager
def dask_map(
    scheduler: str, width: int, patience_s: float, open_home: Callable[[], Executor]
) -> Iterator[Callable[[Callable[[int], T], Iterable[int]], Iterator[T]]]:
    """Connect to a scheduler; yield a `map` over it that keeps the order of numbers.

    width : concurrent blocks; 0 for one per thread of the cluster
    patience_s : for the first reply, and for later absences of the cluster
    open_home : opens the local executor once the cluster is lost

    Raises WorkersAway if no scheduler answers at the address, or if it has no workers.
    The `map` raises WorkerDied where a block ends each worker that it is given to.
    """
    client = _connect(scheduler, patience_s)
    cluster = _Cluster(client, patience_s)
    try:
        threads = cluster.count_threads()
        if threads == 0:
            raise WorkersAway(f"the Dask scheduler at {scheduler} has no workers")
        blocks = _Blocks(cluster, width or threads, open_home)
        try:
            yield blocks.run
        finally:
            blocks.close()
    finally:
        client.close(timeout=patience_s)


def _connect(scheduler: str, patience_s: float) -> Client:
    try:
        return Client(scheduler, timeout=patience_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise WorkersAway(
            f"no Dask scheduler answers at {scheduler}; start it, or check the setting "
            "dask_scheduler"
        ) from error


class _Cluster:
    def __init__(self, client: Client, patience_s: float) -> None:
        self._client, self._patience_s = client, patience_s
        self.executor = _SentOnce(client)

    def count_threads(self) -> int:
        """Raises OSError, TimeoutError."""
        # The client makes its methods as it runs; its types do not know them.
        scheduler: Any = self._client.scheduler
        counts: Any = self._client.sync(
            scheduler.ncores, callback_timeout=self._patience_s
        )
        return sum(cast("dict[str, int]", counts).values())

    def wait_for(self, future: Future[T], number: int) -> T:
        """Raises ClusterLost after `patience_s`, WorkerDied, errors of the block."""
        deadline = host_clock.now_s() + self._patience_s
        while True:
            try:
                return future.result(_LOOK_S)
            except NotYet as error:
                if future.done():
                    raise  # the block's own
                if self._is_reachable():
                    deadline = host_clock.now_s() + self._patience_s
                elif host_clock.now_s() > deadline:
                    raise ClusterLost from error
            except KilledWorker as error:
                raise _worker_error(number, error) from error
            except (CancelledError, CommClosedError) as error:
                raise ClusterLost from error

    def _is_reachable(self) -> bool:
        try:
            return self.count_threads() > 0
        except _AWAY:
            return False


def _worker_error(number: int, error: Exception) -> WorkerDied:
    return WorkerDied(
        f"block {number} ended every worker that computed it ({error}); it is not "
        "tried again; the workers may be short of memory"
    )


class _Blocks:
    def __init__(
        self, cluster: _Cluster, width: int, open_home: Callable[[], Executor]
    ) -> None:
        self._cluster, self._width, self._open_home = cluster, width, open_home
        self._home: Executor | None = None
        self._at_home: set[Future[Any]] = set()

    def run(self, function: Callable[[int], T], numbers: Iterable[int]) -> Iterator[T]:
        ahead: deque[tuple[int, Future[T]]] = deque()
        try:
            for number in numbers:
                ahead.append((number, self._submit(function, number)))
                if len(ahead) >= self._width:
                    yield self._next_result(function, ahead)
            while ahead:
                yield self._next_result(function, ahead)
        finally:
            for _, future in ahead:
                future.cancel()

    def close(self) -> None:
        self._cluster.executor.shutdown(wait=False, cancel_futures=True)
        if self._home is not None:
            self._home.shutdown(cancel_futures=True)

    def _submit(self, function: Callable[[int], T], number: int) -> Future[T]:
        if self._home is None:
            try:
                return self._cluster.executor.submit(function, number)
            except (*_AWAY, CancelledError):
                self._home = self._open()
        return self._submit_home(self._home, function, number)

    def _submit_home(
        self, home: Executor, function: Callable[[int], T], number: int
    ) -> Future[T]:
        future = home.submit(function, number)
        self._at_home.add(future)
        return future

    def _next_result(
        self, function: Callable[[int], T], ahead: deque[tuple[int, Future[T]]]
    ) -> T:
        number, future = ahead[0]
        if self._home is None:
            try:
                result = self._cluster.wait_for(future, number)
            except ClusterLost:
                self._home = self._open()
            else:
                ahead.popleft()
                return result
        for index, (number, future) in enumerate(ahead):
            if future not in self._at_home:
                ahead[index] = number, self._submit_home(self._home, function, number)
        number, future = ahead.popleft()
        self._at_home.discard(future)
        try:
            return future.result()
        except WorkerDied as error:
            raise _worker_error(number, error) from error

    def _open(self) -> Executor:
        log.warning(
            "the Dask cluster is lost; the blocks are computed on this computer"
        )
        return self._open_home()


class _SentOnce(Executor):
    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False, retries=_RETRIES)
        self._sent: dict[int, tuple[partial[Any], list[Any]]] = {}

    def submit(
        self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any
    ) -> Future[Any]:
        if isinstance(fn, partial):
            return self._executor.submit(
                fn.func, *self._bound(fn), *args, **fn.keywords, **kwargs
            )
        return self._executor.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._sent.clear()
        with suppress(ClosedClientError):  # it gives up a scheduler that is away
            self._executor.shutdown(wait=wait and not cancel_futures)

    def _bound(self, fn: partial[Any]) -> list[Any]:
        if id(fn) not in self._sent:
            places = self._client.scatter(list(fn.args), broadcast=True, hash=False)
            self._sent[id(fn)] = fn, cast("list[Any]", places)
        return self._sent[id(fn)][1]
