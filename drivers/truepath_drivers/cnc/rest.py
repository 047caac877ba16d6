"""Waiting until the axes of a controller are at rest."""

from __future__ import annotations

from collections.abc import Callable

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import DeviceTimeout
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import MotionState, MotionStatus


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
