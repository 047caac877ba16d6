"""Commands to a device that speaks GST/1, and their replies."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

from truepath_drivers.interfaces.errors import DeviceTimeout, NotHomed, Refused
from truepath_drivers.tracker.streaming.message_codec import encode_message
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    Command,
    Nak,
    NakCode,
    Ping,
    Reply,
)
from truepath_drivers.tracker.streaming.receiver import Receiver
from truepath_drivers.transport.byte_port import BytePort

_TRIES = 2


class CommandLink:
    """Sends commands over a port. One thread at a time may `ask`, any may `ping`.

    reply_timeout_s : longest wait for a reply; the command is sent twice in that time
    """

    def __init__(self, port: BytePort, reply_timeout_s: float) -> None:
        self._port, self._reply_timeout_s = port, reply_timeout_s
        self._write_lock = threading.Lock()
        self._transactions = itertools.count(1)

    def ask(
        self,
        receiver: Receiver,
        build: Callable[[int], Command],
        longer_s: float = 0.0,
    ) -> Ack:
        """Send a command until its reply comes; a repeat has the same number.

        build : makes the command from its number; longer_s : additional time

        Raises DeviceTimeout without a reply, ConnectionLost, Refused or NotHomed.
        """
        command = build(next(self._transactions) & 0xFF)
        receiver.expect(command.transaction)
        for left in reversed(range(_TRIES)):
            self._send(command)
            patience_s = self._reply_timeout_s / _TRIES + longer_s * (left == 0)
            reply = receiver.wait_reply(patience_s)
            if reply is not None:
                return self._reject_nak(reply)
        raise DeviceTimeout(
            f"{self._port.name}: no reply to {type(command).__name__.upper()} in "
            f"{self._reply_timeout_s + longer_s:g} s; is the tracker on, warm and in "
            "remote mode?"
        )

    def ping(self) -> None:
        """Send the keep-alive without waiting for its reply."""
        self._send(Ping(next(self._transactions) & 0xFF))

    def _reject_nak(self, reply: Reply) -> Ack:
        if isinstance(reply, Nak):
            family = NotHomed if reply.code == NakCode.NOT_READY else Refused
            raise family(
                f"{self._port.name} refuses: {reply.text or 'no reason given'} "
                f"(code {reply.code})",
                reply.code,
            )
        return reply

    def _send(self, command: Command) -> None:
        with self._write_lock:
            self._port.write(encode_message(command))
