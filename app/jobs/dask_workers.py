"""The blocks of a large sum on a Dask cluster. The only place that imports Dask.

`Client.get_executor` is an executor of the standard library. What all blocks have in
common (the bound arguments of a partial function, megabytes of arrays) is sent to the
workers once, not with every block. A worker that dies costs its block under way, which
another one computes again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

from distributed import Client

from truepath.app.jobs.errors import WorkersAway

_RETRIES = 2


@contextmanager
def dask_executor(scheduler: str, patience_s: float) -> Iterator[tuple[Executor, int]]:
    """Connect to a scheduler; yield its executor and how many threads compute there.

    Raises WorkersAway if no scheduler answers at the address, or if it has no workers.
    """
    try:
        client = Client(scheduler, timeout=patience_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise WorkersAway(
            f"no Dask scheduler answers at {scheduler}; start it, or check the setting "
            "dask_scheduler"
        ) from error
    with client:
        # The client is a synchronous one; its types speak of both kinds.
        counts = cast("dict[str, int]", client.nthreads())
        threads = sum(counts.values())
        if threads == 0:
            raise WorkersAway(f"the Dask scheduler at {scheduler} has no workers")
        executor = _SentOnce(client)
        try:
            yield executor, threads
        finally:
            executor.shutdown(wait=False, cancel_futures=True)


class _SentOnce(Executor):
    """An executor of the client that sends bound arguments once."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False, retries=_RETRIES)
        self._sent: dict[int, tuple[partial[Any], list[Any]]] = {}

    def submit(
        self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any
    ) -> Future[Any]:
        """Call a function of a module on one of the workers."""
        if isinstance(fn, partial):
            return self._executor.submit(
                fn.func, *self._bound(fn), *args, **fn.keywords, **kwargs
            )
        return self._executor.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let go of what was sent and of what is under way."""
        self._sent.clear()
        self._executor.shutdown(wait=wait and not cancel_futures)

    def _bound(self, fn: partial[Any]) -> list[Any]:
        if id(fn) not in self._sent:
            places = self._client.scatter(list(fn.args), broadcast=True, hash=False)
            self._sent[id(fn)] = fn, cast("list[Any]", places)
        return self._sent[id(fn)][1]
