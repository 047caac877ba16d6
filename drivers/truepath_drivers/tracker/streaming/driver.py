"""Driver of trackers that stream GST/1 frames over serial or TCP."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    NotOffered,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Identity, LinkHealth, TrackerSamples
from truepath_drivers.interfaces.tracker import (
    ByteLink,
    EventSource,
    TargetChoice,
    TargetFinder,
    Tracker,
)
from truepath_drivers.interfaces.tracker_records import (
    Air,
    TrackerCapabilities,
    TrackerEvent,
    TrackerEventKind,
)
from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import (
    SampleDecoder,
    StatusBit,
    link_health,
)
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_drivers.tracker.streaming.link import CommandLink, Receiver
from truepath_drivers.transport.make_port import make_port

log = logging.getLogger(__name__)

_GATHER_S = 0.02
_STALE_S = 2.0  # of samples that are no newer than those before
_RATE_TOLERANCE = 0.01
# On the wire, a start and a stop bit a byte.
_FRAME_BITS = {gst.Format.MEAS64: 470, gst.Format.MEAS: 300}


class StreamingTracker(Tracker, ByteLink, EventSource, TargetFinder, TargetChoice):
    """A tracker on a serial port (`port`) or behind TCP (`host` and `port`).

    port : path of the tty, or TCP port number where `host` is given
    baudrate : of a serial port
    serial_number : refuse any other instrument
    compact : request the short frames, 10 nm and 2.9 nrad, on a slow line
    reply_timeout_s : longest wait for the reply to a command, sent twice in that time
    turn_s : additional time to turn, to search and to change its target

    Verbs other than those of the stream need version 2 of the protocol. It is requested
    with the first of them; a device of version 1 stays as it is, and refuses. `read`
    and `take_link_bytes` are for one thread, the other verbs for any.
    """

    def __init__(
        self,
        port: str | int,
        *,
        host: str | None = None,
        baudrate: int = 921_600,
        serial_number: str = "",
        compact: bool = False,
        reply_timeout_s: float = 0.5,
        turn_s: float = 20.0,
    ) -> None:
        self._port = make_port(port, host, baudrate)
        self._baudrate = baudrate if host is None else None
        self._serial_number = serial_number
        self._format = gst.Format.MEAS if compact else gst.Format.MEAS64
        self._turn_s, self._reply_timeout_s = turn_s, reply_timeout_s
        self._knows_verbs = False
        self._lock = threading.RLock()
        self._link = CommandLink(self._port, reply_timeout_s)
        self._receiver: Receiver | None = None
        self._identity: Identity | None = None
        self._max_rate_hz = 0.0
        self._rate_hz: float | None = None
        self._frames = FrameReader()
        self._decoder = SampleDecoder()
        self._event_log = EventLog()

    @property
    def capabilities(self) -> TrackerCapabilities:
        """Streams at up to the rate that it reports, by its own clock."""
        return TrackerCapabilities(max_rate_hz=self._max_rate_hz)

    def connect(self) -> Identity:
        """Open the port, identify the device, end a stream that was left running."""
        with self._lock:
            alive = self._receiver is not None and self._receiver.error is None
            if self._identity is None or not alive:
                self._shut()
                self._identity = self._open()
            return self._identity

    def start(self, rate_hz: float) -> None:
        """Begin to stream; a stream at another rate is stopped first."""
        with self._lock:
            receiver = self._require_receiver()
            self._check_rate(rate_hz)
            if self._rate_hz not in (None, rate_hz):
                self.stop()
            ack = self._link.request(
                receiver, lambda t: gst.Start(t, rate_hz, self._format)
            )
            self._rate_hz = rate_hz
            self._check_started(ack, rate_hz)

    def read(self, timeout_s: float) -> TrackerSamples:
        """Samples since the last call, some 20 ms of them or more."""
        receiver = self._require_receiver()
        deadline_s = host_clock.now_s() + timeout_s
        while True:
            left_s = max(0.0, deadline_s - host_clock.now_s())
            bodies = receiver.take(left_s, min(_GATHER_S, left_s))
            decoded = self._decoder.decode(bodies)
            self._event_log.note_status(decoded.status)
            for message in decoded.messages:
                self._note(message)
            self._require_clock()
            if len(decoded.samples) or left_s == 0.0:
                return decoded.samples

    def _require_clock(self) -> None:
        """Raise ConnectionLost where samples come, and none is newer than the last."""
        if self._decoder.stale > _STALE_S * (self._rate_hz or math.inf):
            raise ConnectionLost(
                f"{self._port.name} sends samples, but none newer than before: its "
                "clock has fallen back, or it has been switched off and on; connect "
                "again"
            )

    def stop(self) -> None:
        """End the stream. On a lost port the device ends it without keep-alive."""
        with self._lock:
            receiver = self._receiver
            if receiver is None or receiver.error is not None:
                return
            self._rate_hz = None
            try:
                self._link.request(receiver, gst.Stop)
            except ConnectionLost as error:
                log.warning("stop not sent: %s", error)

    def close(self) -> None:
        with self._lock:
            try:
                self.stop()
            except DeviceError as error:
                log.warning("%s closed while it streams: %s", self._port.name, error)
            finally:
                self._shut()

    def take_link_bytes(self) -> bytes:
        """Bytes as received, at most the last 4 MiB."""
        return b"" if self._receiver is None else self._receiver.take_link_bytes()

    def take_events(self) -> tuple[TrackerEvent, ...]:
        """Events that `read` has found since the last call."""
        return self._event_log.take()

    @property
    def verb_limit_s(self) -> float:
        """Time of the verb and of the version request before it."""
        return self._turn_s + 2.0 * self._reply_timeout_s

    def home(self) -> None:
        """Send the beam to the instrument's reference, to initialise there."""
        self._do(gst.Home)

    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        self._do(lambda t: gst.Aim(t, azimuth_rad, elevation_rad))

    def search(self) -> None:
        self._do(gst.Search)

    def select_target(self, name: str) -> None:
        """Lock the target of that name, and measure it from now on."""
        self._do(lambda t: gst.Select(t, name))

    def push_air(self, air: Air) -> None:
        told = air.temperature_degc, air.pressure_hpa, air.humidity_percent
        used = self._read_detail(self._do(lambda t: gst.SetAir(t, *told)))
        back = used.temperature_degc, used.pressure_hpa, used.humidity_percent
        if not np.allclose(back, told, rtol=0.0, atol=0.1, equal_nan=True):
            raise Refused(f"{self._port.name} uses the air {back}, {told} was set")

    def read_air(self) -> Air:
        return self._read_detail(self._do(gst.GetAir))

    @property
    def health(self) -> LinkHealth:
        return link_health(self._frames, self._decoder)

    def _open(self) -> Identity:
        self._port.open()
        receiver = Receiver(self._port, self._link.ping)
        self._receiver = receiver
        self._frames, self._decoder = receiver.frames, SampleDecoder()
        self._event_log = EventLog()
        receiver.start()
        try:
            info = greet(self._link, receiver, self._port.name, self._serial_number)
            self._max_rate_hz = info.max_rate_hz
            self._link.request(receiver, gst.Stop)
        except DeviceError:
            self._shut()
            raise
        identity = Identity(info.maker, info.model, info.serial_number, info.firmware)
        receiver.take(0.0, 0.0)
        receiver.take_link_bytes()
        log.info(
            "%s: %s answers; this driver has met simulated trackers only so far",
            self._port.name,
            identity,
        )
        return identity

    def _shut(self) -> None:
        receiver, self._receiver = self._receiver, None
        self._identity = self._rate_hz = None
        self._knows_verbs = False
        if receiver is not None:
            receiver.close()
        self._port.close()

    def _do(self, build: Callable[[int], gst.Verb]) -> gst.Ack:
        with self._lock:
            receiver = self._require_receiver()
            try:
                if not self._knows_verbs:
                    self._query_verbs(receiver)
                return self._link.request(receiver, build, self._turn_s)
            except Refused as error:
                if error.code == gst.NakCode.NO_TARGET:
                    raise BeamLost(f"{error}; bring it near the beam") from error
                raise

    def _query_verbs(self, receiver: Receiver) -> None:
        try:
            info = self._link.request(
                receiver, lambda t: gst.Hello(t, gst.VERBS_VERSION)
            ).detail
        except Refused as error:
            raise NotOffered(str(error), error.code) from error
        if not isinstance(info, gst.DeviceInfo) or info.version < gst.VERBS_VERSION:
            raise NotOffered(
                f"{self._port.name} speaks GST/{gst.VERSION}, which has no such verb",
                gst.NakCode.VERSION_NOT_SPOKEN,
            )
        self._knows_verbs = True

    def _read_detail(self, ack: gst.Ack) -> Air:
        used = ack.detail
        if not isinstance(used, gst.AirInUse):
            raise DeviceError(f"{self._port.name} tells no air")
        return Air(used.temperature_degc, used.pressure_hpa, used.humidity_percent)

    def _require_receiver(self) -> Receiver:
        if self._receiver is None:
            raise ConnectionLost(f"{self._port.name} is not connected; connect first")
        return self._receiver

    def _check_rate(self, rate_hz: float) -> None:
        if not 0.0 < rate_hz <= self._max_rate_hz:
            raise Refused(
                f"{self._port.name} streams at up to {self._max_rate_hz:g} Hz, "
                f"not at {rate_hz:g} Hz"
            )
        bits = rate_hz * _FRAME_BITS[self._format]
        if self._baudrate is not None and bits > self._baudrate:
            # A pseudo-terminal has no baud rate, so this is no refusal.
            log.warning(
                "%s: %g Hz need %.0f bit/s, the line has %d; samples may be lost",
                self._port.name,
                rate_hz,
                bits,
                self._baudrate,
            )

    def _check_started(self, ack: gst.Ack, rate_hz: float) -> None:
        info = ack.detail
        actual_hz = info.rate_hz if isinstance(info, gst.StreamInfo) else 0.0
        if abs(actual_hz - rate_hz) > _RATE_TOLERANCE * rate_hz:
            self.stop()
            raise Refused(
                f"{self._port.name} streams at {actual_hz:g} Hz, not at {rate_hz:g} Hz"
            )
        log.info("%s streams at %g Hz", self._port.name, actual_hz)

    def _note(self, message: gst.Message) -> None:
        if not isinstance(message, gst.Event):
            return
        self._event_log.note(message)
        log.info(
            "%s: event %s at %d µs", self._port.name, message.code, message.clock_us
        )
        if message.code == gst.EventCode.STREAM_STOPPED_NO_PING:
            self._rate_hz = None


def greet(
    link: CommandLink, receiver: Receiver, port_name: str, serial_number: str
) -> gst.DeviceInfo:
    """Identity reported by the device.

    serial_number : required; any if empty

    Raises WrongDevice if it is another one or none of this kind, DeviceTimeout or
    ConnectionLost if nothing answers.
    """
    try:
        info = link.request(receiver, gst.Hello).detail
    except DeviceTimeout as error:
        raise _explain_silence(receiver, port_name, error) from None
    except Refused as error:
        raise WrongDevice(f"{error}; the device speaks another version") from error
    if not isinstance(info, gst.DeviceInfo) or info.version != gst.VERSION:
        raise WrongDevice(
            f"{port_name}: the device does not speak GST/{gst.VERSION} ({info}); "
            "update the device or the driver"
        )
    if serial_number not in ("", info.serial_number):
        raise WrongDevice(
            f"{port_name}: instrument {info.serial_number} answers, "
            f"{serial_number} is configured; check which cable is where"
        )
    return info


def _explain_silence(
    receiver: Receiver, port_name: str, error: DeviceTimeout
) -> DeviceError:
    if receiver.echoes:
        return WrongDevice(
            f"{port_name}: our own bytes come back; a loop-back plug, "
            "or a terminal that echoes"
        )
    if receiver.bytes_received and not receiver.frames.frames:
        return WrongDevice(
            f"{port_name}: something answers, but not in GST/1 frames; "
            "check that this is the tracker's port, and its baud rate"
        )
    return error


_MOST = 1000  # kept without a reader
_MESSAGES: dict[int, tuple[TrackerEventKind, str]] = {
    gst.EventCode.BEAM_BROKEN: (TrackerEventKind.BEAM_LOST, "the beam was broken"),
    gst.EventCode.BEAM_LOCKED: (
        TrackerEventKind.BEAM_LOCKED,
        "the beam is locked again",
    ),
}
_WARNINGS = {
    StatusBit.NOT_LEVELLED: (
        "the tracker is not level",
        "level it and let it compensate, or measure on if its tilt stays",
    ),
    StatusBit.ENVIRONMENT_STALE: (
        "the tracker's weather station has not been read for a while",
        "check its sensor: distances are corrected with old air",
    ),
}


class EventLog:
    """Events in order; each warning once per connection."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._events: list[TrackerEvent] = []
        self._warned = 0

    def note(self, event: gst.Event) -> None:
        """Store an event of the device, with its device time."""
        if (told := _MESSAGES.get(event.code)) is not None:
            kind, text = told
            self._add(TrackerEvent(kind, f"{text} at {1e-6 * event.clock_us:.6f} s"))

    def note_status(self, status: int) -> None:
        """Store a warning for each new status bit."""
        for bit, (text, action) in _WARNINGS.items():
            if status & bit & ~self._warned:
                self._warned |= bit
                self._add(TrackerEvent(TrackerEventKind.WARNING, text, action))

    def take(self) -> tuple[TrackerEvent, ...]:
        with self._lock:
            events, self._events = tuple(self._events), []
        return events

    def _add(self, event: TrackerEvent) -> None:
        with self._lock:
            self._events = [*self._events, event][-_MOST:]
