"""The common frame of a simulator process: its orders, its life line, its end.

The parent writes one line of JSON to standard input and reads one line of JSON with the
addresses from standard output. Every further line of input is a fault to inject, or a
request for the device's state, which is answered by one line of JSON. The process ends
when the input does: a parent that dies, by whatever signal, closes it.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from typing import Any

_BLOCK = 4096


def is_question(line: str) -> bool:
    """Whether a line of input requests the state."""
    return line.startswith('{"ask"')


class LifeLine:
    """Standard input of a simulator process."""

    def __init__(self) -> None:
        # Ctrl-C reaches the whole group; the parent decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._end)
        self._parent = os.getppid()
        self._rest = b""
        self._ended = False
        self.descriptor = sys.stdin.fileno()

    @property
    def ended(self) -> bool:
        """Whether the parent has gone: end of input, SIGTERM, or another parent."""
        return self._ended or os.getppid() != self._parent

    def orders(self) -> dict[str, Any]:
        """First line of input; waits for it."""
        while b"\n" not in self._rest and not self._ended:
            self._read()
        line, _, self._rest = self._rest.partition(b"\n")
        os.set_blocking(self.descriptor, False)
        return json.loads(line or b"{}")

    def lines(self) -> list[str]:
        """Lines that have arrived since; never waits."""
        with contextlib.suppress(BlockingIOError):
            self._read()
        *lines, self._rest = self._rest.split(b"\n")
        return [line.decode() for line in lines]

    def report_failure(self, error: Exception) -> None:
        """Report to the parent why the device cannot listen."""
        self.report({"error": str(error)})

    def report(self, content: dict[str, Any]) -> None:
        """Report to the parent where the device listens, or its state."""
        sys.stdout.write(json.dumps(content) + "\n")
        sys.stdout.flush()

    def _read(self) -> None:
        data = os.read(self.descriptor, _BLOCK)
        self._ended = self._ended or not data
        self._rest += data

    def _end(self, _number: int, _frame: object) -> None:
        self._ended = True
