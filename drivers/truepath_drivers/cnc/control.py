"""Shared by drivers of controllers: stops that overtake, and waiting for rest."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceTimeout
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import MotionState, MotionStatus


class PriorityLock:
    """Mutual exclusion in which urgent takers come before all others. Not reentrant.

    A plain lock is taken again by a busy thread before those that wait for it wake up:
    an abort could wait for the end of an upload.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._taken = False
        self._urgent = 0

    @property
    def is_wanted(self) -> bool:
        """Whether an urgent taker waits for it."""
        return self._urgent > 0

    @contextmanager
    def hold(self, *, urgent: bool = False) -> Iterator[None]:
        self._take(urgent)
        try:
            yield
        finally:
            with self._changed:
                self._taken = False
                self._changed.notify_all()

    def _take(self, urgent: bool) -> None:
        with self._changed:
            self._urgent += urgent
            try:
                host_clock.wait_for(
                    self._changed,
                    lambda: not self._taken and (urgent or not self._urgent),
                )
            finally:
                self._urgent -= urgent
            self._taken = True


def wait_for_rest(
    motion: MotionController,
    name: str,
    require_able: Callable[[MotionStatus], object],
    timeout_s: float,
    poll_s: float,
) -> MotionStatus:
    """As `MotionController.wait`, beating meanwhile.

    require_able : raises MotionFault in a state from which the axes cannot move
    """
    deadline_s = host_clock.now_s() + timeout_s
    while True:
        motion.send_heartbeat()
        status = motion.status()
        require_able(status)
        if status.state is not MotionState.RUNNING:
            return status
        left_s = deadline_s - host_clock.now_s()
        if left_s <= 0:
            raise DeviceTimeout(
                f"{name}: still in motion after {timeout_s:g} s, at line {status.line}"
            )
        host_clock.sleep_s(min(poll_s, left_s))
