"""T2SA: the dialogue of its public client, and what must never be taken for a point."""

import threading
from collections.abc import Callable

import numpy as np
import pytest

from tracker_peers import LinePeer
from truepath_drivers.interfaces import errors, tracker_records
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from wires import TcpWire

HURRIED = {"reply_timeout_s": 0.3, "shot_s": 0.3}
MEASURE = "!MEAS_SINGLE_POINT:A;truepath;truepath_1"
POINT = "ACK-300 Single Point Measurement truepath_1 result {} 11/23/2026 02:00:00 True"


NO_PLACES = "1,2", "1,2,nan", "0.0,0.0,0.0", "1,5,2,5,3,5"


class Application(LinePeer):
    """A T2SA that answers each line as the test says; one connection after another."""

    def __init__(self) -> None:
        super().__init__(TcpWire())
        self.heard: list[str] = []
        self.answers = {"?STAT": "ACK-300 Instrument is connected"}
        self.answers |= {
            "?LSTA": "ACK-300 LON",
            MEASURE: POINT.format("1500.5,20.25,-3"),
        }
        self.answers["!LST:1"] = "ACK-300 Tracker Interface Started: True"
        self.say: Callable[[str], str] = lambda reply: reply + "\r\n"

    def answer(self, line: bytes) -> bytes:
        self.heard.append(line.decode())
        reply = self.answers.get(self.heard[-1], "ERR-200 Command rejected")
        return self.say(reply).encode()


@pytest.fixture
def application():
    with Application() as made:
        yield made


@pytest.fixture
def tracker(application):
    with T2saTracker(**application.options, **HURRIED) as connected:
        yield connected


def test_the_dialogue_is_that_of_the_public_client_or_runs_a_plan(application):
    with T2saTracker(**application.options, **HURRIED) as tracker:
        place = tracker.measure(0.0).position_mm
    assert place.tolist() == [1500.5, 20.25, -3.0]
    assert application.heard == ["?STAT", "?LSTA", MEASURE]
    report = "Object Offset Report FrameM2_0;X:1.5;Y:2;Z:3;Rx:0;Ry:0;Rz:0;11/23 02:00"
    application.answers["!CMDEXE:M2"] = "ACK-106 Successfully ran CMD M2"
    application.answers["?POS M2"] = f"ACK-300 {report}"
    with T2saTracker(**application.options, plan="M2", **HURRIED) as tracker:
        assert tracker.measure(0.0).position_mm.tolist() == [1.5, 2.0, 3.0]
    assert application.heard[5:7] == ["!CMDEXE:M2", "?POS M2"]


@pytest.mark.parametrize(("unit", "factor"), [("m", 1000.0), ("inch", 25.4)])
def test_the_units_of_the_job_are_made_mm_or_refused(application, unit, factor):
    with T2saTracker(**application.options, unit=unit, **HURRIED) as tracker:
        place = tracker.measure(0.0).position_mm
    assert place == pytest.approx(factor * np.array([1500.5, 20.25, -3.0]))
    with pytest.raises(ValueError, match="'cm' is none of mm, m, inch"):
        T2saTracker("127.0.0.1", 9, unit="cm")


def test_a_laser_that_is_off_is_switched_on_and_said_to_warm_up(application):
    application.answers["?LSTA"] = "ACK-300 LOFF"
    with T2saTracker(**application.options, **HURRIED) as tracker:
        events = tracker.take_events()
    assert "!LST:1" in application.heard
    assert [e.kind for e in events] == [tracker_records.TrackerEventKind.WARNING]
    assert events[0].action


@pytest.mark.parametrize(
    ("reply", "family"),
    [
        ("ERR-305 Measurement of point failed", errors.BeamLost),
        ("ERR-343 Hold position no beam lock not set", errors.BeamLost),
        ("ERR-338 Laser status WARM", errors.Refused),
        ("ERR-201 Command rejected. SA is busy.", errors.Refused),
        *[(POINT.format(place), errors.DeviceError) for place in NO_PLACES],
        (POINT.format("1,2,3").replace("th_1", "th_12"), errors.DeviceError),
        ("ACK-300 READY", errors.DeviceError),
    ],
)
def test_a_reply_without_our_point_is_an_error(application, tracker, reply, family):
    application.answers[MEASURE] = reply
    with pytest.raises(family):
        tracker.measure(0.0)


def test_a_reply_to_an_earlier_request_is_never_taken(application, tracker):
    release = threading.Event()

    def late(reply: str) -> str:
        release.wait(1.0)
        return reply.replace("1500.5", "9999.9") + "\r\n"

    on_time, application.say = application.say, late
    with pytest.raises(errors.DeviceTimeout, match="is T2SA running"):
        tracker.measure(0.0)
    application.say = on_time
    release.set()
    assert tracker.measure(0.0).position_mm[0] == 1500.5
    assert application.wire.connections == 2
    application.say = lambda reply: reply + "\r\n" + POINT.format("7777.7,0,0") + "\r\n"
    assert tracker.measure(0.0).position_mm[0] == 1500.5
    application.say = lambda reply: reply + "\r\n"
    assert tracker.measure(0.0).position_mm[0] == 1500.5


def test_something_else_on_the_port_and_no_instrument_behind_it_are_told(application):
    tracker = T2saTracker(**application.options, **HURRIED)
    application.answers["?STAT"] = "ERR-341 Not connected to SA"
    with pytest.raises(errors.Refused, match="Not connected to SA"):
        tracker.connect()
    application.say = lambda _: "220 mail service ready\r\n"
    with pytest.raises(errors.WrongDevice, match="not as T2SA does"):
        tracker.connect()
