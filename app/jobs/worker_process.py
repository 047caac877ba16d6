"""A process at the end of a pipe that computes one call after another.

Why not a pool of the standard library: the process of an aborted job is killed, and
such a pool would leave its own children waiting for ever and its semaphores behind. A
worker process ends when its pipe does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import structlog

from app.child_process import ChildProcess
from app.jobs.errors import WorkerDied
from app.progress import Progress, ignore_progress

log = structlog.get_logger(__name__)

_END_S = 5.0


@dataclass(frozen=True, slots=True)
class Call:
    """To the process: call a function of a module.

    reports_progress : it takes a keyword `on_progress`
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: Mapping[str, Any] = field(default_factory=dict)
    reports_progress: bool = False


@dataclass(frozen=True, slots=True)
class Ready:
    """From the process: it is prepared."""


@dataclass(frozen=True, slots=True)
class Progressed:
    """From the process: how far the call is."""

    share: float
    stage: str


@dataclass(frozen=True, slots=True)
class Returned:
    """From the process: the value of the call."""

    value: Any


@dataclass(frozen=True, slots=True)
class Raised:
    """From the process: what the call has raised."""

    error: Exception


class WorkerProcess:
    """One process. `call` belongs to one thread at a time, `kill` to any.

    prepare : function of a module, called first
    """

    def __init__(
        self, name: str, *, niceness: int = 0, prepare: Callable[[], None] | None = None
    ) -> None:
        self._process = ChildProcess(name, _compute, prepare, niceness=niceness)
        self._process.start()
        self._is_busy = self._is_ready = False

    def call(self, call: Call, on_progress: Progress = ignore_progress) -> Any:
        """Return the value of a call, or raise what it raises.

        Raises WorkerDied if the process ends without an answer. If `on_progress`
        raises, the process is ended.
        """
        self._is_busy = True
        answer = None
        try:
            answer = self._wait_for_answer(call, on_progress)
        finally:
            self._is_busy = False
            if answer is None:
                self.kill()
        match answer:
            case Returned(value):
                return value
            case Raised(error):
                raise error

    def kill(self) -> None:
        """End the process, whatever it does. Idempotent, any thread."""
        self._process.kill()

    def close(self) -> None:
        """End the process for good: in order where it is idle."""
        is_idle = not self._is_busy and (self._is_ready or self._process.link.poll())
        if is_idle and self._process.alive:
            self._process.link.close()
            self._process.join(_END_S)
        self._process.close()

    def _wait_for_answer(self, call: Call, on_progress: Progress) -> Returned | Raised:
        self._exchange(lambda: self._process.link.send(call))
        while True:
            message = self._exchange(self._process.link.recv)
            self._is_ready = True
            match message:
                case Progressed(share, stage):
                    on_progress(share, stage)
                case Returned() | Raised():
                    return message

    def _exchange(self, step: Callable[[], Any]) -> Any:
        try:
            return step()
        except (EOFError, OSError) as error:
            raise WorkerDied(
                "a computing process ended without an answer: killed, or out of "
                "memory; run it again, or with fewer workers"
            ) from error


def _compute(prepare: Callable[[], None] | None, link: Connection) -> None:
    """Body of the process: call what comes until nobody is there to ask."""
    if prepare is not None:
        try:
            prepare()
        except Exception:
            log.exception("the worker process is not prepared; tasks run all the same")
    with suppress(EOFError, OSError):
        link.send(Ready())
        while True:
            answer = _answer(link)
            try:
                link.send(answer)
            except (TypeError, AttributeError, ValueError) as error:
                link.send(Raised(TypeError(f"the value cannot be sent: {error}")))


def _answer(link: Connection) -> Returned | Raised:
    try:
        call: Call = link.recv()
    except (EOFError, OSError):
        raise
    except Exception as error:  # what was sent cannot be imported here
        return Raised(error)
    keywords = dict(call.keywords)
    if call.reports_progress:
        keywords["on_progress"] = lambda *done: link.send(Progressed(*done))
    try:
        return Returned(call.function(*call.arguments, **keywords))
    except Exception as error:
        return Raised(error)
