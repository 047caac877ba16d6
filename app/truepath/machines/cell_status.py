"""Last known state of a cell and its controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from truepath.measurement.messages import CellState
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import MotionState, MotionStatus

MOVING = frozenset(
    {CellState.RUNNING, CellState.PAUSING, CellState.PAUSED, CellState.RESUMING}
)

FRESH_S = 2.5  # a reading of the controller at rest, made once a second
_GOES_ON = frozenset({MotionState.RUNNING, MotionState.HELD})

NOT_READ = "its controller has not been read since; ask again"

Devices = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class CellStatus:
    """The cell's last known state.

    state : starting, down, disconnected, connecting, ready, or as the cell names it
    """

    state: str = "starting"
    text: str = ""
    restarts: int = 0
    devices: Devices = field(default_factory=dict)

    @property
    def connected(self) -> bool:
        """Whether tracker and controller have answered and nothing was lost since."""
        return bool(self.devices)


@dataclass(frozen=True, slots=True)
class ControllerLevels:
    """Last reading of the controller while nothing was measured.

    read_s : when, by the monotonic clock
    axes : names of the axes of its position, in their order
    """

    status: MotionStatus | None
    text: str
    read_s: float
    axes: tuple[str, ...] = ()

    @property
    def position_by_axis(self) -> dict[str, float]:
        """Position of the machine, mm or deg; empty where that is not known."""
        place = () if self.status is None else self.status.position
        return dict(zip(self.axes, place, strict=True)) if self.axes and place else {}

    @property
    def is_still(self) -> bool | None:
        """Whether the controller has just reported a stop; None if unknown."""
        if self.status is None or host_clock.now_s() - self.read_s > FRESH_S:
            return None
        return self.status.state not in _GOES_ON

    def word_standstill(self) -> str:
        """`is_still` as a clause on the machine, with the remedy."""
        still = self.is_still
        if self.status is None or still is None:
            return NOT_READ
        if still:
            return f"it has stopped ({self.status.state})"
        if self.status.state is MotionState.HELD:
            return (
                f"it stands by a feed hold alone ({self.status.hold_reason or 'held'}) "
                "and its program could go on; end that at the machine"
            )
        return "it moves; stop it at the machine if it does not come to a stand"
