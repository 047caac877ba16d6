"""Separate threads for slow routes, and for those that must not wait.

Routes share the 40 threads of AnyIO's default limiter. A route that may wait long for a
device, a disk or a hash has a few separate ones; a stop waits for none of them.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial, wraps
from typing import ParamSpec, TypeVar

from anyio import CapacityLimiter
from anyio.to_thread import run_sync

STOPPING = CapacityLimiter(8)
CONNECTING = CapacityLimiter(8)

P = ParamSpec("P")
R = TypeVar("R")


def on_threads(
    limiter: CapacityLimiter,
) -> Callable[[Callable[P, R]], Callable[P, Awaitable[R]]]:
    """Run a route on the threads of a limiter; FastAPI sees its parameters."""

    def decorate(route: Callable[P, R]) -> Callable[P, Awaitable[R]]:
        @wraps(route)
        async def run(*args: P.args, **kwargs: P.kwargs) -> R:
            return await run_sync(partial(route, *args, **kwargs), limiter=limiter)

        return run

    return decorate
