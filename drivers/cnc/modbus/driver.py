"""The driver of CNCs and PLCs that offer the register map over Modbus TCP or RTU."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.cnc.modbus import registers as r
from drivers.cnc.modbus.controller_map import (
    Controller,
    ControllerStatus,
    parse_controller,
    parse_status,
)
from drivers.cnc.modbus.link import DeviceBusy, ModbusLink, SerialAddress, TcpAddress
from drivers.cnc.modbus.priority_lock import PriorityLock
from drivers.cnc.modbus.travel import check_dwells, check_feeds, check_positions
from drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    OutOfTravel,
    Refused,
    WrongDevice,
)
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import Identity, MotionState, MotionStatus, Path

log = logging.getLogger(__name__)

_ACK_POLL_S = 0.002
_BUSY_POLL_S = 0.02
_REASONS: dict[int, str] = {
    r.Result.WRONG_STATE: "not in this state",
    r.Result.NO_PATH: "no path is loaded",
    r.Result.CRC_MISMATCH: "the path arrived damaged; load it again",
    r.Result.BAD_ARGUMENT: "an argument is out of range",
    r.Result.UNKNOWN_COMMAND: "the device does not know this command",
    r.Result.NOT_READY: "the machine is not ready; drives on, door closed, homed?",
}

T = TypeVar("T")


class ModbusController(MotionController):
    """A controller behind Modbus TCP (`host`, `port`) or RTU (`serial_port`).

    baudrate : of the RTU line, 8N1
    unit : Modbus unit (device id)
    serial_number : refuse any other controller
    command_timeout_s : longest wait for the acknowledgement of a command
    poll_s : time between two looks of `wait`

    Every verb may be called from any thread; `hold` and `abort` overtake the others.
    A command carries a number and runs once, however often it is sent.
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
        poll_s: float = 0.05,
    ) -> None:
        self._link = ModbusLink(_address(host, port, serial_port, baudrate), unit)
        self._serial_number = serial_number
        self._command_timeout_s = command_timeout_s
        self._poll_s = poll_s
        self._lock = PriorityLock()
        self._controller: Controller | None = None
        self._sequence = 0
        self._beats = 0
        self._aborts = 0

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes; none before `connect`."""
        return self._controller.axes if self._controller else ()

    @property
    def travel(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest position of each axis; none before `connect`."""
        return self._controller.travel if self._controller else ()

    def connect(self) -> Identity:
        """Open the link, check magic, word order and version, read axes and travel."""
        with self._lock.taken():
            if self._controller is None or not self._link.is_open:
                self._controller = None
                self._link.open()
                try:
                    self._controller = self._identify()
                except DeviceError:
                    self._link.close()
                    raise
                log.info(
                    "%s: %s answers; this driver has met simulated CNCs only so far",
                    self._link.name,
                    self._controller.identity,
                )
            return self._controller.identity

    def status(self) -> MotionStatus:
        """Read state, position, line; the alarm text where there is an alarm."""
        with self._lock.taken():
            motion = self._read_status().motion
            if motion.state is MotionState.ALARM:
                return replace(motion, alarm=self._alarm(motion))
            return motion

    def move_to(self, position: Sequence[float], feed_mm_min: float) -> None:
        """Start a straight move; returns when the controller has acknowledged it."""
        controller = self._known()
        path = Path(
            controller.axes,
            np.atleast_2d(np.asarray(position, np.float64)),
            np.array([feed_mm_min], np.float64),
            np.zeros(1),
        )
        check_positions(controller, path.position)
        check_feeds(controller, path.feed_mm_min)
        self._command(r.Command.MOVE_TO, _rows_argument(0, r.path_words(path)))

    def load(self, path: Path) -> None:
        """Send a path in blocks of seven rows, commit it and compare its CRC."""
        words = self._checked_words(path)
        aborts = self._aborts
        for first in range(0, len(words), r.ROWS_A_BLOCK):
            block = words[first : first + r.ROWS_A_BLOCK]
            self._command(r.Command.PUT_ROWS, _rows_argument(first, block))
            if self._aborts != aborts:
                raise Refused("aborted while the path was being loaded")
        crc = r.path_crc(words)
        status = self._command(r.Command.COMMIT, [0, len(words), *r.encode("crc", crc)])
        if (status.path_rows, status.path_crc) != (len(words), crc):
            raise MotionFault(
                f"{self._link.name}: holds {status.path_rows} rows with CRC "
                f"{status.path_crc:08x}, {len(words)} with {crc:08x} were loaded"
            )

    def start(self) -> None:
        """Run the loaded path from its first row."""
        self._command(r.Command.START)

    def wait(self, timeout_s: float) -> MotionStatus:
        """Wait until the axes stand, beating meanwhile."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            self.beat()
            status = self.status()
            if status.state is MotionState.ALARM:
                raise MotionFault(f"{self._link.name}: {status.alarm}")
            if status.state is not MotionState.RUNNING:
                return status
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise DeviceTimeout(
                    f"{self._link.name}: still in motion after {timeout_s:g} s, "
                    f"at line {status.line}"
                )
            time.sleep(min(self._poll_s, left_s))

    def hold(self) -> None:
        """Feed hold. Where nothing was ever connected there is nothing to hold.

        Raises ConnectionLost if the link is gone: the watchdog then holds the feed.
        """
        if self._controller is not None:
            self._command(r.Command.HOLD, urgent=True)

    def resume(self) -> None:
        """Go on after a hold."""
        self._command(r.Command.RESUME)

    def abort(self) -> None:
        """Stop and forget the path. Failures as for `hold`."""
        self._aborts += 1
        if self._controller is not None:
            self._command(r.Command.ABORT, urgent=True)

    def beat(self) -> None:
        """Write a new number for the watchdog."""
        with self._lock.taken():
            self._beats = (self._beats + 1) & 0xFFFF
            words = r.encode("heartbeat", self._beats)
            address = r.BY_NAME["heartbeat"].address
            self._patiently(lambda: self._link.write(address, words))

    def close(self) -> None:
        """Abort a motion that runs, release the port."""
        try:
            if self._link.is_open and self.status().state is MotionState.RUNNING:
                self.abort()
        except DeviceError as error:
            log.warning("%s closed without an answer: %s", self._link.name, error)
        with self._lock.taken(urgent=True):
            self._controller = None
            self._link.close()

    def _identify(self) -> Controller:
        try:
            controller = parse_controller(self._read(r.IDENTITY))
        except (Refused, WrongDevice) as error:
            raise WrongDevice(f"{self._link.name}: {error}") from error
        answers = controller.identity.serial_number
        if self._serial_number not in ("", answers):
            raise WrongDevice(
                f"{self._link.name}: controller {answers} answers, "
                f"{self._serial_number} is configured; check the address"
            )
        self._sequence = parse_status(self._read(r.STATUS)).acknowledged
        return controller

    def _known(self) -> Controller:
        if self._controller is None:
            raise ConnectionLost(f"{self._link.name} is not connected; connect first")
        return self._controller

    def _checked_words(self, path: Path) -> NDArray[np.uint16]:
        controller = self._known()
        if sorted(path.axes) != sorted(controller.axes):
            raise Refused(
                f"the path has the axes {' '.join(path.axes)}, "
                f"the machine {' '.join(controller.axes)}"
            )
        if not 1 <= len(path) <= controller.max_waypoints:
            raise Refused(
                f"the path has {len(path)} rows, 1 to {controller.max_waypoints} fit"
            )
        order = [path.axes.index(axis) for axis in controller.axes]
        path = replace(path, axes=controller.axes, position=path.position[:, order])
        check_positions(controller, path.position)
        check_feeds(controller, path.feed_mm_min)
        check_dwells(path.dwell_s)
        return r.path_words(path)

    def _command(
        self, verb: r.Command, arguments: Sequence[int] = (), *, urgent: bool = False
    ) -> ControllerStatus:
        """Have a verb done once; return the status that acknowledges it."""
        with self._lock.taken(urgent=urgent):
            self._sequence = self._sequence % 0xFFFF + 1
            status = self._deliver([self._sequence, verb, *arguments])
            self._judge(verb, status)
            return status

    def _deliver(self, request: list[int]) -> ControllerStatus:
        """Write a command and read until its number is acknowledged.

        After a write without reply the state is read first; then the same number is
        sent again, which runs nothing a second time.
        """
        deadline_s = time.monotonic() + self._command_timeout_s
        delivered = self._written(request)
        while True:
            status = self._read_status()
            if status.acknowledged == request[0]:
                return status
            if time.monotonic() >= deadline_s:
                raise MotionFault(
                    f"{self._link.name}: {r.Command(request[1]).name} was not taken in "
                    f"{self._command_timeout_s:g} s; the device's program stands, or "
                    "another master commands it"
                )
            if not delivered:
                delivered = self._written(request)
            time.sleep(_ACK_POLL_S)

    def _written(self, request: list[int]) -> bool:
        """Write a command; False if its outcome is unknown."""
        try:
            self._link.write(r.COMMAND.address, request)
        except DeviceTimeout as error:
            log.warning("reading back the state: %s", error)
            return False
        return True

    def _judge(self, verb: r.Command, status: ControllerStatus) -> None:
        place = f"{self._link.name} refuses {verb.name}"
        match status.result:
            case r.Result.DONE:
                return
            case r.Result.OUT_OF_TRAVEL:
                raise OutOfTravel(f"{place}: beyond the travel of an axis")
            case r.Result.IN_ALARM:
                raise MotionFault(f"{place}: {self._alarm(status.motion)}")
            case code:
                reason = _REASONS.get(code, f"result {code}")
                raise Refused(f"{place} in state {status.motion.state}: {reason}", code)

    def _read_status(self) -> ControllerStatus:
        status = parse_status(self._read(r.STATUS))
        position = status.motion.position[: len(self.axes)]
        return replace(status, motion=replace(status.motion, position=position))

    def _alarm(self, motion: MotionStatus) -> str:
        words = self._read(r.ALARM_TEXT)
        return r.decode_text("alarm_text", words, r.ALARM_TEXT) or motion.alarm

    def _read(self, block: r.Block) -> list[int]:
        return self._patiently(lambda: self._link.read(block))

    def _patiently(self, request: Callable[[], T]) -> T:
        """Repeat a harmless request while the device says that it is busy."""
        deadline_s = time.monotonic() + self._command_timeout_s
        while True:
            try:
                return request()
            except DeviceBusy:
                if time.monotonic() >= deadline_s:
                    raise
                time.sleep(_BUSY_POLL_S)


def _rows_argument(first: int, words: NDArray[np.uint16]) -> list[int]:
    """Return `first_row`, `row_count`, an unused CRC and the rows."""
    return [first, len(words), 0, 0, *(int(word) for word in words.ravel())]


def _address(
    host: str | None, port: int, serial_port: str | None, baudrate: int
) -> TcpAddress | SerialAddress:
    if (host is None) == (serial_port is None):
        raise ValueError("give either host (Modbus TCP) or serial_port (Modbus RTU)")
    if host is not None:
        return TcpAddress(host, port)
    return SerialAddress(str(serial_port), baudrate)
