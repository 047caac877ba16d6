"""Dependencies of the routes, made by `main` and passed to the application."""

from __future__ import annotations

import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

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
