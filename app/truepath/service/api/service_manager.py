"""Notifies systemd of start, life and end of the service.

By datagrams to the socket that `NOTIFY_SOCKET` names, as sd_notify(3) describes them. A
sign of life comes from the event loop itself: a loop that is frozen gives none, and
systemd starts the service again. Without that socket nothing is sent.
"""

from __future__ import annotations

import asyncio
import os
import socket

import structlog

_PER_WATCHDOG = 3.0  # signs of life in the time after which systemd acts

log = structlog.get_logger(__name__)


class ServiceManager:
    """The service manager that has started this process.

    address : of its socket, empty without one; `@` begins an abstract one
    watchdog_s : time without a sign of life after which it ends the process; None:
        never
    """

    def __init__(self, address: str, watchdog_s: float | None) -> None:
        self._address, self._watchdog_s = address, watchdog_s
        self._beats: asyncio.Task[None] | None = None

    @classmethod
    def of_environment(cls) -> ServiceManager:
        """The manager of the environment, if it means this process."""
        watched = os.environ.get("WATCHDOG_PID", str(os.getpid()))
        limit_us = os.environ.get("WATCHDOG_USEC", "")
        is_watched = watched == str(os.getpid()) and limit_us.isdecimal()
        watchdog_s = int(limit_us) / 1e6 if is_watched and int(limit_us) else None
        return cls(os.environ.get("NOTIFY_SOCKET", ""), watchdog_s)

    def begin(self, status: str) -> None:
        """Report that the service answers; give signs of life from now on.

        On the event loop.
        """
        self._send(f"READY=1\nSTATUS=answers at {status}")
        if self._address and self._watchdog_s is not None:
            self._beats = asyncio.get_running_loop().create_task(self._beat())

    def end(self) -> None:
        """Report that the service ends; signs of life continue until its loop ends."""
        self._send("STOPPING=1")

    async def _beat(self) -> None:
        while True:
            self._send("WATCHDOG=1")
            await asyncio.sleep((self._watchdog_s or 0.0) / _PER_WATCHDOG)

    def _send(self, message: str) -> None:
        if not self._address:
            return
        place = self._address
        place = f"\0{place[1:]}" if place.startswith("@") else place
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
                link.setblocking(False)
                link.sendto(message.encode(), place)
        except OSError as error:
            log.warning("systemd cannot be reached", reason=str(error))
