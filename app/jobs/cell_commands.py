"""Commands that wait for the thread of a cell, each a future."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

from truepath.app.jobs.errors import CellDown
from truepath.app.measurement.cell import Cell

Command = Callable[[Cell], Any]


class CellCommands:
    """A queue of commands: any thread puts them, the cell thread runs them in order."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[Command, Future[Any]]]
        self._waiting = queue.SimpleQueue()

    def put(self, command: Command) -> Future[Any]:
        """Let a command wait. Does not wait itself."""
        future: Future[Any] = Future()
        self._waiting.put((command, future))
        return future

    def run(self, cell: Cell) -> None:
        """Run all that wait."""
        for command, future in self._take():
            try:
                future.set_result(command(cell))
            except Exception as error:
                future.set_exception(error)

    def refuse(self, text: str) -> None:
        """End all that wait by CellDown."""
        for _, future in self._take():
            future.set_exception(CellDown(text))

    def _take(self) -> Iterator[tuple[Command, Future[Any]]]:
        with suppress(queue.Empty):
            while True:
                yield self._waiting.get_nowait()


def refuse_command(text: str) -> Future[Any]:
    """Return the future of a command that ends by CellDown at once."""
    future: Future[Any] = Future()
    future.set_exception(CellDown(text))
    return future
