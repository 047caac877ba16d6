"""Dependencies of the routes, made by `main` and passed to the application."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, ParamSpec, TypeVar

from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import Depends
from starlette.requests import HTTPConnection

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.database import Database
from truepath.catalogue.job import JobEvent
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.jobs.dispatch.deletion import Deletion
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.running.active_job import EventBus
from truepath.machines.machine_cells import Machines
from truepath.machines.machine_setup import MachineSetup
from truepath.users.access import Access
from truepath.users.roles import Actor

LEAST_FREE_BYTES = 500 << 20


@dataclass(frozen=True, slots=True)
class Service:
    """Everything behind the routes.

    machines : those of this service; setup : adds and configures them
    calibrations : of the machines, with their status
    access : users, roles and audit log
    closing : set when the service is about to end; open streams then end
    """

    version: str
    simulated: bool
    database: Database
    store: Store
    runs: RunCatalogue
    results: Path
    dispatcher: Dispatcher
    event_bus: EventBus
    machines: Machines
    setup: MachineSetup
    calibrations: Calibrations
    deletion: Deletion
    access: Access
    max_upload_bytes: int = 512 << 20
    max_streams: int = 64
    closing: threading.Event = field(default_factory=threading.Event)

    def end_streams(self) -> None:
        """End every open stream."""
        self.closing.set()
        self.event_bus.publish(JobEvent("closing", None, {}))

    def free_bytes(self) -> int:
        """Free space on the disk of the results."""
        return shutil.disk_usage(self.results).free


# On the event loop: a thread may not be free, and to stop is to need nothing.
async def _service(request: HTTPConnection) -> Service:
    return request.app.state.service


ServiceDep = Annotated[Service, Depends(_service)]


async def _actor(request: HTTPConnection) -> Actor | None:
    return request.state.actor


ActorDep = Annotated[Actor | None, Depends(_actor)]
"""Sender of the request; None where unknown."""


async def _access(service: ServiceDep) -> Access:
    return service.access


AccessDep = Annotated[Access, Depends(_access)]


def owner_of(actor: Actor | None) -> str | None:
    """Owner of a job; None without login."""
    return actor.name or None if actor else None


# Routes share the 40 threads of AnyIO's default limiter. A route that may wait long for
# a device, a disk or a hash has a few separate ones; a stop waits for none of them.
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
