"""GeoCOM: geocompy as client of our instrument, our driver byte for byte like it."""

from __future__ import annotations

import math
import os
import re
import threading
import tty

import numpy as np
import pytest
from geocompy import Angle, GeoCom, open_serial, open_socket
from geocompy.geo.gctypes import GeoComCode

from truepath_drivers.interfaces.errors import (
    BeamLost,
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.tracker_records import Air, TrackerEventKind
from truepath_drivers.tracker.geocom import codec
from truepath_drivers.tracker.geocom.codec import (
    Procedure,
    encode_request,
    parse_reply,
    to_cartesian_mm,
)
from truepath_drivers.tracker.geocom.driver import (
    GeoComTracker,
    find_humidity,
    find_wet_bulb,
)
from truepath_simulators.bench.bench import Bench

HURRIED = {"reply_timeout_s": 0.5, "shot_s": 0.5, "turn_s": 0.5}


@pytest.fixture(scope="module")
def bench():
    with Bench(protocol="geocom", tracker="tcp", speed=20.0, rtu=False) as running:
        yield running


@pytest.fixture
def tracker(bench):
    with GeoComTracker(**bench.tracker_options, **HURRIED) as connected:
        yield connected


class Instrument:
    """The other end of a terminal: answers each line as the test says."""

    def __init__(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(slave)
        self._slave = slave
        self.port = os.ttyname(slave)
        self.heard: list[bytes] = []
        self.answers: dict[int, bytes] = {
            5004: b'0,"TS"',
            5003: b"0,77",
            5034: b"0,1,2,3",
            2108: b"0,0.1,1.5,10.0",
            2029: b"0,0.000000658,1013.25,20.0,14.0",
        }
        self.say = lambda number, body: b"%R1P,0," + number + b":" + body + b"\r\n"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        os.write(self._slave, b"end\r\n")
        self._thread.join(2.0)
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        rest = b""
        while True:
            rest += os.read(self._master, 4096)
            *lines, rest = rest.split(b"\r\n")
            for line in lines:
                found = re.match(rb"^\n*%R1Q,(\d+),(\d+):", line)
                if line == b"end":
                    return
                if found is not None:
                    self.heard.append(line)
                    body = self.answers.get(int(found[1]), b"0")
                    os.write(self._master, self.say(found[2], body))


@pytest.fixture
def instrument():
    made = Instrument()
    yield made
    made.close()


@pytest.fixture
def client(bench):
    options = bench.tracker_options
    with GeoComTracker(**options, **HURRIED) as tracker:
        place = tracker.measure(0.0).position_mm
    with open_socket(options["host"], options["port"], "tcp", timeout=5) as link:
        yield GeoCom(link), place


def test_geocompy_measures_with_the_simulated_station_and_sets_it(client):
    theirs, ours = client
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


def test_requests_are_byte_for_byte_those_of_geocompy(instrument):
    with open_serial(instrument.port, speed=115_200, timeout=2) as link:
        client = GeoCom(link)
        begin = len(instrument.heard)
        client.tmc.do_measurement("CLEAR", "AUTO")
        client.tmc.do_measurement("DISTANCE", "AUTO")
        client.tmc.get_simple_measurement(5, "AUTO")
        client.tmc.set_prism_correction(-17.5)
        client.tmc.get_prism_correction()
        client.tmc.set_atmospheric_corrections(0.658, 1013.25, 20.5, 14.123456789)
        client.tmc.get_atmospheric_corrections()
        client.aut.switch_atr(True)
        client.aut.switch_lock(True)
        client.aut.lock_in()
        client.aut.turn_to(Angle(1.25), Angle(math.pi / 2), "PRECISE")
        client.aut.search(0.05, 0.05)
        client.csv.get_instrument_name()
        client.csv.get_serial_number()
        client.csv.get_firmware_version()
        theirs = instrument.heard[begin:]
    first = int(theirs[0].split(b",")[2].split(b":")[0])
    ours = [
        (Procedure.TMC_DO_MEASURE, (3, 1)),
        (Procedure.TMC_DO_MEASURE, (1, 1)),
        (Procedure.TMC_GET_SIMPLE_MEASUREMENT, (5000, 1)),
        (Procedure.TMC_SET_PRISM_CORRECTION, (-17.5,)),
        (Procedure.TMC_GET_PRISM_CORRECTION, ()),
        (Procedure.TMC_SET_ATMOSPHERE, (0.658, 1013.25, 20.5, 14.123456789)),
        (Procedure.TMC_GET_ATMOSPHERE, ()),
        (Procedure.AUT_SET_ATR, (1,)),
        (Procedure.AUT_SET_LOCK, (1,)),
        (Procedure.AUT_LOCK_IN, ()),
        (Procedure.AUT_TURN_TO, (1.25, math.pi / 2, 1, 0, 0)),
        (Procedure.AUT_SEARCH, (0.05, 0.05, 0)),
        (Procedure.CSV_GET_INSTRUMENT_NAME, ()),
        (Procedure.CSV_GET_SERIAL_NUMBER, ()),
        (Procedure.CSV_GET_FIRMWARE_VERSION, ()),
    ]
    assert [
        encode_request(procedure, first + k, values)
        for k, (procedure, values) in enumerate(ours)
    ] == theirs


def test_return_codes_are_those_of_geocompy():
    known = {int(code) for code in GeoComCode}
    assert {int(code) for code in codec.ReturnCode} <= known


def test_the_frame_is_right_handed_with_z_up():
    right = 0.5 * math.pi
    ways = ((right, right), (0.0, right), (0.0, 0.0))
    x, y, z = (to_cartesian_mm(hz, v, 1.0) for hz, v in ways)
    assert np.cross(x, y) == pytest.approx(1e3 * z, abs=1e-6)
    assert z == pytest.approx([0.0, 0.0, 1000.0], abs=1e-9)


def test_replies_that_are_none_are_no_replies():
    for line in (b"", b"%R1P,0,1", b"R1P,0,1:0", b"%R1P,a,1:0", b"%R1Q,2108,1:5,1"):
        assert parse_reply(line) is None
    assert parse_reply(b"%R1P,0,3:0,1.5,2").values == (b"1.5", b"2")
    assert parse_reply(b"%R1P,0,3,48213:1292").code == 1292


def test_a_reply_to_another_request_is_never_taken(instrument):
    def stale_first(number: bytes, body: bytes) -> bytes:
        old = b"%R1P,0," + str(int(number) - 1).encode() + b":0,0.5,0.5,99.0\r\n"
        return old + b"%R1P,0," + number + b":" + body + b"\r\n"

    instrument.say = stale_first
    with GeoComTracker(instrument.port, **HURRIED) as tracker:
        place = tracker.measure(0.0).position_mm
    assert place == pytest.approx(to_cartesian_mm(0.1, 1.5, 10.0))


@pytest.mark.parametrize(
    ("code", "family"),
    [
        (b"1285,0.1,1.5,0.0", BeamLost),
        (b"1292,0.1,1.5,0.0", BeamLost),
        (b"1291,0.1,1.5,0.0", Refused),
        (b"0,0.1,1.5,0.0", DeviceError),
        (b"0,nan,1.5,3.0", DeviceError),
        (b"0,0.1,1.5", DeviceError),
        (b"0,0.1,1.5,ten", DeviceError),
    ],
)
def test_a_shot_that_is_none_is_an_error(instrument, code, family):
    instrument.answers[2108] = code
    with (
        GeoComTracker(instrument.port, follows=False, **HURRIED) as tracker,
        pytest.raises(family),
    ):
        tracker.measure(0.0)


def test_an_accuracy_that_is_not_guaranteed_is_told(instrument):
    instrument.answers[2108] = b"1284,0.1,1.5,10.0"
    with GeoComTracker(instrument.port, **HURRIED) as tracker:
        assert tracker.measure(0.0).quality == 0.0
        assert [e.kind for e in tracker.take_events()] == [TrackerEventKind.WARNING]


def test_silence_ends_in_time(instrument):
    with GeoComTracker(instrument.port, **HURRIED) as tracker:
        instrument.say = lambda *_: b""
        with pytest.raises(DeviceTimeout, match="no reply to TMC_DO_MEASURE"):
            tracker.measure(0.0)


def test_another_instrument_and_another_protocol_are_wrong_devices(instrument):
    with pytest.raises(WrongDevice, match="instrument 77 answers, 78 is configured"):
        GeoComTracker(instrument.port, serial_number="78", **HURRIED).connect()
    instrument.say = lambda *_: b"OK\r\n"
    with pytest.raises(WrongDevice, match="not in GeoCOM"):
        GeoComTracker(instrument.port, **HURRIED).connect()


def test_a_prism_constant_that_does_not_come_back_is_refused(instrument):
    instrument.answers[2023] = b"0,0.0"
    with pytest.raises(Refused, match="uses a prism constant of 0 mm, "):
        GeoComTracker(instrument.port, prism_constant_mm=-17.5, **HURRIED).connect()


def test_air_is_pushed_and_read_back(tracker):
    tracker.push_air(Air(23.0, 985.0, 55.0))
    used = tracker.read_air()
    assert used.temperature_degc == pytest.approx(23.0)
    assert used.pressure_hpa == pytest.approx(985.0)
    assert used.humidity_percent == pytest.approx(55.0, abs=0.1)
    assert tracker.measure(0.0).air == used
    with pytest.raises(Refused, match="temperature, pressure and humidity"):
        tracker.push_air(Air(23.0))


def test_a_wet_bulb_is_below_a_dry_one_unless_the_air_is_full():
    assert find_wet_bulb(20.0, 50.0) == pytest.approx(13.7, abs=0.05)  # Stull 2011
    assert find_humidity(20.0, find_wet_bulb(20.0, 35.0)) == pytest.approx(35.0)


def test_a_prism_that_was_lost_is_sought_and_found_again(bench, tracker):
    before = tracker.measure(0.0).position_mm
    aside = 0.015 * np.linalg.norm(before) * np.array([0.0, 0.0, 1.0])
    tracker.aim(*_angles(before + aside))
    again = tracker.measure(0.0).position_mm
    assert np.linalg.norm(again - before) < 0.2
    kinds = [event.kind for event in tracker.take_events()]
    assert kinds == [TrackerEventKind.BEAM_LOST, TrackerEventKind.BEAM_LOCKED]


def test_a_prism_that_is_far_off_the_beam_is_told_as_lost(tracker):
    tracker.home()
    tracker.aim(1.0, 1.2)
    with pytest.raises(BeamLost, match="bring it into the beam"):
        tracker.measure(0.0)


def _angles(place_mm: np.ndarray) -> tuple[float, float]:
    x, y, z = place_mm
    return math.atan2(y, x), math.atan2(z, math.hypot(x, y))


def test_a_comma_or_a_letter_beyond_ascii_in_a_name_is_part_of_it(instrument):
    instrument.answers[5004] = '0,"TS60 I, R für 3D"'.encode()
    with GeoComTracker(port=instrument.port, **HURRIED) as tracker:
        assert tracker.connect().model == "TS60 I, R für 3D"


@pytest.mark.parametrize("values", [b"", b",", b"1", b"1,", b',"a,b",', b'"",2'])
def test_values_are_split_at_commas_outside_of_quotes(values):
    reply = parse_reply(b"%R1P,0,4:0," + values)
    assert b",".join(reply.values) == values
    assert len(reply.values) == re.sub(rb'"[^"]*"', b"", values).count(b",") + 1


def without(instrument, *unknown):
    """Make the instrument one that does not know some procedures."""
    say = instrument.say

    def answer(number, body):
        asked = re.match(rb"^\n*%R1Q,(\d+),", instrument.heard[-1])[1]
        if int(asked) in unknown:
            return b"%R1P,3081," + number + b":0\r\n"
        return say(number, body)

    instrument.say = answer


def test_an_instrument_that_knows_lock_by_its_newer_procedures_follows(instrument):
    without(instrument, 9018, 9020)
    with GeoComTracker(port=instrument.port, **HURRIED):
        heard = b" ".join(instrument.heard)
    assert b"%R1Q,18005," in heard
    assert b"%R1Q,18007," in heard


def test_an_instrument_without_lock_says_what_to_set(instrument):
    without(instrument, 9018, 9020, 18005, 18007)
    tracker = GeoComTracker(port=instrument.port, **HURRIED)
    with pytest.raises(Refused, match=r"does not know AUS_SET_USER_ATR.*follows"):
        tracker.connect()
    with GeoComTracker(port=instrument.port, follows=False, **HURRIED):
        pass
