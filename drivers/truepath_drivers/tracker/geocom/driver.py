"""Driver of Leica instruments that speak GeoCOM."""

from __future__ import annotations

import logging
import math
import random
import threading
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.tracker import AirExchange, TargetFinder
from truepath_drivers.interfaces.tracker_records import (
    Air,
    Clock,
    TrackerCapabilities,
    TrackerEventKind,
)
from truepath_drivers.tracker.geocom.codec import (
    NO_TARGET,
    NOT_OFFERED,
    TRANSACTIONS,
    WITH_A_WARNING,
    Procedure,
    Reply,
    ReturnCode,
    describe_code,
    encode_request,
    is_point,
    parse_reply,
    to_cartesian_mm,
)
from truepath_drivers.tracker.line_instrument import LineInstrument
from truepath_drivers.transport.line_link import LineLink
from truepath_drivers.transport.make_port import make_port

log = logging.getLogger(__name__)

P = Procedure
_DISTANCE, _CLEAR = 1, 3  # programs of TMC_DoMeasure
_AUTO = 1  # treatment of the inclination


class GeoComTracker(LineInstrument, TargetFinder, AirExchange):
    """A Leica instrument on a serial port (`port`) or TCP (`host` and `port`).

    serial_number : refuse any other instrument
    prism_constant_mm : set in the instrument and read back; None leaves it unchanged
    follows : lock on the prism and follow it from point to point
    search_rad : width and height of the window in which a lost prism is searched
    reply_timeout_s : longest wait for a reply; measuring and turning have longer ones
    shot_s : the instrument's longest time for one distance
    turn_s : its longest time to turn or to search
    """

    def __init__(
        self,
        port: str | int,
        *,
        host: str | None = None,
        baudrate: int = 115_200,
        serial_number: str = "",
        prism_constant_mm: float | None = None,
        follows: bool = True,
        search_rad: float = 0.05,
        reply_timeout_s: float = 2.0,
        shot_s: float = 5.0,
        turn_s: float = 20.0,
    ) -> None:
        super().__init__(LineLink(make_port(port, host, baudrate)))
        self._serial_number = serial_number
        self._prism_constant_mm = prism_constant_mm
        self._follows, self._search_rad = follows, search_rad
        self._session = GeoComSession(self._link, reply_timeout_s)
        self._shot_s, self._turn_s = shot_s, turn_s
        self._reply_timeout_s = reply_timeout_s

    @property
    def capabilities(self) -> TrackerCapabilities:
        """Polled; distances by EDM, with the atmosphere that the instrument holds."""
        return TrackerCapabilities(
            streams=False, clock=Clock.HOST, distance="EDM", corrects_air=True
        )

    @property
    def verb_limit_s(self) -> float:
        """Of a search, including the lock on its result."""
        return 2.0 * (self._turn_s + self._reply_timeout_s)

    def home(self) -> None:
        """Turn to Hz 0 at the horizon; the instrument levels itself."""
        self._turn_to(0.0, 0.5 * math.pi)

    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        """Azimuth from x towards y."""
        hz = (0.5 * math.pi - azimuth_rad) % (2.0 * math.pi)
        self._turn_to(hz, 0.5 * math.pi - elevation_rad)

    def search(self) -> None:
        """Search the prism around the beam, and lock on it if it is to be followed."""
        with self._lock:
            window = (self._search_rad, self._search_rad, 0)
            expect_ok(self._session.request(P.AUT_SEARCH, window, self._turn_s))
            if self._follows:
                expect_ok(self._session.request(P.AUT_LOCK_IN, (), self._turn_s))

    def push_air(self, air: Air) -> None:
        """Set pressure, dry and wet temperature; read back the values in use."""
        with self._lock:
            wavelength = self._read_atmosphere()[0]
            wet = find_wet_bulb(air.temperature_degc, air.humidity_percent)
            told = (wavelength, air.pressure_hpa, air.temperature_degc, wet)
            if not np.isfinite(told).all():
                raise Refused("the air needs temperature, pressure and humidity")
            expect_ok(self._session.request(P.TMC_SET_ATMOSPHERE, told))
            used = self._read_atmosphere()
            if not np.allclose(used, told, atol=0.1):
                raise Refused(f"{self._link.name} uses {used}, {told} was set")

    def read_air(self) -> Air:
        """The air that the instrument corrects its distances for."""
        _, pressure, dry, wet = self._read_atmosphere()
        return Air(dry, pressure, find_humidity(dry, wet))

    def greet(self) -> Identity:
        """Request name, serial number and firmware."""
        try:
            name = self._session.request(P.CSV_GET_INSTRUMENT_NAME)
        except DeviceTimeout as error:
            if not self._link.has_received:
                raise
            raise WrongDevice(
                f"{self._link.name}: something answers, but not in GeoCOM; check the "
                "port, its baud rate, and that GeoCOM is on at the instrument"
            ) from error
        model = decode(expect_ok(name), str)[0]
        number = decode(expect_ok(self._session.request(P.CSV_GET_SERIAL_NUMBER)), str)[
            0
        ]
        if self._serial_number not in ("", number):
            raise WrongDevice(
                f"{self._link.name}: instrument {number} answers, "
                f"{self._serial_number} is configured; check which cable is where"
            )
        firmware = self._session.request(P.CSV_GET_FIRMWARE_VERSION)
        version = ".".join(v.decode("ascii", "replace") for v in firmware.values)
        return Identity("Leica", model, number, version)

    def prepare(self) -> None:
        """Set prism constant and lock."""
        if self._prism_constant_mm is not None:
            told = float(self._prism_constant_mm)
            expect_ok(self._session.request(P.TMC_SET_PRISM_CORRECTION, (told,)))
            reply = expect_ok(self._session.request(P.TMC_GET_PRISM_CORRECTION))
            used = decode(reply, float)[0]
            if abs(used - told) > 1e-3:
                raise Refused(
                    f"{self._link.name} uses a prism constant of {used:g} mm, "
                    f"{told:g} mm was set; select a user prism at the instrument"
                )
        if self._follows:
            self._switch_on(P.AUT_SET_ATR, P.AUS_SET_USER_ATR)
            self._switch_on(P.AUT_SET_LOCK, P.AUS_SET_USER_LOCK)
            # Without a prism in view there is nothing to lock on yet.
            self._session.request(P.AUT_LOCK_IN, (), self._turn_s)

    def _switch_on(self, procedure: Procedure, newer: Procedure) -> None:
        """Later series have only the newer procedure."""
        try:
            expect_ok(self._session.request(procedure, (1,)))
        except Refused as error:
            if error.code not in NOT_OFFERED:
                raise
            try:
                expect_ok(self._session.request(newer, (1,)))
            except Refused as last:
                raise Refused(
                    f"{last}; set follows = false for one without lock", last.code
                ) from error

    def shoot(self) -> tuple[NDArray[np.float64], float]:
        """One distance with its angles; doubtful where the instrument warns.

        The last distance is cleared first, so that no earlier one is taken for it. A
        lost prism is searched once.
        """
        reply = self._measure_distance()
        if reply.code in NO_TARGET and self._follows and not self._stopping.is_set():
            self.tell(TrackerEventKind.BEAM_LOST, "the prism was lost and is sought")
            self.search()
            self.tell(TrackerEventKind.BEAM_LOCKED, "the prism was found again")
            reply = self._measure_distance()
        is_warned = reply.code in WITH_A_WARNING
        if is_warned:
            self.tell(
                TrackerEventKind.WARNING,
                f"{self._link.name}: {describe_code(reply.code)}",
            )
        else:
            expect_ok(reply)
        hz, v, distance = decode(reply, float, 3)
        if not is_point(hz, v, distance):
            raise DeviceError(
                f"{self._link.name}: Hz {hz}, V {v}, distance {distance} is no point"
            )
        return to_cartesian_mm(hz, v, distance), 0.0 if is_warned else 1.0

    def _measure_distance(self) -> Reply:
        for program in (_CLEAR, _DISTANCE):
            values = (program, _AUTO)
            reply = self._session.request_when_free(
                P.TMC_DO_MEASURE, values, self._stopping
            )
            expect_ok(reply)
        values = (int(1e3 * self._shot_s), _AUTO)
        return self._session.request_when_free(
            P.TMC_GET_SIMPLE_MEASUREMENT, values, self._stopping, self._shot_s
        )

    def _turn_to(self, hz_rad: float, v_rad: float) -> None:
        values = (float(hz_rad), float(v_rad), 1, 0, 0)
        with self._lock:
            expect_ok(self._session.request(P.AUT_TURN_TO, values, self._turn_s))

    def _read_atmosphere(self) -> tuple[float, ...]:
        with self._lock:
            reply = expect_ok(self._session.request(P.TMC_GET_ATMOSPHERE))
            return decode(reply, float, 4)

    def find_air(self) -> Air | None:
        """The air in use; None if it is not reported."""
        try:
            return self.read_air()
        except (Refused, DeviceTimeout) as error:
            log.warning("%s tells no air: %s", self._link.name, error)
            return None


def find_wet_bulb(dry_degc: float, humidity_percent: float) -> float:
    """Wet-bulb temperature near sea level.

    R. Stull, J. Appl. Meteorol. Climatol. 50 (2011) 2267-2269: good to 1 K from 5 % to
    99 % and -20 to 50 °C, which is 0.02 ppm of a distance.
    """
    t, rh = dry_degc, humidity_percent
    return (
        t * math.atan(0.151977 * math.sqrt(rh + 8.313659))
        + math.atan(t + rh)
        - math.atan(rh - 1.676331)
        + 0.00391838 * rh**1.5 * math.atan(0.023101 * rh)
        - 4.686035
    )


def find_humidity(dry_degc: float, wet_degc: float) -> float:
    """Relative humidity in % of a wet-bulb temperature; inverse of `find_wet_bulb`."""
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if find_wet_bulb(dry_degc, middle) < wet_degc:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


T = TypeVar("T", str, float)
_SHOT_TRIES = 20  # while the instrument is busy
_BUSY_S = 0.1


class GeoComSession:
    """One request at a time, from any thread."""

    def __init__(self, link: LineLink, reply_timeout_s: float) -> None:
        self.link, self._reply_timeout_s = link, reply_timeout_s
        # Not from 0: a reply left in a serial line must belong to no request.
        self._transaction = random.randrange(TRANSACTIONS)  # noqa: S311
        self._lock = threading.RLock()

    @property
    def name(self) -> str:
        return self.link.name

    def request_when_free(
        self,
        procedure: Procedure,
        values: tuple[int | float, ...],
        stopping: threading.Event,
        longer_s: float = 0.0,
    ) -> Reply:
        """Repeat a request while the instrument is busy."""
        reply = self.request(procedure, values, longer_s)
        for _ in range(_SHOT_TRIES):
            if reply.code != ReturnCode.BUSY or host_clock.wait(stopping, _BUSY_S):
                break
            reply = self.request(procedure, values, longer_s)
        return reply

    def request(
        self,
        procedure: Procedure,
        values: tuple[int | float, ...] = (),
        longer_s: float = 0.0,
    ) -> Reply:
        """Send a request; gives its own reply, ignoring others before it."""
        with self._lock:
            self._transaction = self._transaction % (TRANSACTIONS - 1) + 1
            number = self._transaction
            self.link.send(encode_request(procedure, number, values))
            deadline_s = host_clock.now_s() + self._reply_timeout_s + longer_s
            while (line := self.link.receive(deadline_s)) is not None:
                reply = parse_reply(line)
                if reply is not None and reply.transaction == number:
                    return self._require_link(reply, procedure)
                log.warning("%s: left out %r", self.name, line)
        raise DeviceTimeout(
            f"{self.name}: no reply to {procedure.name} in "
            f"{self._reply_timeout_s + longer_s:g} s; is the instrument on, and GeoCOM?"
        )

    def _require_link(self, reply: Reply, procedure: Procedure) -> Reply:
        if reply.link_code == ReturnCode.PROCEDURE_UNKNOWN:
            raise Refused(
                f"{self.name}: the instrument does not know {procedure.name} "
                f"({reply.link_code}); it is of another series, or lacks a licence",
                reply.link_code,
            )
        if reply.link_code != ReturnCode.OK:
            raise DeviceError(
                f"{self.name}: {procedure.name} did not reach the instrument: "
                f"{describe_code(reply.link_code)}"
            )
        return reply


def expect_ok(reply: Reply) -> Reply:
    """A good reply, unchanged. Raises BeamLost or Refused for any other."""
    if reply.code == ReturnCode.OK:
        return reply
    if reply.code in NO_TARGET:
        raise BeamLost(
            f"the instrument sees no prism: {describe_code(reply.code)}; bring it into "
            "the beam, then go on"
        )
    raise Refused(f"the instrument refuses: {describe_code(reply.code)}", reply.code)


def decode(reply: Reply, kind: type[T], count: int = 1) -> tuple[T, ...]:
    """Values of a reply. Raises DeviceError if their number differs from `count`."""
    try:
        texts = [value.decode("utf-8", "replace").strip('"') for value in reply.values]
        if len(texts) != count:
            raise ValueError(f"{len(texts)} values")
        return tuple(kind(text) for text in texts)
    except ValueError as error:
        raise DeviceError(f"a reply holds {reply.values}: {error}") from error
