"""The HTTP server: its address, and the order of its shutdown."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager

import structlog
import uvicorn
from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import FastAPI

from truepath.errors import BadInput
from truepath.service.api.connections import Connections
from truepath.service.api.service import Service
from truepath.users.tls import TlsFiles

GRACE_S = 3
"""Limit of a running answer once the service has to end."""

_PER_WATCHDOG = 3.0  # signs of life in the time after which systemd acts
_TICKS_PER_CHECK = 5  # of 0.1 s
_OWN = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 (of all hosts, this one)

log = structlog.get_logger(__name__)


class Server(uvicorn.Server):
    """Uvicorn that stops motion before it waits for anything else.

    The service manager, such as systemd, is notified of start, life and end. Not in the
    application's own shut-down: an open stream delays that, and a forced exit skips it.

    address : of the service
    listening : receives the address once the service answers, in a separate thread
    tls : None for plain HTTP
    trusted_proxies : addresses shared by many clients
    ending : called first, once the server has to end
    """

    def __init__(
        self,
        app: FastAPI,
        service: Service,
        address: str,
        listening: Callable[[str], None] | None,
        *,
        tls: TlsFiles | None = None,
        trusted_proxies: Collection[str] = (),
        ending: Callable[[], None] | None = None,
    ) -> None:
        config = uvicorn.Config(
            app,
            workers=1,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,  # the application reads those of trusted proxies
            timeout_graceful_shutdown=GRACE_S,
            ssl_certfile=tls.cert if tls else None,
            ssl_keyfile=tls.key if tls else None,
        )
        super().__init__(config)
        self._service, self._address, self._listening = service, address, listening
        self._ending = ending
        self._manager = ServiceManager.of_environment()
        self._connections = Connections(
            self.server_state, service.max_streams, trusted_proxies
        )
        self._accepting: list[asyncio.Task[None]] = []

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer, and pass the address on."""
        await super().startup([])
        self._accepting = [
            asyncio.create_task(
                self._connections.accept(one, self.config, self.lifespan.state)
            )
            for one in sockets or ()
        ]
        if self.started:
            self._manager.begin(self._address)
        if self.started and self._listening is not None:
            threading.Thread(
                target=self._listening, args=(self._address,), daemon=True
            ).start()

    async def on_tick(self, counter: int) -> bool:
        """Close overdue connections as well."""
        if counter % _TICKS_PER_CHECK == 0:
            self._connections.close_overdue()
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Hold the feed, let streams end, then wait for running answers."""
        log.info("ending: motion first")
        if self._ending is not None:
            self._ending()
        self._manager.end()
        close = self._service.dispatcher.close
        await run_sync(close, limiter=CapacityLimiter(1))
        self._service.end_streams()
        for accepting in self._accepting:
            accepting.cancel()
        await super().shutdown(sockets)


class ServiceManager:
    """Notifies the service manager that has started this process, such as systemd.

    By datagrams as sd_notify(3) describes them; without `NOTIFY_SOCKET` nothing is
    sent. Signs of life come from the event loop itself: a loop that is frozen gives
    none, and systemd starts the service again.

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


@contextmanager
def end_by_signals(server: Server) -> Iterator[None]:
    """Let a signal end the server and nothing else.

    Also one that comes before uvicorn takes over, and that which it raises again.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals = (signal.SIGTERM, signal.SIGINT)
    before = {number: signal.signal(number, server.handle_exit) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def bind_socket(host: str, port: int) -> socket.socket:
    """A listening socket, port 0 for a free one; raises BadInput on failure."""
    try:
        family, _, _, _, place = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )[0]
        return socket.create_server(place[:2], family=family)
    except OSError as error:
        raise BadInput(
            f"cannot listen on {host} port {port}: {error.strerror}; "
            "stop what listens there, or give another --port"
        ) from error


def format_address(listener: socket.socket, *, is_encrypted: bool = False) -> str:
    """URL for programs on this computer."""
    bound, port = listener.getsockname()[:2]
    host = _OWN.get(bound, str(bound))
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if is_encrypted else 'http'}://{shown}:{port}"
