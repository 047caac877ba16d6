"""Driver of CNCs and PLCs with the register map over Modbus TCP or RTU."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.cnc.control import wait_for_rest
from truepath_drivers.cnc.modbus import registers as r
from truepath_drivers.cnc.modbus.commands import CommandChannel
from truepath_drivers.cnc.modbus.map_records import (
    Controller,
    arc_words,
    encode,
    path_crc,
    path_words,
)
from truepath_drivers.cnc.travel import (
    arrange_path,
    check_arcs,
    check_dwells,
    check_feeds,
    check_positions,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    MotionFault,
    Refused,
)
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    UNABLE,
    Identity,
    MotionState,
    MotionStatus,
    Path,
)
from truepath_drivers.transport.modbus_link import ModbusLink, make_address

log = logging.getLogger(__name__)


class ModbusController(MotionController):
    """A controller behind Modbus TCP (`host`, `port`) or RTU (`serial_port`).

    baudrate : of the RTU line, 8N1
    unit : Modbus unit (device id)
    serial_number : refuse any other controller
    command_timeout_s : longest wait for the acknowledgement of a command
    watchdog_s : longest silence in motion, 0.1 to 10; set and read back at `connect`
    poll_s : time between two readings of `wait`

    Every verb may be called from any thread; `hold` and `abort` overtake the others. A
    command carries a number and runs once, however often it is sent.
    """

    def __init__(
        self,
        *,
        host: str | None = None,
        port: int = 502,
        serial_port: str | None = None,
        baudrate: int = 115_200,
        unit: int = 1,
        serial_number: str = "",
        command_timeout_s: float = 1.0,
        watchdog_s: float = r.DEFAULT_WATCHDOG_S,
        poll_s: float = 0.05,
    ) -> None:
        link = ModbusLink(make_address(host, port, serial_port, baudrate), unit)
        self._channel = CommandChannel(
            link, serial_number, command_timeout_s, watchdog_s
        )
        self._poll_s = poll_s
        self._aborts = 0
        self._loaded = (0, 0)  # rows and CRC

    @property
    def axes(self) -> tuple[str, ...]:
        controller = self._channel.controller
        return controller.axes if controller else ()

    @property
    def travel(self) -> tuple[tuple[float, float], ...]:
        controller = self._channel.controller
        return controller.travel if controller else ()

    def connect(self) -> Identity:
        """Open the link, check magic, word order and version, read axes and travel."""
        return self._channel.open().identity

    def status(self) -> MotionStatus:
        return self._channel.status().motion

    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        """Start a straight move; returns when the controller has acknowledged it."""
        controller = self._require_controller()
        path = Path(
            controller.axes,
            np.atleast_2d(np.asarray(position, np.float64)),
            np.array([feed_mm_min], np.float64),
            np.zeros(1),
        )
        _check_motion(controller, path)
        self._channel.command(r.Command.MOVE_TO, _rows_argument(0, path_words(path)))

    def load(self, path: Path) -> None:
        """Send a path in blocks of seven rows and its arcs, commit, compare the CRC."""
        path = self._check(path)
        words, arcs = path_words(path), arc_words(path)
        aborts = self._aborts
        for first in range(0, len(words), r.ROWS_A_BLOCK):
            block = words[first : first + r.ROWS_A_BLOCK]
            self._channel.command(r.Command.PUT_ROWS, _rows_argument(first, block))
            if self._aborts != aborts:
                raise Refused("aborted while the path was being loaded")
        for row, arc in arcs.items():
            self._channel.command(r.Command.PUT_ARC, _rows_argument(row, arc[None]))
        if self._aborts != aborts:
            raise Refused("aborted while the path was being loaded")
        crc = path_crc(words, arcs)
        status = self._channel.command(
            r.Command.COMMIT, [0, len(words), *encode("crc", crc)]
        )
        if (status.path_rows, status.path_crc) != (len(words), crc):
            raise MotionFault(
                f"{self._channel.name}: holds {status.path_rows} rows with CRC "
                f"{status.path_crc:08x}, {len(words)} with {crc:08x} were loaded"
            )
        self._loaded = len(words), crc

    def start(self) -> None:
        """Run the path that was loaded here from its first row, and no other."""
        rows, crc = self._loaded
        self._channel.command(r.Command.START, [0, rows, *encode("crc", crc)])

    def wait(self, timeout_s: float) -> MotionStatus:
        """Wait until the axes are at rest, beating meanwhile."""
        return wait_for_rest(
            self, self._channel.name, self._require_able, timeout_s, self._poll_s
        )

    def hold(self) -> None:
        """Feed hold. No action before the first connection.

        Raises ConnectionLost if the link is lost: the watchdog then holds the feed.
        """
        if self._channel.controller is not None:
            self._channel.command(r.Command.HOLD, urgent=True)

    def resume(self) -> None:
        self._channel.command(r.Command.RESUME)

    def abort(self) -> None:
        """Stop and discard the path. Failures as for `hold`."""
        self._aborts += 1
        if self._channel.controller is not None:
            self._channel.command(r.Command.ABORT, urgent=True)

    def reset(self) -> None:
        """Clear an alarm or emergency stop whose cause has gone, drives on."""
        self._channel.command(r.Command.RESET)

    def home(self, timeout_s: float) -> None:
        self._channel.command(r.Command.HOME)
        self.wait(timeout_s)

    def limit_override(self, largest: float) -> None:
        """Lower the feed override where it is above, and confirm it."""
        override = self.status().override
        if override is not None and override <= largest:
            return
        if not self._channel.limit_override(largest):
            super().limit_override(largest)

    def send_heartbeat(self) -> None:
        self._channel.send_heartbeat()

    def close(self) -> None:
        try:
            if self._channel.is_open and self.status().state is MotionState.RUNNING:
                self.abort()
        except DeviceError as error:
            log.warning("%s closed without an answer: %s", self._channel.name, error)
        self._channel.close()

    def _require_able(self, status: MotionStatus) -> None:
        if status.state in UNABLE:
            raise MotionFault(f"{self._channel.name}: {status.alarm}")

    def _require_controller(self) -> Controller:
        controller = self._channel.controller
        if controller is None:
            raise ConnectionLost(
                f"{self._channel.name} is not connected; connect first"
            )
        return controller

    def _check(self, path: Path) -> Path:
        controller = self._require_controller()
        drives_arcs = controller.identity.drives_arcs
        path = arrange_path(path, controller.axes, drives_arcs=drives_arcs)
        if not 1 <= len(path) <= controller.max_waypoints:
            raise Refused(
                f"the path has {len(path)} rows, 1 to {controller.max_waypoints} fit"
            )
        _check_motion(controller, path)
        check_dwells(path.dwell_s, r.LONGEST_DWELL_S)
        check_arcs(path, controller.travel)
        return path


def _check_motion(controller: Controller, path: Path) -> None:
    check_positions(controller.axes, controller.travel, path.position)
    check_feeds(path.feed_mm_min, 1 / r.FEED_COUNTS, controller.max_feed_mm_min)


def _rows_argument(first: int, words: NDArray[np.uint16]) -> list[int]:
    """`first_row`, `row_count`, an unused CRC and the rows."""
    return [first, len(words), 0, 0, *(int(word) for word in words.ravel())]
