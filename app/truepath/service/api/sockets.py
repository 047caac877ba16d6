"""End of WebSockets: with their client, their session or the service."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketState

GOING_AWAY, POLICY, TRY_LATER = 1001, 1008, 1013


async def send_until_disconnected(
    websocket: WebSocket, sending: Coroutine[Any, Any, None]
) -> None:
    """Run a sender until it ends or the client has left, then close.

    Messages of the client are ignored.
    """
    tasks = [asyncio.create_task(_wait_for_leaving(websocket))]
    tasks.append(asyncio.create_task(sending))
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if websocket.client_state is WebSocketState.CONNECTED:
        with suppress(RuntimeError):  # it has left just now
            await websocket.close(GOING_AWAY)


async def _wait_for_leaving(websocket: WebSocket) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass
