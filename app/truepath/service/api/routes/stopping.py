"""Stop all motion, or that of one machine: open to everybody, never refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from anyio import CapacityLimiter, move_on_after
from anyio.to_thread import run_sync
from fastapi import APIRouter, Request, WebSocket
from pydantic import BaseModel, Field
from starlette.types import Message
from starlette.websockets import WebSocketDisconnect

from truepath.catalogue.job import Job
from truepath.errors import TruepathError
from truepath.machines.cell_status import NOT_READ
from truepath.machines.conditions import Level
from truepath.machines.machine_cells import MachineCell
from truepath.service.api.access_control import read_token
from truepath.service.api.guard import find_peer
from truepath.service.api.job import JobOut, describe_job
from truepath.service.api.models.base import PREFIX, MachinePath
from truepath.service.api.problems import declare_problems
from truepath.service.api.routes.events import TRY_LATER
from truepath.service.api.service import STOPPING, Service, ServiceDep

router = APIRouter(tags=["jobs"])

_LEVELS = {True: Level.TRUE, False: Level.FALSE, None: Level.UNKNOWN}

_LOOKING_UP = CapacityLimiter(8)
_LOOK_UP_S = 1.0  # of the sender of a stop

MOST_CHANNELS = 256
_open: dict[int, WebSocket] = {}  # the oldest first; changed on the event loop only


class MachineStop(BaseModel):
    """What the controller of a machine says of itself."""

    machine: str = Field(examples=["default"])
    stopped: Level = Field(
        description="`true` once its controller has been read and says that it has "
        "stopped, `false` where it says that it moves or only holds; `unknown` until "
        "then. Ask again."
    )
    says: str = Field(
        description="What that means, in words: what moves, holds or stands.",
        examples=["it has stopped"],
    )


class Stopped(BaseModel):
    """The jobs that a blanket abort has reached, and whether the machines stand."""

    jobs: list[JobOut] = Field(
        description="None where who stops is not logged in, or cannot be looked up."
    )
    machines: list[MachineStop]


@router.post("/stop", status_code=202)
async def stop_motion(request: Request, service: ServiceDep) -> Stopped:
    """Stop all motion and end the jobs behind it. Needs nothing, is never refused."""
    jobs = await run_sync(service.dispatcher.stop, limiter=STOPPING)
    stopped = _describe_stop(jobs, service.machines.list_all())
    return await _hide_jobs_without_login(stopped, request, service)


@router.post(
    "/machines/{machine_id}/stop", status_code=202, responses=declare_problems(404)
)
async def stop_machine(
    machine_id: MachinePath, request: Request, service: ServiceDep
) -> Stopped:
    """Stop one machine and end its job. Needs nothing, is refused for no reason."""
    jobs = await run_sync(service.dispatcher.stop, machine_id, limiter=STOPPING)
    stopped = _describe_stop(jobs, [service.machines.get(machine_id)])
    return await _hide_jobs_without_login(stopped, request, service)


@router.post("/stop:check")
async def check_stop(service: ServiceDep) -> Stopped:
    """Go the way of a stop and stop nothing: whether a stop would arrive."""
    return await _check(service.machines.list_all)


@router.post("/machines/{machine_id}/stop:check", responses=declare_problems(404))
async def check_stop_of_machine(
    machine_id: MachinePath, service: ServiceDep
) -> Stopped:
    """Go the way of a stop of one machine and stop nothing."""
    return await _check(lambda: [service.machines.get(machine_id)])


async def _check(find_machines: Callable[[], Sequence[MachineCell]]) -> Stopped:
    return _describe_stop([], await run_sync(find_machines, limiter=STOPPING))


@router.websocket("/stop")
async def stop_by_message(websocket: WebSocket) -> None:
    """Take every message for a stop but `check`; answer as `POST /stop` does.

    A channel that is open already waits for no other request of its browser.
    """
    await websocket.accept()
    while len(_open) >= MOST_CHANNELS:  # the newest one is in use
        oldest = _open.pop(next(iter(_open)))
        with suppress(RuntimeError):
            await oldest.close(TRY_LATER)
    _open[id(websocket)] = websocket
    try:
        while (message := await websocket.receive())["type"] == "websocket.receive":
            path = f"{PREFIX}/stop{':check' if message.get('text') == 'check' else ''}"
            await websocket.send_text(await _post(websocket, path))
    except (WebSocketDisconnect, RuntimeError):
        pass  # it has left; its stop was taken
    finally:
        _open.pop(id(websocket), None)


async def _post(websocket: WebSocket, path: str) -> str:
    answer = bytearray()

    async def receive() -> Message:
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        answer.extend(message.get("body", b""))

    kept = {k: websocket.scope.get(k) for k in ("asgi", "http_version", "server")}
    own = {"type": "http", "method": "POST", "path": path, "query_string": b""}
    client = (find_peer(websocket.scope), 0)
    headers = websocket.scope["headers"]
    await websocket.app(
        {**kept, **own, "client": client, "headers": headers}, receive, send
    )
    return answer.decode()


async def _hide_jobs_without_login(
    stopped: Stopped, request: Request, service: Service
) -> Stopped:
    """Omits the jobs without login, or if they cannot be looked up. Looked up after the
    stop and not for long: neither waits for the catalogue.
    """
    if not service.access.rules.log_in_required:
        return stopped
    with move_on_after(_LOOK_UP_S), suppress(TruepathError):
        known = await run_sync(
            service.access.identify,
            read_token(request.scope),
            abandon_on_cancel=True,
            limiter=_LOOKING_UP,
        )
        if known is not None:
            return stopped
    return stopped.model_copy(update={"jobs": []})


def _describe_stop(jobs: Sequence[Job], machines: Sequence[MachineCell]) -> Stopped:
    """A controller status from before the job ended does not count for the stop."""
    ending = {job.machine for job in jobs}
    stands = {
        one.id: (None, NOT_READ) if one.id in ending else one.cell.describe_standstill()
        for one in machines
    }
    return Stopped(
        jobs=[describe_job(job) for job in jobs],
        machines=[
            MachineStop(machine=name, stopped=_LEVELS[known], says=said)
            for name, (known, said) in stands.items()
        ],
    )
