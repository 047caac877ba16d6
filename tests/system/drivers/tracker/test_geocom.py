"""GeoCOM: geocompy as client of our instrument, our driver byte for byte like it."""

import math
import operator
import re

import numpy as np
import pytest
from geocompy import Angle, GeoCom, open_serial, open_socket
from geocompy.geo.gctypes import GeoComCode

from tracker_peers import LinePeer
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.tracker_records import Air, TrackerEventKind
from truepath_drivers.tracker.geocom import codec
from truepath_drivers.tracker.geocom.codec import encode_request, to_cartesian_mm
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_simulators.bench.bench import Bench
from wires import PtyWire

HURRIED = {"reply_timeout_s": 0.5, "shot_s": 0.5, "turn_s": 0.5}
P = codec.Procedure
SIMPLE = P.TMC_GET_SIMPLE_MEASUREMENT


@pytest.fixture(scope="module")
def bench():
    with Bench(protocol="geocom", tracker="tcp", speed=20.0, rtu=False) as running:
        yield running


@pytest.fixture
def tracker(bench):
    with GeoComTracker(**bench.tracker_options, **HURRIED) as connected:
        yield connected


class Instrument(LinePeer):
    """The other end of a terminal: answers each line as the test says."""

    def __init__(self) -> None:
        super().__init__(PtyWire())
        self.port: str = self.options["port"]
        self.heard: list[bytes] = []
        self.unknown: set[int] = set()
        self.answers = {5004: b'0,"TS"', 5003: b"0,77", 5034: b"0,1,2,3"}
        self.answers[2108] = b"0,0.1,1.5,10.0"
        self.answers[2029] = b"0,0.000000658,1013.25,20.0,14.0"
        self.say = lambda number, body: b"%R1P,0," + number + b":" + body + b"\r\n"

    def answer(self, line: bytes) -> bytes:
        found = re.match(rb"^\n*%R1Q,(\d+),(\d+):", line)
        if found is None:
            return b""
        self.heard.append(line)
        asked = int(found[1])
        if asked in self.unknown:
            return b"%R1P,3081," + found[2] + b":0\r\n"
        return self.say(found[2], self.answers.get(asked, b"0"))

    def driver(self, **options) -> GeoComTracker:

        return GeoComTracker(self.port, **HURRIED, **options)


@pytest.fixture
def instrument():
    with Instrument() as made:
        yield made


def test_geocompy_measures_with_the_simulated_station_and_sets_it(bench):
    with GeoComTracker(**bench.tracker_options, **HURRIED) as tracker:
        ours = tracker.measure(0.0).position_mm
    host, port = bench.tracker_options["host"], bench.tracker_options["port"]
    with open_socket(host, port, "tcp", timeout=5) as link:
        theirs = GeoCom(link)
        assert theirs.csv.get_instrument_name().params == "Simulated station"
        assert theirs.csv.get_serial_number().params == 1
        assert theirs.aut.switch_lock(True).error is GeoComCode.OK
        assert theirs.aut.lock_in().error is GeoComCode.OK
        assert theirs.tmc.do_measurement().error is GeoComCode.OK
        hz, v, distance = theirs.tmc.get_simple_measurement(5).params
        place = to_cartesian_mm(float(hz), float(v), distance)
        assert np.linalg.norm(place - ours) < 0.2
        # One distance, asked for twice.
        assert theirs.tmc.get_simple_measurement(5).error is GeoComCode.TMC_ANGLE_OK
        theirs.tmc.set_prism_correction(-17.5)
        assert theirs.tmc.get_prism_correction().params == -17.5
        theirs.tmc.set_prism_correction(0.0)
        theirs.tmc.set_atmospheric_corrections(658e-9, 990.0, 25.0, 18.0)
        told = theirs.tmc.get_atmospheric_corrections().params
        assert told[1:] == (990.0, 25.0, 18.0)


AIR = (0.658, 1013.25, 20.5, 14.123456789)
AIM = Angle(1.25), Angle(math.pi / 2)
REQUESTS = [  # of geocompy and ours
    ("tmc.do_measurement", ("CLEAR", "AUTO"), P.TMC_DO_MEASURE, (3, 1)),
    ("tmc.do_measurement", ("DISTANCE", "AUTO"), P.TMC_DO_MEASURE, (1, 1)),
    ("tmc.get_simple_measurement", (5, "AUTO"), SIMPLE, (5000, 1)),
    ("tmc.set_prism_correction", (-17.5,), P.TMC_SET_PRISM_CORRECTION, (-17.5,)),
    ("tmc.get_prism_correction", (), P.TMC_GET_PRISM_CORRECTION, ()),
    ("tmc.set_atmospheric_corrections", AIR, P.TMC_SET_ATMOSPHERE, AIR),
    ("tmc.get_atmospheric_corrections", (), P.TMC_GET_ATMOSPHERE, ()),
    ("aut.switch_atr", (True,), P.AUT_SET_ATR, (1,)),
    ("aut.switch_lock", (True,), P.AUT_SET_LOCK, (1,)),
    ("aut.lock_in", (), P.AUT_LOCK_IN, ()),
    ("aut.turn_to", (*AIM, "PRECISE"), P.AUT_TURN_TO, (1.25, math.pi / 2, 1, 0, 0)),
    ("aut.search", (0.05, 0.05), P.AUT_SEARCH, (0.05, 0.05, 0)),
    ("csv.get_instrument_name", (), P.CSV_GET_INSTRUMENT_NAME, ()),
    ("csv.get_serial_number", (), P.CSV_GET_SERIAL_NUMBER, ()),
    ("csv.get_firmware_version", (), P.CSV_GET_FIRMWARE_VERSION, ()),
]


def test_requests_are_byte_for_byte_those_of_geocompy(instrument):
    with open_serial(instrument.port, speed=115_200, timeout=2) as link:
        client = GeoCom(link)
        begin = len(instrument.heard)
        for ask, values, _, _ in REQUESTS:
            operator.attrgetter(ask)(client)(*values)
        theirs = instrument.heard[begin:]
    first = int(theirs[0].split(b",")[2].split(b":")[0])
    numbered = enumerate((asked[2:] for asked in REQUESTS), first)
    assert [encode_request(what, k, values) for k, (what, values) in numbered] == theirs


def test_a_reply_to_another_request_is_never_taken(instrument):
    def stale_first(number: bytes, body: bytes) -> bytes:
        old = b"%R1P,0," + str(int(number) - 1).encode() + b":0,0.5,0.5,99.0\r\n"
        return old + b"%R1P,0," + number + b":" + body + b"\r\n"

    instrument.say = stale_first
    with instrument.driver() as tracker:
        place = tracker.measure(0.0).position_mm
    assert place == pytest.approx(to_cartesian_mm(0.1, 1.5, 10.0))


SHOTS = {
    errors.BeamLost: [b"1285,0.1,1.5,0.0", b"1292,0.1,1.5,0.0"],
    errors.Refused: [b"1291,0.1,1.5,0.0"],
    errors.DeviceError: [
        *[b"0,0.1,1.5,0.0", b"0,0.1,1.5,-2.5", b"0,0.1,1.5,inf", b"0,nan,1.5,3.0"],
        *[b"0,1.0,90.0,2.5", b"0,1.0,100.0,2.5", b"0,57.3,1.5,2.5"],  # degrees, gon
        *[b"0,0.1,1.5", b"0,0.1,1.5,ten"],
    ],
}


@pytest.mark.parametrize(
    ("code", "family"),
    [(code, family) for family, codes in SHOTS.items() for code in codes],
)
def test_a_shot_that_is_none_is_an_error(instrument, code, family):
    instrument.answers[2108] = code
    with instrument.driver(follows=False) as tracker, pytest.raises(family):
        tracker.measure(0.0)


def test_a_shot_without_full_accuracy_is_told_and_a_silence_ends_in_time(instrument):
    instrument.answers[2108] = b"1284,0.1,1.5,10.0"
    with instrument.driver() as tracker:
        assert tracker.measure(0.0).quality == 0.0
        assert [e.kind for e in tracker.take_events()] == [TrackerEventKind.WARNING]
        instrument.say = lambda *_: b""
        with pytest.raises(errors.DeviceTimeout, match="no reply to TMC_DO_MEASURE"):
            tracker.measure(0.0)


def test_a_name_of_any_letters_is_told_and_others_are_wrong_devices(instrument):
    instrument.answers[5004] = '0,"TS60 I, R für 3D"'.encode()
    with instrument.driver() as tracker:
        assert tracker.connect().model == "TS60 I, R für 3D"
    said = "instrument 77 answers, 78 is configured"
    with pytest.raises(errors.WrongDevice, match=said):
        instrument.driver(serial_number="78").connect()
    instrument.say = lambda *_: b"OK\r\n"
    with pytest.raises(errors.WrongDevice, match="not in GeoCOM"):
        instrument.driver().connect()


def test_air_is_pushed_and_read_back(tracker):
    tracker.push_air(Air(23.0, 985.0, 55.0))
    used = tracker.read_air()
    assert used.temperature_degc == pytest.approx(23.0)
    assert used.pressure_hpa == pytest.approx(985.0)
    assert used.humidity_percent == pytest.approx(55.0, abs=0.1)
    assert tracker.measure(0.0).air == used
    with pytest.raises(errors.Refused, match="temperature, pressure and humidity"):
        tracker.push_air(Air(23.0))


def test_a_prism_near_the_beam_is_found_again_and_one_far_off_is_told(tracker):
    before = tracker.measure(0.0).position_mm
    aside = 0.015 * np.linalg.norm(before) * np.array([0.0, 0.0, 1.0])
    x, y, z = before + aside
    tracker.aim(math.atan2(y, x), math.atan2(z, math.hypot(x, y)))
    assert np.linalg.norm(tracker.measure(0.0).position_mm - before) < 0.2
    kinds = [event.kind for event in tracker.take_events()]
    assert kinds == [TrackerEventKind.BEAM_LOST, TrackerEventKind.BEAM_LOCKED]
    tracker.home()
    tracker.aim(1.0, 1.2)
    with pytest.raises(errors.BeamLost, match="bring it into the beam"):
        tracker.measure(0.0)


def test_what_an_instrument_lacks_is_asked_for_otherwise_or_refused(instrument):
    instrument.unknown = {9018, 9020}
    with instrument.driver():
        heard = b" ".join(instrument.heard)
    assert b"%R1Q,18005," in heard
    assert b"%R1Q,18007," in heard
    instrument.unknown |= {18005, 18007}
    said = r"does not know AUS_SET_USER_ATR.*follows"
    with pytest.raises(errors.Refused, match=said):
        instrument.driver().connect()
    with instrument.driver(follows=False):
        pass
    instrument.answers[2023] = b"0,0.0"
    with pytest.raises(errors.Refused, match="uses a prism constant of 0 mm, "):
        instrument.driver(prism_constant_mm=-17.5).connect()
