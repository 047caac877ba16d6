"""Fixtures of this room, and a measurement by the whole service."""

import json
import time
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from arming import arm_at_once
from jobs_fixtures import *  # noqa: F403
from scripted_cell import wait_until
from truepath.catalogue.errors import StaleVersion
from truepath.catalogue.transitions import State
from truepath.machines.conditions.conditions import NotInOrder
from truepath.main import open_service
from truepath.settings import load_settings


class Measured(NamedTuple):
    """What was measured; `told` has the time and each notice of the way."""

    service: Any
    job: Any
    first_plan: dict
    told: list

    def list_notices(self, kind):
        return [(at, notice.body) for at, notice in self.told if notice.type == kind]


@contextmanager
def measured(request, folder, bench=None, machine=None, **more):
    """Measure to the end with a whole service, on a bench unless it brings its own."""
    chosen = {"data_dir": folder / "data", "port": 0, **more}
    if bench is not None:
        file = folder / "machine.json"
        file.write_text(json.dumps(machine), encoding="utf-8")
        links = "tracker_options", "motion_options"
        chosen |= {"machine_file": file, **{n: getattr(bench, n) for n in links}}
    told = []
    with open_service(load_settings(**chosen)) as service:
        service.event_bus.subscribe(lambda n: told.append((time.monotonic(), n)))
        cell, get = service.machines.first.cell, service.store.get
        wait_until(lambda: cell.status.state == "disconnected", "the cell")
        job, _ = service.dispatcher.create(request)
        wait_until(lambda: get(job.id).state in ("ready", "failed"), "the plan")
        first_plan = service.store.read_plan(job.id)

        def armed():
            with suppress(NotInOrder):  # until the conditions are seen to be met
                return arm_at_once(service.dispatcher, job.id, get(job.id).version)

        def ended():
            """Lock the beam again as an operator does, and resume until it goes on."""
            now = get(job.id)
            if now.state is State.PAUSED:
                with suppress(StaleVersion):
                    service.dispatcher.resume(job.id, now.version)
            return now if now.is_final else None

        wait_until(armed, "the conditions")
        done = wait_until(ended, "the end")
        assert done.state is State.SUCCEEDED, done.failure
        yield Measured(service, done, first_plan, told)
