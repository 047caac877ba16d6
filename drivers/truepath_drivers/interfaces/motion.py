"""A machine controller that moves axes along loaded paths or to single positions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from truepath_drivers.interfaces.device import Device
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.interfaces.records import MotionStatus, Path


class MotionController(Device):
    """Moves axes. The controller keeps time: no setpoints are fed against a clock."""

    interface_version: ClassVar[int] = 1

    @property
    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Names of the axes in the order of every position, known after `connect`."""

    @property
    @abstractmethod
    def travel(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest position, mm or deg, known after `connect`."""

    @abstractmethod
    def status(self) -> MotionStatus:
        """Read state, positions of the axes, line and alarm."""

    @abstractmethod
    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        """Start a straight move; returns once accepted, `wait` waits for its end.

        Raises OutOfTravel before the first byte, Refused, MotionFault in alarm and in
        the other states of `UNABLE`.
        """

    @abstractmethod
    def load(self, path: Path) -> None:
        """Hand over a whole path and read it back. Raises OutOfTravel, Refused."""

    @abstractmethod
    def start(self) -> None:
        """Run the loaded path from its first row."""

    @abstractmethod
    def wait(self, timeout_s: float) -> MotionStatus:
        """Wait until the axes are at rest: finished, held or aborted.

        Raises DeviceTimeout if it still runs after `timeout_s`, MotionFault in the
        states of `UNABLE`.
        """

    @abstractmethod
    def hold(self) -> None:
        """Feed hold. Idempotent, any thread, any state."""

    @abstractmethod
    def resume(self) -> None:
        """Resume after a hold. No action if nothing is held."""

    @abstractmethod
    def abort(self) -> None:
        """Stop and discard the path. Idempotent, any thread, any state."""

    @abstractmethod
    def send_heartbeat(self) -> None:
        """Feed the controller's watchdog; it holds the feed without beats.

        No action where the identity reports no watchdog. No other verb but `wait`, and
        those that begin a motion, counts as a beat.
        """

    def reset(self) -> None:
        """Clear alarm and emergency stop, switch the drives on. Moves nothing.

        For an operator at the machine; nothing else calls it. Raises Refused where it
        has to be done at the machine.
        """
        raise Refused("this controller is reset at the machine only")

    def home(self, timeout_s: float) -> None:
        """Home the unhomed axes, and wait for it. The machine may move.

        Raises Refused where it has to be done at the machine, MotionFault, or
        DeviceTimeout if it takes longer.
        """
        raise Refused("this controller is homed at the machine only")

    def limit_override(self, largest: float) -> None:
        """Lower the feed override to `largest`, a factor, where it is above.

        Raises Refused where it can be done at the machine only.
        """
        raise Refused("the feed override of this controller is set at the machine only")
