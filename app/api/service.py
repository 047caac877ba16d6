"""What the routes work with, made by `main` and handed to the application."""

from __future__ import annotations

import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from truepath.app.jobs.calibrations import Calibrations
from truepath.app.jobs.database import Database
from truepath.app.jobs.deletion import Deletion
from truepath.app.jobs.dispatcher import Dispatcher
from truepath.app.jobs.event_bus import EventBus
from truepath.app.jobs.job import JobEvent
from truepath.app.jobs.machine_cells import Machines
from truepath.app.jobs.machine_setup import MachineSetup
from truepath.app.jobs.runs import RunCatalogue
from truepath.app.jobs.store import Store
from truepath.app.users.access import Access

LEAST_FREE_BYTES = 500 << 20


@dataclass(frozen=True, slots=True)
class Service:
    """Everything behind the routes.

    machines : those that it drives; setup : adds and configures them
    calibrations : theirs, and how they stand by them
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
        """Let every open stream end."""
        self.closing.set()
        self.event_bus.publish(JobEvent("closing", None, {}))

    def free_bytes(self) -> int:
        """Return the room left on the disk of the results."""
        return shutil.disk_usage(self.results).free


# On the event loop: a thread may not be free, and to stop is to need nothing.
async def _service(request: HTTPConnection) -> Service:
    return request.app.state.service


ServiceDep = Annotated[Service, Depends(_service)]
