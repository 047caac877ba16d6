"""Requests and replies of one GeoCOM link: each reply belongs to its own request."""

from __future__ import annotations

import logging
import random
import threading
from typing import TypeVar

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    DeviceError,
    DeviceTimeout,
    Refused,
)
from truepath_drivers.tracker.geocom.codec import (
    NO_TARGET,
    TRANSACTIONS,
    Procedure,
    Reply,
    ReturnCode,
    describe_code,
    encode_request,
    parse_reply,
)
from truepath_drivers.transport.line_link import LineLink

log = logging.getLogger(__name__)

T = TypeVar("T", str, float)
_SHOT_TRIES = 20  # while the instrument is busy
_BUSY_S = 0.1


class GeoComSession:
    """One request at a time, from any thread."""

    def __init__(self, link: LineLink, reply_timeout_s: float) -> None:
        self.link, self._reply_timeout_s = link, reply_timeout_s
        # Not from 0: a reply left in a serial line must belong to no request.
        self._transaction = random.randrange(TRANSACTIONS)  # noqa: S311
        self._lock = threading.RLock()

    @property
    def name(self) -> str:
        """Name of the port in messages."""
        return self.link.name

    def ask_free(
        self,
        procedure: Procedure,
        values: tuple[int | float, ...],
        stopping: threading.Event,
        longer_s: float = 0.0,
    ) -> Reply:
        """Repeat a request while the instrument is busy."""
        reply = self.ask(procedure, values, longer_s)
        for _ in range(_SHOT_TRIES):
            if reply.code != ReturnCode.BUSY or host_clock.wait(stopping, _BUSY_S):
                break
            reply = self.ask(procedure, values, longer_s)
        return reply

    def ask(
        self,
        procedure: Procedure,
        values: tuple[int | float, ...] = (),
        longer_s: float = 0.0,
    ) -> Reply:
        """Send a request; gives its own reply, ignoring others before it."""
        with self._lock:
            self._transaction = self._transaction % (TRANSACTIONS - 1) + 1
            number = self._transaction
            self.link.send(encode_request(procedure, number, values))
            deadline_s = host_clock.now_s() + self._reply_timeout_s + longer_s
            while (line := self.link.receive(deadline_s)) is not None:
                reply = parse_reply(line)
                if reply is not None and reply.transaction == number:
                    return self._require_link(reply, procedure)
                log.warning("%s: left out %r", self.name, line)
        raise DeviceTimeout(
            f"{self.name}: no reply to {procedure.name} in "
            f"{self._reply_timeout_s + longer_s:g} s; is the instrument on, and GeoCOM?"
        )

    def _require_link(self, reply: Reply, procedure: Procedure) -> Reply:
        if reply.link_code == ReturnCode.PROCEDURE_UNKNOWN:
            raise Refused(
                f"{self.name}: the instrument does not know {procedure.name} "
                f"({reply.link_code}); it is of another series, or lacks a licence",
                reply.link_code,
            )
        if reply.link_code != ReturnCode.OK:
            raise DeviceError(
                f"{self.name}: {procedure.name} did not reach the instrument: "
                f"{describe_code(reply.link_code)}"
            )
        return reply


def expect_ok(reply: Reply) -> Reply:
    """A good reply, unchanged. Raises BeamLost or Refused for any other."""
    if reply.code == ReturnCode.OK:
        return reply
    if reply.code in NO_TARGET:
        raise BeamLost(
            f"the instrument sees no prism: {describe_code(reply.code)}; bring it into "
            "the beam, then go on"
        )
    raise Refused(f"the instrument refuses: {describe_code(reply.code)}", reply.code)


def decode(reply: Reply, kind: type[T], count: int = 1) -> tuple[T, ...]:
    """Values of a reply. Raises DeviceError if their number differs from `count`."""
    try:
        texts = [value.decode("utf-8", "replace").strip('"') for value in reply.values]
        if len(texts) != count:
            raise ValueError(f"{len(texts)} values")
        return tuple(kind(text) for text in texts)
    except ValueError as error:
        raise DeviceError(f"a reply holds {reply.values}: {error}") from error
