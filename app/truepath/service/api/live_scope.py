"""Every sample of a tracker as it is recorded, in binary frames over a WebSocket.

A frame is a header of 12 bytes and `count` samples of 33 bytes, little-endian, packed:

    header   magic 4 bytes "TPLV", version u16, count u16, dropped u32
    sample   device_time_s f64, x, y, z f64 (mm, tracker's frame), status u8

`dropped` counts the samples that this client was too slow for since it connected. The
view is not the record: dropped samples are in the Run.
"""

from __future__ import annotations

import asyncio
import struct
from contextlib import suppress

import numpy as np
from fastapi import APIRouter, WebSocket

from truepath.errors import NotFound
from truepath.machines.cell_supervisor import SampleQueue
from truepath.machines.machine_cells import MachineCell
from truepath.service.api.routes.events import ASK_S, Session
from truepath.service.api.security.access_control import read_token
from truepath.service.api.service import Service
from truepath.service.api.sockets import POLICY, TRY_LATER, send_until_disconnected
from truepath_drivers.interfaces.records import TrackerSamples

MAGIC, VERSION = b"TPLV", 1
HEADER = struct.Struct("<4sHHI")
SAMPLE = np.dtype(
    [("device_time_s", "<f8"), ("position_mm", "<f8", (3,)), ("status", "u1")]
)

router = APIRouter(prefix="/machines", tags=["events"])
open_scopes: set[SampleQueue] = set()
"""Changed on the event loop only."""


def encode_frame(samples: TrackerSamples, dropped: int) -> bytes:
    """A frame; a status above 255 is 255, as invalid as any but 0."""
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
    if machine is None:
        await websocket.close(POLICY, "there is no such machine")
        return
    if len(open_scopes) >= service.max_streams:
        await websocket.close(TRY_LATER, f"{service.max_streams} views are open")
        return
    await websocket.accept()
    loop, changed = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(changed.set)

    queue = machine.cell.samples.subscribe(wake)
    open_scopes.add(queue)
    try:
        await send_until_disconnected(
            websocket, _send(websocket, service, queue, changed)
        )
    finally:
        open_scopes.remove(queue)
        machine.cell.samples.unsubscribe(queue)


async def _send(
    websocket: WebSocket, service: Service, queue: SampleQueue, changed: asyncio.Event
) -> None:
    """Raises WebSocketDisconnect, RuntimeError where the client has left."""
    session = Session(service, read_token(websocket.scope))
    while not service.closing.is_set():
        changed.clear()
        samples, dropped = queue.pop_oldest()
        while samples is not None and await session.is_open():
            await websocket.send_bytes(encode_frame(samples, dropped))
            samples, dropped = queue.pop_oldest()
        if not await session.is_open():
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), ASK_S)
