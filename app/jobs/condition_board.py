"""Keeps since when each condition of a machine is as it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import structlog

from truepath.app.jobs.condition_findings import find_conditions
from truepath.app.jobs.conditions import (
    NO_JOB,
    Condition,
    ConditionType,
    Finding,
    Level,
    Observed,
)
from truepath.app.jobs.job import format_utc_now

log = structlog.get_logger(__name__)

LOOK_S = 1.0


@dataclass(slots=True)
class ConditionBoard:
    """Keeps since when each condition is as it is; for any thread.

    observe : reads what there is, at once
    look_s : between two looks, once it has been started
    on_change : receives each condition whose level has changed; returns at once
    path : of the job that waits to be armed, as its thread has judged it
    judge_approach : judges the way to that path from where the machine stands
    wants_compensation : what that job asks of the control, None for nothing
    """

    observe: Callable[[], Observed]
    clock: Callable[[], float] = time.monotonic
    look_s: float = LOOK_S
    on_change: Callable[[Condition], None] = lambda _: None
    path: Finding = NO_JOB
    judge_approach: Callable[[Mapping[str, float]], Finding] | None = None
    wants_compensation: bool | None = None
    _since: dict[ConditionType, tuple[Level, str]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _closing: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Look every so often, so that each change has its time."""
        threading.Thread(target=self._run, name="conditions", daemon=True).start()

    def close(self) -> None:
        """Look no more."""
        self._closing.set()

    def _run(self) -> None:
        """Body of the thread."""
        while not self._closing.wait(self.look_s):
            try:
                self.read()
            except OSError as error:  # the disk of the data cannot be asked
                log.warning("conditions are not read", reason=str(error))

    def read(self) -> list[Condition]:
        """Return every condition as it is now."""
        with self._lock:
            now_s, seen = self.clock(), self.observe()
            wants = self.wants_compensation
            found = {
                **find_conditions(seen, now_s, wants_compensation=wants),
                ConditionType.PATH_WITHIN_TRAVEL: self._find_path(seen),
            }
            return [self._note(kind, one, seen) for kind, one in found.items()]

    def _find_path(self, seen: Observed) -> Finding:
        """Return how the path lies; where that is well, how the way to it does."""
        judge = self.judge_approach
        if self.path.level is not Level.TRUE or judge is None:
            return self.path
        return judge(
            {} if seen.controller is None else seen.controller.position_by_axis
        )

    def list_obstacles(self) -> list[Condition]:
        """Return what keeps the machine from being let move."""
        return [condition for condition in self.read() if condition.is_obstacle]

    def _note(self, kind: ConditionType, found: Finding, seen: Observed) -> Condition:
        level, since = self._since.get(kind, (None, ""))
        if level is not found.level:
            since = format_utc_now()
            self._since[kind] = (found.level, since)
        is_temperature = kind is ConditionType.TEMPERATURE_STEADY
        condition = Condition(
            kind,
            found.level,
            found.reason,
            found.message,
            seen.requires(kind),
            since,
            seen.stream.temperatures if is_temperature else (),
        )
        if level not in (None, found.level):
            self.on_change(condition)
        return condition
