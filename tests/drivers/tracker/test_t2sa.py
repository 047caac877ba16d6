"""T2SA: the dialogue of its public client, and what must never be taken for a point."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import numpy as np
import pytest

from truepath_drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.tracker_records import TrackerEventKind
from truepath_drivers.tracker.t2sa.codec import ErrorCode, parse_place, parse_reply
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_simulators.bench.bench import Bench

HURRIED = {"reply_timeout_s": 0.3, "shot_s": 0.3}
POINT = "ACK-300 Single Point Measurement truepath_1 result {} 11/23/2026 02:00:00 True"


class Application:
    """A T2SA that answers each line as the test says; one connection after another."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.options = {"host": "127.0.0.1", "port": self._server.getsockname()[1]}
        self.heard: list[str] = []
        self.connections = 0
        self.answers: dict[str, str] = {
            "?STAT": "ACK-300 Instrument is connected",
            "?LSTA": "ACK-300 LON",
            "!LST:1": "ACK-300 Tracker Interface Started: True",
            "!MEAS_SINGLE_POINT:A;truepath;truepath_1": POINT.format("1500.5,20.25,-3"),
        }
        self.say: Callable[[str], str] = lambda reply: reply + "\r\n"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join(2.0)

    def _run(self) -> None:
        while True:
            try:
                link, _ = self._server.accept()
            except OSError:
                return
            self.connections += 1
            with link:
                self._serve(link)

    def _serve(self, link: socket.socket) -> None:
        rest = b""
        while True:
            try:
                data = link.recv(4096)
                *lines, rest = (rest + data).split(b"\r\n")
                for line in map(bytes.decode, lines):
                    self.heard.append(line)
                    unknown = "ERR-200 Command rejected"
                    link.sendall(self.say(self.answers.get(line, unknown)).encode())
            except OSError:
                return
            if not data:
                return


@pytest.fixture
def application():
    made = Application()
    yield made
    made.close()


@pytest.fixture
def tracker(application):
    with T2saTracker(**application.options, **HURRIED) as connected:
        yield connected


def test_the_dialogue_is_that_of_the_public_client(application, tracker):
    place = tracker.measure(0.0).position_mm
    assert place.tolist() == [1500.5, 20.25, -3.0]
    assert application.heard == [
        "?STAT",
        "?LSTA",
        "!MEAS_SINGLE_POINT:A;truepath;truepath_1",
    ]


def test_a_plan_is_run_and_its_frame_is_asked_for(application):
    report = "Object Offset Report FrameM2_0;X:1.5;Y:2;Z:3;Rx:0;Ry:0;Rz:0;11/23 02:00"
    application.answers["!CMDEXE:M2"] = "ACK-106 Successfully ran CMD M2"
    application.answers["?POS M2"] = f"ACK-300 {report}"
    with T2saTracker(**application.options, plan="M2", **HURRIED) as tracker:
        assert tracker.measure(0.0).position_mm.tolist() == [1.5, 2.0, 3.0]
    assert application.heard[2:4] == ["!CMDEXE:M2", "?POS M2"]


@pytest.mark.parametrize(("unit", "factor"), [("m", 1000.0), ("inch", 25.4)])
def test_the_units_of_the_job_are_made_mm(application, unit, factor):
    with T2saTracker(**application.options, unit=unit, **HURRIED) as tracker:
        place = tracker.measure(0.0).position_mm
    assert place == pytest.approx(factor * np.array([1500.5, 20.25, -3.0]))


def test_an_unknown_unit_is_refused():
    with pytest.raises(ValueError, match="'cm' is none of mm, m, inch"):
        T2saTracker("127.0.0.1", 9, unit="cm")


def test_a_laser_that_is_off_is_switched_on_and_said_to_warm_up(application):
    application.answers["?LSTA"] = "ACK-300 LOFF"
    with T2saTracker(**application.options, **HURRIED) as tracker:
        events = tracker.take_events()
    assert "!LST:1" in application.heard
    assert [e.kind for e in events] == [TrackerEventKind.WARNING]
    assert events[0].action


@pytest.mark.parametrize(
    ("reply", "family"),
    [
        ("ERR-305 Measurement of point failed", BeamLost),
        ("ERR-343 Hold position no beam lock not set", BeamLost),
        ("ERR-338 Laser status WARM", Refused),
        ("ERR-201 Command rejected. SA is busy.", Refused),
        (POINT.format("1,2"), DeviceError),
        (POINT.format("1,2,nan"), DeviceError),
        (POINT.format("1,2,3").replace("truepath_1", "truepath_12"), DeviceError),
        ("ACK-300 READY", DeviceError),
    ],
)
def test_a_reply_without_our_point_is_an_error(application, tracker, reply, family):
    application.answers["!MEAS_SINGLE_POINT:A;truepath;truepath_1"] = reply
    with pytest.raises(family):
        tracker.measure(0.0)


def test_a_late_reply_is_never_taken_for_that_of_the_next_request(application, tracker):
    release = threading.Event()

    def late(reply: str) -> str:
        release.wait(1.0)
        return reply.replace("1500.5", "9999.9") + "\r\n"

    on_time, application.say = application.say, late
    with pytest.raises(DeviceTimeout, match="is T2SA running"):
        tracker.measure(0.0)
    application.say = on_time
    release.set()
    assert tracker.measure(0.0).position_mm[0] == 1500.5
    assert application.connections == 2


def test_a_reply_that_was_already_there_is_left_out(application, tracker):
    application.say = lambda reply: reply + "\r\n" + POINT.format("7777.7,0,0") + "\r\n"
    assert tracker.measure(0.0).position_mm[0] == 1500.5
    application.say = lambda reply: reply + "\r\n"
    assert tracker.measure(0.0).position_mm[0] == 1500.5


def test_something_else_on_the_port_is_a_wrong_device(application):
    application.say = lambda _: "220 mail service ready\r\n"
    with pytest.raises(WrongDevice, match="not as T2SA does"):
        T2saTracker(**application.options, **HURRIED).connect()


def test_no_instrument_behind_the_application_is_told(application):
    application.answers["?STAT"] = "ERR-341 Not connected to SA"
    with pytest.raises(Refused, match="Not connected to SA"):
        T2saTracker(**application.options, **HURRIED).connect()


def test_an_application_that_goes_away_is_connected_anew(application, tracker):
    tracker.measure(0.0)
    tracker.close()
    with pytest.raises(ConnectionLost, match="connect first"):
        tracker.measure(0.0)
    tracker.connect()
    assert tracker.measure(0.0).count == 1


def test_lines_that_are_none_are_no_replies():
    assert parse_reply(b"ACK300") is None
    assert parse_reply(b"ERR-305 no").code == ErrorCode.POINT_FAILED
    assert parse_place("Single Point Measurement p result 1,2,x a b c", "p") is None


@pytest.mark.long
def test_points_and_plans_of_the_simulated_application_agree():
    with Bench(protocol="t2sa", tracker="tcp", speed=20.0, rtu=False) as bench:
        options = bench.tracker_options
        with T2saTracker(**options) as tracker:
            point = tracker.measure(0.2)
        with T2saTracker(**options, plan="cell") as tracker:
            plan = tracker.measure(0.0)
    assert point.count > 1
    assert np.linalg.norm(point.position_mm - plan.position_mm) < 0.2
