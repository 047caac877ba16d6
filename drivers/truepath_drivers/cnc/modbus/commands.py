"""Commands that run once, over a link that may lose requests and replies."""

from __future__ import annotations

import logging
import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar

from truepath_drivers import host_clock
from truepath_drivers.cnc.control import PriorityLock
from truepath_drivers.cnc.modbus import registers as r
from truepath_drivers.cnc.modbus.map_records import (
    Controller,
    ControllerStatus,
    decode_text,
    encode,
    parse_controller,
    parse_status,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceBusy,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    OutOfTravel,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus
from truepath_drivers.transport.modbus_link import TIMEOUT_S, ModbusLink

FIRST_S, LONGEST_S = 0.1, 1.0
_LEAST_SHARE = 0.5  # of the pause, random up to the full one


class BackOff:
    """Pauses of `FIRST_S`, each about twice the last one, up to `LONGEST_S`.

    draw : random number of 0 to 1
    """

    def __init__(self, draw: Callable[[], float] = random.random) -> None:
        self._draw = draw
        self._pause_s = self._due_s = 0.0

    def is_due(self, now_s: float) -> bool:
        return now_s >= self._due_s

    def put_off(self, now_s: float) -> None:
        """Begin a pause: an attempt is made now."""
        self._pause_s = min(2.0 * self._pause_s + FIRST_S, LONGEST_S)
        share = _LEAST_SHARE + (1.0 - _LEAST_SHARE) * self._draw()
        self._due_s = now_s + share * self._pause_s

    def reset(self) -> None:
        """Reset the pauses: the link works."""
        self._pause_s = self._due_s = 0.0


log = logging.getLogger(__name__)

_ACK_POLL_S = 0.002
_BUSY_POLL_S = 0.02
_BUSY_S = 0.2  # that a look or a beat waits: by 0.5 s without a look the feed is held
_SAME = 0.6 / r.OVERRIDE_COUNTS  # of overrides, in their last digit
_URGENT_S = 0.45  # limit to report a hold that does not reach the controller
_REASONS: dict[int, str] = {
    r.Result.WRONG_STATE: "not in this state",
    r.Result.NO_PATH: "no path is loaded",
    r.Result.CRC_MISMATCH: "the path arrived damaged or is another; load it again",
    r.Result.BAD_ARGUMENT: "an argument is out of range",
    r.Result.UNKNOWN_COMMAND: "the device does not know this command",
    r.Result.NOT_READY: "the machine is not ready; drives on, door closed, homed?",
}

T = TypeVar("T")


class CommandChannel:
    """The registers of one controller as reads, beats and commands. For any thread.

    controller : found at `open`; None before it and after `close`

    Every exchange has the link alone, from a command's number to its acknowledgement;
    urgent ones go before all that wait.
    """

    def __init__(
        self,
        link: ModbusLink,
        serial_number: str,
        timeout_s: float,
        watchdog_s: float = r.DEFAULT_WATCHDOG_S,
    ) -> None:
        self._link = link
        self._serial_number = serial_number
        self._timeout_s = timeout_s
        self._watchdog_ms = round(1000 * watchdog_s)
        self._lock = PriorityLock()
        self.controller: Controller | None = None
        self._sequence = 0
        self._beats = 0
        self._is_urgent = False  # what goes on now
        self._answers = True  # as far as the last read has shown
        self._back_off = BackOff()

    @property
    def name(self) -> str:
        return self._link.name

    @property
    def is_open(self) -> bool:
        return self._link.is_open

    def open(self) -> Controller:
        with self._lock.hold():
            if self.controller is None or not self._link.is_open:
                self.controller = None
                self.controller = self._open_link()
                log.info(
                    "%s: %s answers; this driver has met simulated CNCs only so far",
                    self.name,
                    self.controller.identity,
                )
            return self.controller

    def close(self) -> None:
        with self._lock.hold(urgent=True):
            self.controller = None
            self._link.close()

    def status(self) -> ControllerStatus:
        """Read the status, with the text of an alarm."""
        with self._lock.hold():
            status = self._read_status(_BUSY_S)
            if status.motion.state is not MotionState.ALARM:
                return status
            alarm = self._alarm(status.motion)
            return replace(status, motion=replace(status.motion, alarm=alarm))

    def send_heartbeat(self) -> None:
        with self._lock.hold():
            self._beats = (self._beats + 1) & 0xFFFF
            words = encode("heartbeat", self._beats)
            address = r.BY_NAME["heartbeat"].address
            self._with_retries(lambda: self._link.write(address, words), _BUSY_S)

    def limit_override(self, largest: float) -> bool:
        """Limit the override; true if it is not above the limit afterwards."""
        deadline_s = host_clock.now_s() + self._timeout_s
        with self._lock.hold():
            if not self._write_and_verify(
                "override_limit", round(largest * r.OVERRIDE_COUNTS)
            ):
                return False
            while (self._read_status().motion.override or 0.0) > largest + _SAME:
                if host_clock.now_s() >= deadline_s:
                    return False
                host_clock.sleep_s(_ACK_POLL_S)
            return True

    def command(
        self, verb: r.Command, arguments: Sequence[int] = (), *, urgent: bool = False
    ) -> ControllerStatus:
        """Execute a verb once; gives the status that acknowledges it."""
        limit_s = _URGENT_S if urgent else self._timeout_s
        deadline_s = host_clock.now_s() + limit_s
        with self._lock.hold(urgent=urgent):
            self._is_urgent = urgent
            try:
                request = [self._number(deadline_s), verb, *arguments]
                status = self._deliver(request, deadline_s)
                self._assess(verb, status)
            finally:
                self._is_urgent = False
            return status

    def _open_link(self) -> Controller:
        self._link.open()
        try:
            return self._identify()
        except DeviceError:
            self._link.close()
            raise

    def _reopen(self) -> None:
        """The same controller has to answer. Raises ConnectionLost, at once where the
        last attempt was a moment ago.
        """
        if self.controller is None or self._link.is_open:
            return
        now_s = host_clock.now_s()
        if not self._back_off.is_due(now_s):
            raise ConnectionLost(
                f"{self.name} is gone; check cable and power. It is tried again"
            )
        self._back_off.put_off(now_s)
        found = self._open_link()
        if found != self.controller:
            self._link.close()
            raise WrongDevice(
                f"{self.name}: {found.identity} answers after the link was gone, "
                f"{self.controller.identity} did before; check it, then connect again"
            )
        self._back_off.reset()
        log.warning("%s: the link is back, the same controller answers", self.name)

    def _identify(self) -> Controller:
        try:
            controller = parse_controller(self._read(r.IDENTITY))
        except (Refused, WrongDevice) as error:
            raise WrongDevice(f"{self.name}: {error}") from error
        answers = controller.identity.serial_number
        if self._serial_number not in ("", answers):
            raise WrongDevice(
                f"{self.name}: controller {answers} answers, "
                f"{self._serial_number} is configured; check the address"
            )
        has_watchdog = self._write_and_verify("watchdog", self._watchdog_ms)
        identity = replace(controller.identity, has_watchdog=has_watchdog)
        controller = replace(controller, identity=identity)
        # Over a new connection too, a number that was sent in vain is not used again.
        self._sequence = self._sequence or self._read_status().acknowledged
        return controller

    def _write_and_verify(self, register: str, value: int) -> bool:
        asked = encode(register, value)
        address = r.BY_NAME[register].address
        try:
            self._with_retries(lambda: self._link.write(address, asked))
            return self._read(r.Block(address, len(asked))) == asked
        except Refused as error:
            log.warning("%s has no %s: %s", self.name, register, error)
            return False

    def _number(self, deadline_s: float) -> int:
        """Another master may have used the number that would be ours: the device would
        take our command for a repeat and not run it. An urgent command is sent blindly
        rather than late or not at all.
        """
        acknowledged = 0
        if not self._is_urgent:
            acknowledged = self._retry(self._read_status, deadline_s).acknowledged
        elif self._answers and host_clock.now_s() + 2 * TIMEOUT_S < deadline_s:
            with suppress(ConnectionLost, DeviceTimeout):
                acknowledged = self._read_status().acknowledged
        self._sequence = _following(self._sequence)
        if self._sequence == acknowledged:
            self._sequence = _following(acknowledged)
        return self._sequence

    def _deliver(self, request: list[int], deadline_s: float) -> ControllerStatus:
        """After a write without reply the state is read first; then the same number is
        sent again, which runs nothing a second time. The same after a broken link.
        """
        delivered = self._try_write(request, deadline_s)
        while True:
            status = self._retry(self._read_status, deadline_s)
            if status.acknowledged == request[0]:
                return status
            if host_clock.now_s() >= deadline_s:
                raise MotionFault(
                    f"{self.name}: {r.Command(request[1]).name} was not taken in "
                    f"{self._timeout_s:g} s; the device's program stands, or "
                    "another master commands it"
                )
            if not delivered:
                delivered = self._try_write(request, deadline_s)
            host_clock.sleep_s(_ACK_POLL_S)

    def _try_write(self, request: list[int], deadline_s: float) -> bool:
        """False if its outcome is unknown and there is time to find out."""
        try:
            self._reopen()
            self._link.write(r.COMMAND.address, request)
        except (ConnectionLost, DeviceTimeout) as error:
            if host_clock.now_s() + TIMEOUT_S > deadline_s:
                raise
            log.warning("reading back the state: %s", error)
            return False
        return True

    def _retry(self, request: Callable[[], T], deadline_s: float) -> T:
        """Only for requests that are harmless when repeated; reopens a broken link."""
        while True:
            try:
                return request()
            except (ConnectionLost, DeviceTimeout):
                if host_clock.now_s() + TIMEOUT_S > deadline_s:
                    raise
                host_clock.sleep_s(_BUSY_POLL_S)

    def _assess(self, verb: r.Command, status: ControllerStatus) -> None:
        place = f"{self.name} refuses {verb.name}"
        match status.result:
            case r.Result.DONE:
                return
            case r.Result.OUT_OF_TRAVEL:
                raise OutOfTravel(f"{place}: beyond the travel of an axis")
            case r.Result.IN_ALARM:
                raise MotionFault(f"{place}: {self._alarm(status.motion)}")
            case r.Result.NOT_READY if verb is not r.Command.RESET and (
                why := UNABLE.get(status.motion.state)
            ):
                raise MotionFault(f"{place}: {why}")
            case code:
                reason = _REASONS.get(code, f"result {code}")
                raise Refused(f"{place} in state {status.motion.state}: {reason}", code)

    def _read_status(self, patience_s: float | None = None) -> ControllerStatus:
        controller = self.controller
        block = controller.status_block if controller else r.STATUS
        features = controller.features if controller else 0
        status = parse_status(self._read(block, patience_s), features=features)
        axes = len(controller.axes) if controller else r.MAX_AXES
        position = status.motion.position[:axes]
        return replace(status, motion=replace(status.motion, position=position))

    def _alarm(self, motion: MotionStatus) -> str:
        words = self._read(r.ALARM_TEXT)
        return decode_text("alarm_text", words, r.ALARM_TEXT) or motion.alarm

    def _read(self, block: r.Block, patience_s: float | None = None) -> list[int]:
        self._answers = False
        words = self._with_retries(
            lambda: self._link.read(block.address, block.count), patience_s
        )
        self._answers = True
        return words

    def _with_retries(
        self, request: Callable[[], T], limit_s: float | None = None
    ) -> T:
        """One repeat, more while the device reports that it is busy. None where a hold
        is waiting, or a gateway reports that it cannot reach the device.

        The library waits anew after each reply that is not ours: on a slow link a
        repeated request gets a valid reply whose age exceeds what a status may have.
        """
        patience_s = self._timeout_s if limit_s is None else limit_s
        deadline_s = host_clock.now_s() + patience_s
        has_failed = False
        while True:
            try:
                self._reopen()
                asked_s = host_clock.now_s()
                reply = request()
                if has_failed and host_clock.now_s() - asked_s > TIMEOUT_S:
                    raise DeviceTimeout(
                        f"{self.name}: replies come later than {TIMEOUT_S:g} s"
                    )
                return reply
            except DeviceBusy:
                if host_clock.now_s() >= deadline_s:
                    raise
                host_clock.sleep_s(_BUSY_POLL_S)
            except (ConnectionLost, DeviceTimeout) as error:
                is_behind = isinstance(error, ConnectionLost) and self._link.is_open
                is_late = self._is_urgent or self._lock.is_wanted
                if has_failed or is_behind or is_late:
                    raise
                has_failed = True


def _following(number: int) -> int:
    return number % 0xFFFF + 1
