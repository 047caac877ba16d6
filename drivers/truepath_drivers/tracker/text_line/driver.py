"""Driver of trackers whose software sends one line of text per sample."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout, Refused
from truepath_drivers.interfaces.records import Identity, LinkHealth, TrackerSamples
from truepath_drivers.interfaces.tracker import ByteLink, Tracker
from truepath_drivers.interfaces.tracker_records import Clock, TrackerCapabilities
from truepath_drivers.streams.numbering import SampleNumbers
from truepath_drivers.streams.received_bytes import ReceivedBytes
from truepath_drivers.streams.reordering import Reordering
from truepath_drivers.tracker.text_line.layout import LineBlock, LineLayout, choose
from truepath_drivers.transport.byte_port import BytePort
from truepath_drivers.transport.serial_port import SerialPort
from truepath_drivers.transport.tcp_port import TcpPort
from truepath_drivers.transport.udp_port import UdpPort

_LONGEST_BYTES = 1 << 12  # of a line
_KEPT_BYTES = 1 << 20
_FIRST_LINE_S = 2.0
_STEP_S = 0.05
_RATE_TOLERANCE = 0.01
_MOST_APART_S = 0.2  # counter and time of one line
_LONGEST_GAP_S = 2.0  # of lost lines, but for a pause of the stream
_LONGEST_HELD_S = 0.25  # 0.5 s without a sample would be a silence
_REMEMBERED = 100  # lines, among which a doubled one is recognised


class TextLineTracker(Tracker, ByteLink):
    """A stream of lines from a serial port, a TCP server (`host`) or by UDP (`udp`).

    port : path of the tty, or the number of a TCP or UDP port
    columns : fields of a line in order, of x, y, z, time, counter, status and `-`
    rate_hz : as set at the sender; it cannot be queried
    counter_wraps : the counter starts again at 0 after so many; 0 if it never does
    arrival_times : stamp lines as they arrive, where they carry neither time nor
        counter; such samples are for points at standstill, and losses are not
        detectable
    duplicates : a line with the number and time of one before is dropped and counted as
        `doubled` (`drop`), or ConnectionLost (`error`)
    reorder_s : longest time that a line by UDP is held while one before it is missing;
        one that comes later is dropped and counted as `late`
    start_command, stop_command : lines to send, empty if it streams without
    name, serial_number : of the instrument, for the Run

    Other options are those of `LineLayout`. A damaged digit makes another number: text
    has no checksum, so use a link that has one.
    """

    def __init__(
        self,
        port: str | int,
        *,
        rate_hz: float,
        host: str | None = None,
        udp: bool = False,
        baudrate: int = 115_200,
        columns: str = "counter,time,x,y,z,status",
        delimiter: str = "comma",
        decimal_comma: bool = False,
        unit: str = "mm",
        time_unit: str = "s",
        axes: str = "x,y,z",
        valid: str = "0",
        counter_wraps: int = 0,
        invalid_place: str = "",
        arrival_times: bool = False,
        duplicates: str = "drop",
        reorder_s: float = 0.0,
        start_command: str = "",
        stop_command: str = "",
        name: str = "text stream",
        serial_number: str = "not known",
    ) -> None:
        self._layout = LineLayout(
            columns,
            delimiter=delimiter,
            decimal_comma=decimal_comma,
            unit=unit,
            time_unit=time_unit,
            axes=axes,
            valid=valid,
            invalid_place=invalid_place,
        )
        self._stamped = self._layout.has_time or self._layout.has_counter
        _check_stamps(self._stamped, arrival_times)
        _check_order(self._stamped, duplicates, reorder_s)
        if reorder_s:
            _check_reordering(reorder_s, rate_hz, counter_wraps, udp=udp)
        if udp and (start_command or stop_command):
            raise Refused("a UDP port listens only; leave the commands out")
        self._port = _byte_port(port, host, baudrate, udp=udp)
        self._rate_hz, self._wraps = rate_hz, counter_wraps
        self._refuses_doubles, self._reorder_s = duplicates == "error", reorder_s
        self._late = round(reorder_s * rate_hz)  # lines that one may come late by
        self._identity = Identity("text lines", name, serial_number, "")
        self._commands = (start_command, stop_command)
        self._lock = threading.RLock()
        self._is_open = self._streams = False
        self._health = LinkHealth()
        self._kept = ReceivedBytes(_KEPT_BYTES)
        self._begin()

    @property
    def capabilities(self) -> TrackerCapabilities:
        """The configured rate, and the clock that stamps its samples."""
        clock = Clock.DEVICE if self._stamped else Clock.HOST
        return TrackerCapabilities(max_rate_hz=self._rate_hz, clock=clock)

    def connect(self) -> Identity:
        """Open the port. The sender is not identified; settings name it."""
        with self._lock:
            if not self._is_open:
                self._port.open()
                self._is_open, self._health = True, LinkHealth()
                self._kept.take()
                self._begin()
            return self._identity

    def start(self, rate_hz: float) -> None:
        """Begin to read lines; a first one must come within 2 s."""
        with self._lock:
            self._require_open()
            if abs(rate_hz / self._rate_hz - 1.0) > _RATE_TOLERANCE:
                raise Refused(
                    f"{self._port.name} sends {self._rate_hz:g} Hz, not {rate_hz:g}; "
                    "set the sender and rate_hz to the same rate"
                )
            if self._streams:
                return
            self._discard_stale()
            self._send(self._commands[0])
            self._await_line()
            self._streams = True

    def read(self, timeout_s: float) -> TrackerSamples:
        deadline_s = host_clock.now_s() + timeout_s
        with self._lock:
            self._require_open()
            if not self._streams:
                return TrackerSamples.empty()
            while self._streams:
                self._receive(max(0.0, min(_STEP_S, deadline_s - host_clock.now_s())))
                samples = self._decode()
                if len(samples) or host_clock.now_s() >= deadline_s:
                    return samples
            return TrackerSamples.empty()

    def stop(self) -> None:
        """End the stream, or ignore one that has no stop command.

        It takes no lock: a thread that reads holds it nearly all the time.
        """
        streamed, self._streams = self._streams, False
        if streamed and self._is_open:
            self._send(self._commands[1])

    def close(self) -> None:
        with self._lock:
            try:
                self.stop()
            except (ConnectionLost, DeviceTimeout):
                pass  # the link has gone already
            finally:
                self._is_open = self._streams = False
                self._port.close()

    @property
    def health(self) -> LinkHealth:
        """Counts of lines; unreadable and impossible ones count as checksum errors."""
        return self._health

    def take_link_bytes(self) -> bytes:
        return self._kept.take()

    def _begin(self) -> None:
        self._rest, self._in_step = b"", False
        self._jumps, self._refused, self._pace = True, 0, Pace()
        self._order = Reordering[Line](self._late, self._reorder_s)
        self._numbers = SampleNumbers(self._rate_hz, self._wraps, self._late)
        self._last_time_s = -np.inf
        self._accepted: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)

    def _discard_stale(self) -> None:
        """A sender without commands streams before `start` too."""
        self._rest, self._in_step, self._jumps = b"", False, True
        self._pace = Pace()
        self._order = Reordering[Line](self._late, self._reorder_s)
        while self._port.read(0.0):
            pass

    def _require_open(self) -> None:
        if not self._is_open:
            raise ConnectionLost(f"{self._port.name} is not connected; connect first")

    def _send(self, command: str) -> None:
        if command:
            self._port.write(command.encode() + b"\r\n")

    def _await_line(self) -> None:
        """The first line may be unreadable: it may have begun before the start."""
        deadline_s = host_clock.now_s() + _FIRST_LINE_S
        while True:
            whole = self._rest.split(b"\n")[:-1]
            problems = [self._layout.explain(line) for line in whole]
            if "" in problems:
                return
            if host_clock.now_s() > deadline_s:
                break
            self._receive(_STEP_S)
        if not problems:
            raise DeviceTimeout(
                f"{self._port.name} sends no line within {_FIRST_LINE_S:g} s; "
                "start the stream at the tracker's software"
            )
        raise Refused(
            f"{self._port.name}: none of {len(whole)} lines can be read; the last, "
            f"{whole[-1][:60]!r}, {problems[-1]}: correct columns, delimiter or "
            "decimal_comma, or the format of the sender"
        )

    def _receive(self, timeout_s: float) -> None:
        try:
            data = self._port.read(timeout_s)
        except ConnectionLost:
            self._is_open = False
            raise
        self._kept.add(data)
        self._rest += data

    def _decode(self) -> TrackerSamples:
        *lines, self._rest = self._rest.split(b"\n")
        if len(self._rest) > _LONGEST_BYTES:
            self._count(skipped_bytes=len(self._rest))
            self._rest, self._in_step = b"", False
        if lines and not self._in_step:  # the first may have begun before we listened
            lines, self._in_step = lines[1:], True
        lines = [line for line in lines if line.strip()]
        block, bad = self._layout.parse(lines)
        self._count(frames=len(lines), crc_errors=bad)
        return self._stamp(block)

    def _count(self, **more: int) -> None:
        old = self._health
        sums = {key: getattr(old, key) + value for key, value in more.items()}
        self._health = replace(old, **sums)

    def _stamp(self, block: LineBlock) -> TrackerSamples:
        times_s = block.time_s if self._stamped else self._spread(len(block))
        taken: list[Line] = []
        for row, time_s in enumerate(times_s.tolist()):
            step = self._count_step(float(block.counter[row]), time_s)
            if not self._layout.has_time and self._stamped:
                time_s = step / self._rate_hz
            line = Line(step, time_s, block.position_mm[row], int(block.status[row]))
            self._order.add(step, time_s, line)
            taken += self._pop_due(more_waits=True)
        taken += self._pop_due()
        if not taken:
            return TrackerSamples.empty()
        self._check_pace(taken[-1].step, taken[-1].time_s)
        return TrackerSamples(
            np.array([line.step for line in taken], np.int64),
            np.array([line.time_s for line in taken], np.float64),
            np.array([line.position_mm for line in taken], np.float64),
            np.array([line.status for line in taken], np.int64),
        )

    def _pop_due(self, *, more_waits: bool = False) -> list[Line]:
        taken: list[Line] = []
        while line := self._order.pop(self._numbers.last, more_waits=more_waits):
            if self._accept(line.step, line.time_s):
                taken.append(line)
        return taken

    def _check_pace(self, step: int, time_s: float) -> None:
        """Raises ConnectionLost for a rate or a unit of time unlike the options."""
        found = self._pace.update(time_s if self._stamped else step / self._rate_hz)
        if found is not None:
            raise ConnectionLost(
                f"{self._port.name}: its clock runs {found:.3g} times as fast as the "
                f"one of this computer: correct rate_hz (now {self._rate_hz:g}), "
                "time_unit or columns; or several instruments send here"
            )

    def _count_step(self, counter: float, time_s: float) -> int:
        if self._layout.has_counter:
            return self._numbers.from_counter(int(counter))
        if self._layout.has_time:
            return self._numbers.from_time(time_s)
        return self._numbers.last + 1

    def _accept(self, step: int, time_s: float) -> bool:
        """A damaged digit of a counter or time must not end the stream: a line far
        ahead is rejected as well, except at the start of a stream.
        """
        last = self._numbers.last
        missing = 0 if last < 0 else step - last - 1
        gap_s = time_s - self._last_time_s
        steps_s = (missing + 1) / self._rate_hz
        near = max(steps_s, gap_s) < _LONGEST_GAP_S
        agrees = abs(gap_s - steps_s) < _MOST_APART_S or not self._stamped
        goes_on = self._jumps or (near and agrees)
        if missing < 0 or gap_s <= 0.0 or not goes_on:
            self._count_refused(step, time_s)
            if self._refused > _LONGEST_GAP_S * self._rate_hz:
                raise ConnectionLost(
                    f"{self._port.name}: counter or time has begun anew or jumped; "
                    "connect again; if the counter wraps, say counter_wraps"
                )
            return False
        self._numbers.accept(step)
        self._last_time_s = time_s
        self._accepted.append((step, time_s))
        self._jumps, self._refused = False, 0
        return True

    def _count_refused(self, step: int, time_s: float) -> None:
        late = self._numbers.last - step
        if self._wraps:  # one of the turn before seems to be one ahead
            late %= self._wraps
        back_s = self._last_time_s - time_s
        agrees = back_s > 0.0 and abs(back_s - late / self._rate_hz) < _MOST_APART_S
        agrees |= not self._layout.has_time
        if (step, time_s) in self._accepted:
            if self._refuses_doubles:
                raise ConnectionLost(
                    f"{self._port.name}: line {step} at {time_s:g} s came twice: look "
                    "for a second sender or path, or say duplicates = drop"
                )
            self._count(doubled=1)
        elif agrees and 0 < late < _LONGEST_GAP_S * self._rate_hz:
            self._count(late=1)
        else:
            self._count(crc_errors=1)
        self._refused += 1

    def _spread(self, count: int) -> NDArray[np.float64]:
        """Times of lines that came at once, at the nominal rate up to now."""
        now_s, period_s = host_clock.now_s(), 1.0 / self._rate_hz
        first_s = now_s - (count - 1) * period_s
        if first_s <= self._last_time_s:
            period_s = (now_s - self._last_time_s) / count
            first_s = self._last_time_s + period_s
        return np.asarray(first_s + period_s * np.arange(count), np.float64)


def _check_stamps(stamped: bool, arrival_times: bool) -> None:
    if not stamped and not arrival_times:
        raise Refused(
            "lines carry neither a time nor a counter of the tracker; add one, or "
            "say arrival_times = true: then only points at standstill can be measured, "
            "and lost lines cannot be seen"
        )
    if stamped and arrival_times:
        raise Refused("lines carry a time or counter; leave arrival_times out")


def _check_order(stamped: bool, duplicates: str, reorder_s: float) -> None:
    choose("duplicates", duplicates, ("drop", "error"))
    if not stamped and (duplicates == "error" or reorder_s):
        raise Refused(
            "lines with neither time nor counter tell nothing of their order; leave "
            "duplicates and reorder_s out"
        )


def _check_reordering(
    reorder_s: float, rate_hz: float, counter_wraps: int, *, udp: bool
) -> None:
    if not udp:
        raise Refused("serial and TCP links keep the order; reorder_s is for udp")
    steps = reorder_s * rate_hz
    fits = not counter_wraps or 4.0 * steps <= counter_wraps
    if not (steps >= 1.0 and reorder_s <= _LONGEST_HELD_S and fits):
        raise Refused(
            f"reorder_s is {reorder_s:g}: give 0, or from one period of rate_hz to "
            f"{_LONGEST_HELD_S:g} s, at most a quarter of counter_wraps"
        )


def _byte_port(
    port: str | int, host: str | None, baudrate: int, *, udp: bool
) -> BytePort:
    is_number = str(port).isdecimal()
    if (udp or host is not None) and not is_number:
        raise Refused(f"port {port!r} is no number of a TCP or UDP port, as in 10000")
    if udp:
        return UdpPort(host or "", int(port))
    if host is not None:
        return TcpPort(host, int(port))
    if is_number:
        raise Refused(
            f"port {port} is the number of a TCP or UDP port: say host or udp = true "
            "as well; a serial port is a path, as /dev/ttyUSB0"
        )
    return SerialPort(str(port), baudrate)


class Line(NamedTuple):
    """One line, with its number and its time."""

    step: int
    time_s: float
    position_mm: NDArray[np.float64]
    status: int


_WINDOW_S = 5.0
_MOST = 0.1  # of a window; a wrong rate or unit deviates by more


class Pace:
    """Rate of a device clock from the earliest arrivals in a window.

    Late lines are only delayed, so the earliest are accurate.
    """

    def __init__(self) -> None:
        self._begin_s = host_clock.now_s()
        self._ahead_s, self._ahead_before_s = -np.inf, np.nan
        self._drifts_s: list[float] = []

    def update(self, device_s: float) -> float | None:
        """Add the newest stamp; the clock's rate where it deviates twice in a row."""
        now_s = host_clock.now_s()
        self._ahead_s = max(self._ahead_s, device_s - now_s)
        passed_s = now_s - self._begin_s
        if passed_s < _WINDOW_S:
            return None
        self._drifts_s.append((self._ahead_s - self._ahead_before_s) / passed_s)
        self._begin_s, self._ahead_before_s = now_s, self._ahead_s
        self._ahead_s = -np.inf
        newest = np.array(self._drifts_s[-2:])
        if len(newest) < 2 or not (np.all(newest > _MOST) or np.all(newest < -_MOST)):
            return None
        return float(1.0 + newest.mean())
