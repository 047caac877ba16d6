"""Every registered driver keeps what the interfaces promise; broken ones are caught."""

import itertools
import threading
import time
from dataclasses import replace
from importlib.metadata import entry_points

import numpy as np
import pytest

from truepath_drivers.conformance import device, motion, tracker
from truepath_drivers.conformance.checking import NotConforming, on_terms
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.conformance.polled_tracker import POLLED_CHECKS
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    OutOfTravel,
    Refused,
)
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import (
    Identity,
    LinkHealth,
    MotionState,
    MotionStatus,
    TrackerSamples,
)
from truepath_drivers.interfaces.tracker import Tracker
from truepath_simulators.bench.bench import Bench

TRACKERS = {point.name: point for point in entry_points(group="truepath.trackers")}
CONTROLLERS = {
    point.name: point for point in entry_points(group="truepath.motion_controllers")
}
# Where a driver of that name finds a device, on a running bench. A new driver of ours
# needs a line here.
TRACKER_PEERS = {"streaming": ["tracker_options"]}
HURRIED = {"reply_timeout_s": 0.3, "shot_s": 0.3}
POLLED = {  # each with simulated instruments of its own name
    "geocom": {"tracker": "pty", **HURRIED, "turn_s": 0.3},
    "t2sa": {"tracker": "tcp", **HURRIED},
}
ELSEWHERE = {"text-line"}  # behind a relay, in tracker/test_text_line.py
CONTROLLER_PEERS = {
    "modbus": ["motion_options", "motion_options_rtu"],
    "linuxcnc": [],  # a real one, in test_linuxcnc_driver.py
}
ABSENT = {
    "text-line": {"port": "/dev/truepath-no-such-port", "rate_hz": 500.0},
    "streaming": {"port": "/dev/truepath-no-such-port"},
    "geocom": {"port": "/dev/truepath-no-such-port"},
    "t2sa": {"host": "127.0.0.1", "port": 9},
    "modbus": {"serial_port": "/dev/truepath-no-such-port"},
    "linuxcnc": {"host": "127.0.0.1", "port": 9},
}


@pytest.fixture(scope="module", params=["pty", "tcp"])
def tracker_bench(request):
    with Bench(tracker=request.param, rtu=False) as bench:
        yield bench


@pytest.fixture(scope="module")
def motion_bench():
    # Ten times faster, so that motions are over soon; watchdogs stay in wall seconds.
    with Bench(speed=5.0) as bench:
        yield bench


def test_every_registered_driver_of_ours_has_a_peer():
    ours = {
        point.name
        for point in (*TRACKERS.values(), *CONTROLLERS.values())
        if point.module.startswith("truepath_drivers.")
    }
    peers = ELSEWHERE | set(TRACKER_PEERS) | set(POLLED) | set(CONTROLLER_PEERS)
    assert ours == peers == set(ABSENT)


@pytest.mark.parametrize("name", TRACKER_PEERS)
@pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
def test_trackers_conform(tracker_bench, name, check):
    factory = TRACKERS[name].load()
    for peer in TRACKER_PEERS[name]:
        options = getattr(tracker_bench, peer)
        check(lambda options=options: factory(**options))


@pytest.fixture(
    scope="module", params=["geocom", pytest.param("t2sa", marks=pytest.mark.long)]
)
def polled_bench(request):
    name = request.param
    link = POLLED[name]["tracker"]
    with Bench(protocol=name, speed=20.0, rtu=False, tracker=link) as bench:
        yield name, bench


@pytest.mark.parametrize("check", POLLED_CHECKS, ids=lambda check: check.__name__)
def test_polled_trackers_conform(polled_bench, check):
    name, bench = polled_bench
    factory = TRACKERS[name].load()
    check(lambda: factory(**bench.tracker_options))


@pytest.mark.parametrize("fault", ["beam-break@0s+600s", "silence@0s+600s"])
def test_polled_trackers_return_no_point_without_a_target(polled_bench, fault):
    name, bench = polled_bench
    factory = TRACKERS[name].load()
    patience = {key: s for key, s in POLLED[name].items() if key != "tracker"}
    with factory(**bench.tracker_options, **patience) as tracker:
        bench.inject("tracker:" + fault.replace("600s", "20s"))
        time.sleep(0.2)
        with pytest.raises(DeviceError):
            tracker.measure(0.0)


@pytest.mark.parametrize(
    ("name", "peer"),
    [(name, peer) for name, peers in CONTROLLER_PEERS.items() for peer in peers],
)
@pytest.mark.parametrize("check", MOTION_CHECKS, ids=lambda check: check.__name__)
def test_motion_controllers_conform(motion_bench, name, peer, check):
    factory = CONTROLLERS[name].load()
    options = getattr(motion_bench, peer)
    check(lambda: factory(**options))


@pytest.mark.parametrize("name", ABSENT)
def test_absent_devices_are_device_errors(name):
    factory = {**TRACKERS, **CONTROLLERS}[name].load()
    device.a_device_that_is_not_there_is_a_device_error(lambda: factory(**ABSENT[name]))


class GoodTracker(Tracker):
    """Keeps everything, in memory."""

    place = 1500.0
    status = 0

    def __init__(self) -> None:
        self.connected = self.streams = False
        self.number = 0

    def connect(self) -> Identity:
        self.connected = True
        return Identity("maker", "model", "1", "0")

    def close(self) -> None:
        self.connected = self.streams = False

    def start(self, rate_hz: float) -> None:
        self.need_connection()
        if not 0 < rate_hz < 1e6:
            raise Refused("no")
        self.streams = True

    def stop(self) -> None:
        self.streams = False

    def read(self, timeout_s: float) -> TrackerSamples:
        self.need_connection()
        if not self.streams:
            return TrackerSamples.empty()
        number = self.number + np.arange(10)
        self.number += 10
        return TrackerSamples(
            number,
            self.stamp(number),
            np.full((10, 3), self.place),
            np.full(10, self.status, np.int64),
        )

    def stamp(self, number):
        return number * 2e-3

    @property
    def health(self) -> LinkHealth:
        return LinkHealth(frames=self.number)

    def need_connection(self) -> None:
        if not self.connected:
            raise ConnectionLost("connect first")


class GoodController(MotionController):
    """Keeps everything, in memory; motions end when somebody waits for them."""

    limits = ((0.0, 100.0),)
    watches = True
    brakes = 0.0
    first_line = 0
    counts_lines = True
    names = ("X",)

    def __init__(self) -> None:
        self.connected = False
        self.at = MotionStatus(MotionState.IDLE, (50.0,), 0)
        self.target = self.path = self.feed = None

    axes = property(lambda self: self.names)
    travel = property(lambda self: self.limits)

    def connect(self) -> Identity:
        self.connected = True
        return Identity("maker", "model", "1", "0", has_watchdog=True)

    def close(self) -> None:
        if self.at.state is MotionState.RUNNING:
            self.abort()
        self.connected = False

    def status(self) -> MotionStatus:
        if not self.connected:
            raise ConnectionLost("connect first")
        if self.at.state is MotionState.HELD:
            moved = tuple(x + self.brakes for x in self.at.position)
            self.at = replace(self.at, position=moved)
        running = self.at.state is MotionState.RUNNING
        if running and self.watches and time.monotonic() > self.fed_s + 0.1:
            self.at = replace(self.at, state=MotionState.HELD, hold_reason="watchdog")
        return self.at

    def move_to(self, position, feed_mm_min) -> None:
        self.status()
        self.check(np.atleast_2d(position))
        self.target, self.feed = tuple(position), feed_mm_min
        self.fed_s, self.beats = time.monotonic(), 0
        self.at = replace(self.at, state=MotionState.RUNNING)

    def load(self, path) -> None:
        self.status()
        if path.axes != self.axes:
            raise Refused("other axes")
        self.check(path.position)
        self.path = path
        self.at = replace(self.at, state=MotionState.READY)

    def check(self, rows) -> None:
        (low, high), *_ = self.limits
        if not ((rows >= low) & (rows <= high)).all():
            raise OutOfTravel("beyond")

    def start(self) -> None:
        self.status()
        if self.path is None:
            raise Refused("no path")
        self.move_to(self.path.position[-1], self.path.feed_mm_min[-1])

    def wait(self, timeout_s) -> MotionStatus:
        if self.at.state is MotionState.RUNNING:
            if timeout_s < 1:
                raise DeviceTimeout("still runs")
            if self.path is not None and self.path.feed_mm_min[-1] < 100:
                threading.Event().wait(0.05)
            if self.at.state is MotionState.RUNNING:
                self.finish()
        return self.at

    def hold(self) -> None:
        if self.at.state is MotionState.RUNNING:
            self.at = replace(self.at, state=MotionState.HELD, hold_reason="command")

    def resume(self) -> None:
        if self.at.state is MotionState.HELD:
            self.at = replace(self.at, state=MotionState.RUNNING, hold_reason="")

    def abort(self) -> None:
        self.path = None
        self.at = replace(self.at, state=MotionState.ABORTED)

    def send_heartbeat(self) -> None:
        self.fed_s = time.monotonic()
        self.beats += 1
        if self.beats > 3 and self.at.state is MotionState.RUNNING:
            self.finish()

    def finish(self) -> None:
        line = 0 if self.path is None else len(self.path) - 1
        self.at = replace(
            self.at,
            state=MotionState.FINISHED,
            position=self.target,
            line=self.first_line + line * self.counts_lines,
        )


@pytest.fixture
def shared_machine():
    """A factory whose drivers move one and the same machine."""
    machine = GoodController()

    def make() -> GoodController:
        controller = GoodController()
        controller.__dict__ = machine.__dict__
        return controller

    return make


@pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
def test_a_good_tracker_passes(check):
    check(GoodTracker)


@pytest.mark.parametrize("check", MOTION_CHECKS, ids=lambda check: check.__name__)
def test_a_good_controller_passes(shared_machine, check):
    check(shared_machine)


COUNTER = itertools.count()


def begin_clock_anew(self, timeout_s):
    block = GoodTracker.read(self, timeout_s)
    return replace(block, device_time_s=block.device_time_s % 0.02)


def forget_what_waits(self):
    self.number += int(500 * (time.monotonic() - self.read_s))


def begin_to_wait(self, timeout_s):
    self.read_s = time.monotonic()
    return GoodTracker.read(self, timeout_s)


def with_faults(base, **faults):
    return type("Faulty", (base,), faults)


@pytest.mark.parametrize(
    ("check", "faults"),
    [
        (
            device.connect_tells_who_answers,
            {"connect": lambda self: Identity("", "", "", "")},
        ),
        (
            device.connect_twice_is_one_connection,
            {"connect": lambda self: Identity("a", "b", str(next(COUNTER)), "d")},
        ),
        (
            tracker.silence_is_an_empty_block_in_time,
            {"streams": property(lambda self: True, lambda self, value: None)},
        ),
        (
            tracker.samples_have_rising_numbers_and_times,
            {"number": property(lambda self: 0, lambda self, value: None)},
        ),
        (
            tracker.numbers_go_on_after_a_pause,
            {"health": property(lambda self: LinkHealth(lost_samples=7))},
        ),
        (
            tracker.numbers_go_on_after_a_pause,
            {"read": lambda self, timeout_s: begin_clock_anew(self, timeout_s)},
        ),
        (
            tracker.times_are_those_of_the_samples,  # ms
            {"stamp": lambda self, number: number * 2.0},
        ),
        (
            tracker.times_are_those_of_the_samples,  # half the rate
            {"stamp": lambda self, number: number * 4e-3},
        ),
        (
            tracker.times_are_those_of_the_samples,  # arrival, in blocks of ten
            {"stamp": lambda self, n: (n // 10) * 20e-3 + (n % 10) * 1e-6},
        ),
        (
            tracker.times_are_those_of_the_samples,  # one of 50 lost, the rest counted
            {"stamp": lambda self, number: 2e-3 * (number + number // 49)},
        ),
        (
            tracker.numbers_go_on_after_a_pause,  # what waited goes at the stop
            {"read": begin_to_wait, "stop": forget_what_waits},
        ),
        (tracker.a_target_at_rest_is_valid_and_in_mm, {"place": 1.5}),
        (tracker.a_target_at_rest_is_valid_and_in_mm, {"status": 4}),
        (
            tracker.health_counts_what_has_come,
            {"health": property(lambda self: LinkHealth())},
        ),
        (
            tracker.health_counts_what_has_come,
            {"health": property(lambda self: LinkHealth(self.number, 5))},
        ),
        (tracker.impossible_rates_are_refused, {"start": lambda self, rate: None}),
        (
            tracker.a_closed_tracker_has_no_samples,
            {"need_connection": lambda self: None},
        ),
        (
            tracker.stop_from_another_thread_ends_the_stream,
            {"stop": lambda self: None},
        ),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_faulty_tracker_is_caught(check, faults):
    faulty = with_faults(GoodTracker, **faults)
    with pytest.raises(NotConforming):
        check(faulty)


@pytest.mark.parametrize(
    ("check", "faults"),
    [
        (motion.axes_and_travel_are_known, {"limits": ((5.0, 5.0),)}),
        (motion.axes_and_travel_are_known, {"names": ()}),
        (motion.out_of_travel_is_refused, {"check": lambda self, rows: None}),
        (motion.a_path_of_other_axes_is_refused, {"load": lambda self, p: None}),
        (motion.hold_and_resume_are_absolute, {"hold": lambda self: None}),
        (
            motion.resume_of_nothing_does_nothing,
            {
                "resume": lambda self: setattr(
                    self, "at", MotionStatus(MotionState.IDLE, (51.0,), 0)
                )
            },
        ),
        (
            motion.resume_of_nothing_does_nothing,
            {"resume": lambda self: None if self.path is None else self.start()},
        ),
        (
            motion.abort_from_another_thread_ends_the_motion,
            {"abort": lambda self: None},
        ),
        (motion.wait_ends_in_time, {"wait": lambda self, timeout_s: self.at}),
        (motion.hold_means_standstill, {"brakes": 0.2}),
        (motion.the_line_is_the_row_moved_towards, {"first_line": 1}),
        (motion.the_line_is_the_row_moved_towards, {"counts_lines": False}),
        (motion.a_claimed_watchdog_holds_the_feed, {"watches": False}),
        (motion.close_stops_the_motion, {"close": lambda self: None}),
        (
            motion.a_closed_controller_moves_nothing,
            {"status": lambda self: self.at},
        ),
        (
            motion.a_move_ends_where_it_was_sent,
            {"move_to": lambda self, position, feed: None},
        ),
        (motion.a_path_runs_to_its_last_row, {"load": lambda self, path: None}),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_faulty_controller_is_caught(check, faults):
    faulty = with_faults(GoodController, **faults)
    machine = faulty()

    def make():
        controller = faulty()
        controller.__dict__ = machine.__dict__
        return controller

    with on_terms(watchdog_s=0.3), pytest.raises(NotConforming):
        check(make)


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_the_rate_is_a_term_of_the_checks(tracker_bench, rate_hz):
    factory = TRACKERS["streaming"].load()
    with on_terms(rate_hz=rate_hz, patience_s=2.0):
        tracker.times_are_those_of_the_samples(
            lambda: factory(**tracker_bench.tracker_options)
        )


def test_a_file_left_open_is_caught(tmp_path):
    left = []

    def connect(self):
        left.append((tmp_path / "port").open("w"))
        return Identity("maker", "model", "1", "0")

    with pytest.raises(NotConforming, match="left a file or a thread behind"):
        device.close_is_idempotent_and_leaves_nothing(
            with_faults(GoodTracker, connect=connect)
        )
    for file in left:
        file.close()


def test_a_constructor_that_opens_is_caught(tmp_path):
    left = []

    def construct(self):
        left.append((tmp_path / "port").open("w"))

    with pytest.raises(NotConforming, match="constructor opened something"):
        device.construction_opens_nothing(with_faults(GoodTracker, __init__=construct))
    left[0].close()


def test_a_device_that_answers_where_none_is_is_caught():
    with pytest.raises(NotConforming, match="not there"):
        device.a_device_that_is_not_there_is_a_device_error(GoodTracker)
