"""Every sample of a tracker as it is recorded, in binary frames over a WebSocket.

A frame is a header of 12 bytes and `count` samples of 33 bytes, little-endian, packed:

    header   magic 4 bytes "TPLV", version u16, count u16, dropped u32
    sample   device_time_s f64, x, y, z f64 (mm, tracker's frame), status u8

`dropped` counts the samples that this client was too slow for since it connected. The
view is not the record: what is dropped here is in the Run.
"""

from __future__ import annotations

import asyncio
import struct
import time
from contextlib import suppress
from functools import partial

import numpy as np
from anyio.to_thread import run_sync
from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketState

from truepath.app.api.access_control import read_token
from truepath.app.api.events import is_let_in
from truepath.app.api.service import Service
from truepath.app.errors import NotFound
from truepath.app.jobs.machine_cells import MachineCell
from truepath.app.jobs.sample_feed import SampleQueue
from truepath.drivers.interfaces.records import TrackerSamples

MAGIC, VERSION = b"TPLV", 1
HEADER = struct.Struct("<4sHHI")
SAMPLE = np.dtype(
    [("device_time_s", "<f8"), ("position_mm", "<f8", (3,)), ("status", "u1")]
)
ASK_S = 1.0
"""How often a session is asked for, and the end of the service noticed."""
_GOING_AWAY, _POLICY, _TRY_LATER = 1001, 1008, 1013

router = APIRouter(prefix="/machines", tags=["events"])
open_scopes: set[SampleQueue] = set()
"""Changed on the event loop only."""


def encode_frame(samples: TrackerSamples, dropped: int) -> bytes:
    """Return a frame; a status above 255 is 255, as unusable as any but 0."""
    rows = np.empty(len(samples), SAMPLE)
    rows["device_time_s"] = samples.device_time_s
    rows["position_mm"] = samples.position_mm
    rows["status"] = np.where(samples.status == 0, 0, np.clip(samples.status, 1, 255))
    header = HEADER.pack(MAGIC, VERSION, len(samples), min(dropped, 0xFFFFFFFF))
    return header + rows.tobytes()


@router.websocket("/current/live")
async def show_only_machine(websocket: WebSocket) -> None:
    """Show the samples of the only or first machine."""
    service: Service = websocket.app.state.service
    await _show(websocket, service, service.machines.first)


@router.websocket("/{machine_id}/live")
async def show_machine(websocket: WebSocket, machine_id: str) -> None:
    """Show the samples of a machine."""
    service: Service = websocket.app.state.service
    try:
        machine = service.machines.get(machine_id)
    except NotFound:
        machine = None
    await _show(websocket, service, machine)


async def _show(
    websocket: WebSocket, service: Service, machine: MachineCell | None
) -> None:
    """Send frames until the client leaves, its session ends, or the service does."""
    if machine is None:
        await websocket.close(_POLICY, "there is no such machine")
        return
    if len(open_scopes) >= service.max_streams:
        await websocket.close(_TRY_LATER, f"{service.max_streams} views are open")
        return
    await websocket.accept()
    loop, changed = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(changed.set)

    queue = machine.cell.samples.subscribe(wake)
    open_scopes.add(queue)
    leaving = asyncio.create_task(_wait_for_leaving(websocket))
    sending = asyncio.create_task(_send(websocket, service, queue, changed))
    try:
        await asyncio.wait({leaving, sending}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        open_scopes.remove(queue)
        machine.cell.samples.unsubscribe(queue)
        for task in (leaving, sending):
            task.cancel()
        await asyncio.gather(leaving, sending, return_exceptions=True)
    if websocket.client_state is WebSocketState.CONNECTED:
        with suppress(RuntimeError):  # it has left just now
            await websocket.close(_GOING_AWAY)


async def _wait_for_leaving(websocket: WebSocket) -> None:
    """Return once the client has left; what it sends is not looked at."""
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass


async def _send(
    websocket: WebSocket, service: Service, queue: SampleQueue, changed: asyncio.Event
) -> None:
    """Send what comes; return when nothing may be sent any more.

    Raises WebSocketDisconnect, RuntimeError where the client has left.
    """
    is_still_let_in = partial(is_let_in, service, read_token(websocket.scope))
    asked_s = time.monotonic()
    while not service.closing.is_set():
        changed.clear()
        samples, dropped = queue.take()
        while samples is not None:
            await websocket.send_bytes(encode_frame(samples, dropped))
            samples, dropped = queue.take()
        if time.monotonic() - asked_s >= ASK_S:
            asked_s = time.monotonic()
            if not await run_sync(is_still_let_in):
                return
        with suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), ASK_S)
