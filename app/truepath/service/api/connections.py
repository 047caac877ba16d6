"""Limits on connections, so that one more is always accepted.

A stop needs a connection like any other request. All connections together therefore
take at most half of the free file descriptors, and those of one address half of that.
Beyond it a new connection replaces the one whose client is nearest to its deadline: for
sending the rest of a request, or for reading the answer.
"""

from __future__ import annotations

import asyncio
import os
import resource
import socket
from collections.abc import Collection
from typing import Any

import structlog
from uvicorn import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from truepath.log_throttle import LogThrottle
from truepath.service.api.guard import find_network, is_trusted_proxy

HEAD_S = 10.0
"""For the handshake of TLS, and for the head of a request."""
BODY_S = 20.0
"""For the body, plus 1 s per `SLOWEST_BYTES_PER_S` of it."""
SLOWEST_BYTES_PER_S = 4096
UNREAD_S = 60.0
"""Longest pause of a client that reads an answer, or that has sent much of a body."""
LONGEST_HEAD_BYTES = 1 << 16
USUAL = 512
"""Default number of connections, or twice the streams if that is more."""
_MOST_DESCRIPTORS = 1 << 16
_PAUSE_S = 0.05

log = structlog.get_logger(__name__)


class Connection(HttpToolsProtocol):
    """A connection with a deadline for the next action of its client."""

    due_s = 0.0
    _head_bytes = _unread_bytes = 0

    def data_received(self, data: bytes) -> None:
        """Extend the deadline for data of a body, not for a head."""
        now_s = self.loop.time()
        if self._waits_for_head:
            self._head_bytes += len(data)
        else:
            longer_s = self.due_s + len(data) / SLOWEST_BYTES_PER_S
            self.due_s = min(longer_s, now_s + UNREAD_S)
        super().data_received(data)
        if self._waits_for_head and self._head_bytes > LONGEST_HEAD_BYTES:
            self.transport.abort()

    def on_headers_complete(self) -> None:
        """Set the deadline of the body."""
        self._head_bytes, self.due_s = 0, self.loop.time() + BODY_S
        super().on_headers_complete()

    def on_response_complete(self) -> None:
        """Set the deadline of the next head."""
        self.due_s = self.loop.time() + self.timeout_keep_alive + HEAD_S
        super().on_response_complete()

    @property
    def waits_for_client(self) -> bool:
        """Whether the client has to act next, and not the service."""
        if self._waits_for_head or self.flow.write_paused:
            return True
        return self.cycle.more_body and not self.flow.read_paused

    def is_overdue(self) -> bool:
        """Whether the deadline of the client has passed; called at intervals."""
        now_s, unread_bytes = self.loop.time(), self.transport.get_write_buffer_size()
        if unread_bytes not in (0, self._unread_bytes):
            self._unread_bytes, self.due_s = unread_bytes, now_s + UNREAD_S
        return self.waits_for_client and now_s > self.due_s

    @property
    def _waits_for_head(self) -> bool:
        return self.cycle is None or self.cycle.response_complete


class Connections:
    """Accepts connections, and closes those that keep others out.

    most_streams : limit of the service
    trusted_proxies : addresses shared by many clients
    """

    def __init__(
        self, state: ServerState, most_streams: int, trusted_proxies: Collection[str]
    ) -> None:
        self._state, self._trusted = state, trusted_proxies
        self._most = find_most_connections(most_streams)
        self._opening: dict[Connection, socket.socket] = {}
        self._throttle = LogThrottle()

    async def accept(
        self, listener: socket.socket, config: Config, app_state: dict[str, Any]
    ) -> None:
        """Accept connections until cancelled."""
        loop = asyncio.get_running_loop()
        listener.setblocking(False)
        listener.listen(1024)
        while True:
            try:
                sock, place = await loop.sock_accept(listener)
            except OSError as error:
                self._evict(self._list_all(), f"accept: {error.strerror}")
                await asyncio.sleep(_PAUSE_S)
                continue
            self._make_room(place[0])
            one = Connection(config, self._state, app_state, loop)
            one.client, one.due_s = place[:2], loop.time() + HEAD_S
            self._opening[one] = sock
            opening = loop.create_task(self._open(one, sock, config))
            self._state.tasks.add(opening)
            opening.add_done_callback(self._state.tasks.discard)
            await asyncio.sleep(0)  # to those accepted

    def close_overdue(self) -> None:
        """Close the connections whose deadline has passed."""
        for one in [*self._state.connections]:
            if isinstance(one, Connection) and one.is_overdue():
                log.info("connection closed", client=one.client, reason="deadline")
                self._close(one)

    async def _open(self, one: Connection, sock: socket.socket, config: Config) -> None:
        try:
            await one.loop.connect_accepted_socket(
                lambda: one,
                sock,
                ssl=config.ssl,
                ssl_handshake_timeout=HEAD_S if config.ssl else None,
            )
        except OSError as error:  # no TLS, or gone
            log.debug("connection not opened", client=one.client, reason=str(error))
            sock.close()
        finally:
            del self._opening[one]

    def _make_room(self, host: str) -> None:
        held = self._list_all()
        if len(held) >= self._most // 2 and not is_trusted_proxy(host, self._trusted):
            network = find_network(host)
            own = [one for one in held if find_network(_host_of(one)) == network]
            if len(own) >= self._most // 2:
                self._evict(own, "too many of one address")
                return
        if len(held) >= self._most:
            self._evict(held, "too many in all")

    def _list_all(self) -> list[Any]:
        return list(self._state.connections | self._opening.keys())

    def _evict(self, some: list[Any], reason: str) -> None:
        if self._throttle.is_due():
            log.warning("connections closed", reason=reason, held=len(some))
        some.sort(key=_rank)
        for number, one in enumerate(some[: 1 + len(some) // 8]):
            if number == 0 or not _rank(one)[0]:  # it waits for its client
                self._close(one)

    def _close(self, one: Any) -> None:
        self._state.connections.discard(one)
        if one.transport is not None:
            one.transport.abort()
        elif one in self._opening:
            self._opening[one].shutdown(socket.SHUT_RDWR)


def find_most_connections(most_streams: int) -> int:
    """Limit of connections; raises the process's file limit where permitted."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    soft = max(soft, min(hard, _MOST_DESCRIPTORS))
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    left = soft - len(os.listdir("/proc/self/fd"))
    return max(16, min(left // 2, max(USUAL, 2 * most_streams)))


def _rank(one: Any) -> tuple[bool, float]:
    """Connections that wait for their client come first, WebSockets last."""
    if isinstance(one, Connection):
        return not one.waits_for_client, one.due_s
    return True, float("inf")


def _host_of(one: Any) -> str:
    return one.client[0] if one.client else ""
