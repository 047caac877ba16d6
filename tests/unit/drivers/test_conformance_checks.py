"""The checks of conformance let what keeps everything pass, and catch the others."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from measurement_fixtures import FakeMotion
from truepath_drivers import host_clock
from truepath_drivers.conformance import checking, motion, thermometers, tracker
from truepath_drivers.conformance.checking import NotConforming, on_terms
from truepath_drivers.interfaces import errors, records
from truepath_drivers.interfaces.records import Identity, MotionState, MotionStatus
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers
from truepath_drivers.interfaces.tracker import Tracker


class GoodTracker(Tracker):
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
            raise errors.Refused("no")
        self.streams = True

    def stop(self) -> None:
        self.streams = False

    def read(self, timeout_s: float) -> records.TrackerSamples:
        self.need_connection()
        if not self.streams:
            return records.TrackerSamples.empty()
        number = self.number + np.arange(10)
        self.number += 10
        place, status = self.place + self.measure(number), np.full(10, self.status)
        return records.TrackerSamples(number, self.stamp(number), place, status)

    def measure(self, number):
        return 1e-3 * np.random.default_rng(int(number[0])).normal(size=(10, 3))

    def stamp(self, number):
        return number * 2e-3

    def need_connection(self) -> None:
        if not self.connected:
            raise errors.ConnectionLost("connect first")


class GoodController(FakeMotion):
    watches = counts_lines = ends = True
    feeds = blocked = connected = False  # feeds: piece by piece
    first_line = 0
    brakes = 0.0

    def __init__(self) -> None:
        super().__init__(speed=1.0)
        self.fed_s = 0.0

    def connect(self) -> Identity:
        self.connected = True
        self.has_watchdog, self.stops_unasked = not self.feeds, self.feeds
        return super().connect()

    def close(self) -> None:
        super().close()
        self.connected = False

    def status(self) -> MotionStatus:
        if not self.connected:
            raise errors.ConnectionLost("connect first")
        if self.blocked:
            raise errors.DeviceTimeout("no answer")
        silent_s = host_clock.now_s() - self.fed_s
        if self.feeds and self.ends and silent_s > 1.0:
            self._since_s += silent_s - 1.0  # it stands since
        elif self.watches and silent_s > 0.1:
            self.stand("watchdog")
        status = super().status()
        if status.state is MotionState.HELD:
            self.here = self.here + self.brakes
        return replace(status, line=self.first_line + status.line * self.counts_lines)

    def move_to(self, position, feed_mm_min) -> None:
        self.need_able()
        self.check(np.atleast_2d(position))
        super().move_to(position, feed_mm_min)

    def load(self, path) -> None:
        self.status()
        if path.axes != self.axes:
            raise errors.Refused("other axes")
        self.check(path.position)
        super().load(path)

    def check(self, rows) -> None:
        low, high = np.array(self.travel).T
        if not ((rows >= low) & (rows <= high)).all():
            raise errors.OutOfTravel("beyond")

    def start(self) -> None:
        self.need_able()
        if self.loaded is None:
            raise errors.Refused("no path")
        super().start()

    def go_on(self) -> None:
        self.fed_s = host_clock.now_s()
        super().go_on()

    def send_heartbeat(self) -> None:
        super().send_heartbeat()
        self.fed_s = host_clock.now_s()

    def need_able(self) -> None:
        if self.status().state in records.UNABLE:
            raise errors.MotionFault(self.alarm)

    def wait(self, timeout_s) -> MotionStatus:
        end_s = host_clock.now_s() + timeout_s
        while self.status().state is MotionState.RUNNING:
            if host_clock.now_s() > end_s:
                raise errors.DeviceTimeout("still runs")
            self.send_heartbeat()
            host_clock.sleep_s(0.05)
        self.need_able()
        return self.status()


def share_machine(make):
    """A factory whose drivers move one and the same machine."""
    machine = make()

    def share() -> GoodController:
        controller = make()
        controller.__dict__ = machine.__dict__
        return controller

    return share


@pytest.mark.parametrize("check", tracker.TRACKER_CHECKS)
def test_a_good_tracker_passes(clock, check):
    check(GoodTracker)


COUNTER = itertools.count()


def begin_clock_anew(self, timeout_s):
    block = GoodTracker.read(self, timeout_s)
    return replace(block, device_time_s=block.device_time_s % 0.02)


def turn_round(self, timeout_s):
    return GoodTracker.read(self, timeout_s).select(slice(None, None, -1))


def say_twice(self, timeout_s):
    return GoodTracker.read(self, timeout_s).select(np.repeat(np.arange(10), 2))


def double(self, number):
    return np.repeat(GoodTracker.measure(self, number)[::2], 2, axis=0)


def repeat_tenth(self, number):
    place = GoodTracker.measure(self, number)
    place[5] = place[4]
    return place


def round_roughly(self, number):
    return np.rint(GoodTracker.measure(self, number) / 2e-3) * 2e-3


def test_a_rough_resolution_is_no_repetition(clock):
    make = type("Rough", (GoodTracker,), {"measure": round_roughly})
    tracker.each_sample_is_measured_anew(make)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (turn_round, "number 8 at index 1 after 9: out of order"),
        (say_twice, "number 0 at index 1 is doubled"),
        (begin_clock_anew, "time 0 at index 10 after 0.018: out of order"),
    ],
)
def test_what_does_not_rise_is_named(clock, read, said):
    make = type("Falling", (GoodTracker,), {"read": read})
    with pytest.raises(NotConforming, match=f"s do not rise: {said}$"):
        tracker.samples_have_rising_numbers_and_times(make)


def count_all(self):
    return records.LinkHealth(crc_errors=self.number)


def move_unasked(self):
    self.here = np.add(self.here, [1.0, 1.0, -1.0])


def always(value):
    return property(lambda self: value, lambda self, _: None)


def does(value=None):
    return lambda self, *_: value


def time_out(self, timeout_s):
    raise errors.DeviceTimeout("still runs")


STANDS = MotionStatus(MotionState.IDLE, (0.0, 0.0, 0.0), 0)
TWICE = checking.connect_twice_is_one_connection
TIMES = tracker.times_are_those_of_the_samples
FAULTY_TRACKERS = [
    (checking.connect_tells_who_answers, "connect", does(Identity("", "", "", ""))),
    (TWICE, "connect", lambda self: Identity("a", "b", str(next(COUNTER)), "d")),
    (tracker.silence_is_an_empty_block_in_time, "streams", always(True)),
    (tracker.samples_have_rising_numbers_and_times, "number", always(0)),
    (tracker.numbers_go_on_after_a_pause, "read", begin_clock_anew),
    (TIMES, "stamp", lambda self, n: n * 2.0),  # ms
    # Half the rate; arrival, in blocks of ten; one of 50 lost, the rest counted.
    (TIMES, "stamp", lambda self, n: n * 4e-3),
    (TIMES, "stamp", lambda self, n: (n // 10) * 20e-3 + (n % 10) * 1e-6),
    (TIMES, "stamp", lambda self, n: 2e-3 * (n + n // 49)),
    (tracker.a_target_at_rest_is_valid_and_in_mm, "place", 1.5),
    (tracker.a_target_at_rest_is_valid_and_in_mm, "status", 4),
    (tracker.a_target_at_rest_is_valid_and_in_mm, "place", 0.0),
    (tracker.samples_have_rising_numbers_and_times, "place", math.nan),
    (tracker.samples_have_rising_numbers_and_times, "read", turn_round),
    (tracker.samples_have_rising_numbers_and_times, "read", say_twice),
    (tracker.each_sample_is_measured_anew, "measure", does(np.zeros((10, 3)))),
    (tracker.each_sample_is_measured_anew, "measure", double),
    (tracker.each_sample_is_measured_anew, "measure", repeat_tenth),
    (tracker.health_counts_damage_alone, "health", property(count_all)),
    (tracker.impossible_rates_are_refused, "start", does()),
    (tracker.a_closed_tracker_has_no_samples, "need_connection", does()),
    (tracker.stop_from_another_thread_ends_the_stream, "stop", does()),
]
TOLD = {
    "hold": "^state after hold twice: expected held, found finished$",
    "load": "^state after load: expected ready, found idle$|^load of axes",
    "abort": "^state after abort: expected aborted, found finished$",
    "close": "in motion and connect: expected aborted or held, found finished$",
    "check": r"^move_to \[.*\]: expected OutOfTravel, found no error$",
}
FAULTY_CONTROLLERS = [
    (motion.hold_and_resume_are_absolute, "wait", time_out),
    (motion.axes_and_travel_are_known, "travel", ((5.0, 5.0),) * 3),
    (motion.axes_and_travel_are_known, "axes", ()),
    (motion.out_of_travel_is_refused, "check", does()),
    (motion.a_path_of_other_axes_is_refused, "load", does()),
    (motion.hold_and_resume_are_absolute, "hold", does()),
    (motion.resume_of_nothing_does_nothing, "resume", move_unasked),
    (motion.resume_of_nothing_does_nothing, "resume", lambda m: m.loaded and m.start()),
    (motion.abort_from_another_thread_ends_the_motion, "abort", does()),
    (motion.wait_ends_in_time, "wait", does(STANDS)),
    (motion.hold_means_standstill, "brakes", 0.2),
    (motion.the_line_is_the_row_moved_towards, "first_line", 1),
    (motion.the_line_is_the_row_moved_towards, "counts_lines", False),
    (motion.a_claimed_watchdog_holds_the_feed, "watches", False),
    (motion.close_stops_the_motion, "close", does()),
    (motion.a_closed_controller_moves_nothing, "status", does(STANDS)),
    (motion.a_move_ends_where_it_was_sent, "move_to", does()),
    (motion.a_path_runs_to_its_last_row, "load", does()),
]


def bring(state):
    def provoke(machine):
        machine._state, machine.alarm = MotionState(state), "as provoked"

    return provoke


def block(machine):
    machine.blocked = True


PROVOKES = bring("alarm"), bring("door"), bring("unhomed"), does(), block
TROUBLES = dict(zip(motion.PROVOKED_CHECKS, PROVOKES, strict=True))
ALARM, DOOR, UNHOMED, LOST, BLOCKED = motion.PROVOKED_CHECKS


def run_again(self):
    """Send the start again, since its reply was lost."""
    status = GoodController.status(self)
    if status.state is MotionState.FINISHED and self.loaded is not None:
        self.here = self.here + 0.1
    return status


def fall_back(self):
    status = GoodController.status(self)
    running = status.state is MotionState.RUNNING
    return replace(status, line=-self.beats) if running else status


def tell(**changes):
    return lambda self: replace(GoodController.status(self), **changes)


def mistake(self):
    status = GoodController.status(self)
    door = status.state is MotionState.DOOR
    return replace(status, state=MotionState.ALARM) if door else status


def take_time(self):
    host_clock.sleep_s(10.0)
    return GoodController.status(self)


FAULTY_IN_TROUBLE = [
    (ALARM, "status", tell(state=MotionState.IDLE)),
    (ALARM, "status", tell(alarm="")),
    (ALARM, "need_able", does()),
    (DOOR, "status", mistake),
    (UNHOMED, "need_able", does()),
    (LOST, "status", run_again),
    (LOST, "status", fall_back),
    (BLOCKED, "status", does(STANDS)),
    (BLOCKED, "status", take_time),
]


def with_fault(base, name, fault):
    return type("Faulty", (base,), {name: fault} if name else {})


@pytest.mark.parametrize(("check", "name", "fault"), FAULTY_TRACKERS)
def test_a_faulty_tracker_is_caught(clock, check, name, fault):
    with pytest.raises(NotConforming):
        check(with_fault(GoodTracker, name, fault))


def do(check, make):
    provoke = [lambda: TROUBLES[check](make())] if check in TROUBLES else []
    check(make, *provoke)


@pytest.mark.parametrize("check", [*motion.MOTION_CHECKS, *motion.PROVOKED_CHECKS])
def test_a_good_controller_passes_and_moves_no_farther_than_said(clock, check):
    start = np.array([100.0, 200.0, -100.0])
    accepted = [start]

    class Watched(GoodController):
        def check(self, rows) -> None:
            super().check(rows)
            accepted.extend(rows)

    make = share_machine(Watched)
    make().here = start
    do(check, make)
    assert np.abs(np.array(accepted) - start).max() <= motion.REACH


@pytest.mark.parametrize(
    ("check", "name", "fault"), [*FAULTY_CONTROLLERS, *FAULTY_IN_TROUBLE]
)
def test_a_faulty_controller_is_caught_and_told_what_was_found(
    clock, check, name, fault
):
    make, said = share_machine(with_fault(GoodController, name, fault)), TOLD.get(name)
    if fault is time_out:
        said = "^state after hold twice: expected held, but wait raised .*still runs"
    with on_terms(watchdog_s=0.3), pytest.raises(NotConforming, match=said):
        do(check, make)


def test_a_motion_that_goes_on_unasked_is_caught(clock):
    kind = type("Fed", (GoodController,), {"feeds": True, "watches": False})
    motion.a_motion_that_nobody_asks_for_ends(share_machine(kind))
    make = share_machine(with_fault(kind, "ends", False))
    with pytest.raises(NotConforming, match="nobody asked"):
        motion.a_motion_that_nobody_asks_for_ends(make)


def test_what_is_left_open_or_answers_where_none_is_is_caught(clock, tmp_path):
    left = []

    def leave_open(self):
        left.append((tmp_path / "port").open("w"))

    leaves = with_fault(GoodTracker, "connect", leave_open)
    with pytest.raises(NotConforming, match="left a file or a thread behind"):
        checking.close_is_idempotent_and_leaves_nothing(leaves)
    opens = with_fault(GoodTracker, "__init__", leave_open)
    with pytest.raises(NotConforming, match="constructor opened something"):
        checking.construction_opens_nothing(opens)
    for file in left:
        file.close()
    with pytest.raises(NotConforming, match="not there"):
        checking.a_device_that_is_not_there_is_a_device_error(GoodTracker)


class GoodThermometers(Thermometers):
    channels = (Channel("X_degC"),)
    period_s = 0.01
    is_open = False

    def connect(self):
        self.is_open = True
        return Identity("Us", "in memory", "", "")

    def close(self):
        self.is_open = False

    def read(self):
        if not self.is_open:
            raise errors.ConnectionLost("connect first")
        return self.show()

    def show(self, value=20.0, fault="", name="X_degC", time_s=None):
        time_s = host_clock.now_s() if time_s is None else time_s
        return (Reading(name, time_s, value, fault),)


def shows(*given):
    return lambda self: GoodThermometers.show(self, *given)


def show_wall_time(self):
    return GoodThermometers.show(self, time_s=host_clock.wall_s())


def read_late(self):
    host_clock.sleep_s(4.5)
    return GoodThermometers.read(self)


FAULTY_THERMOMETERS = {
    "name-twice": ("channels", (Channel("X_degC"),) * 2),
    "reads-closed": ("read", GoodThermometers.show),
    "wall-clock": ("show", show_wall_time),
    "frozen-stamp": ("show", shows(20.0, "", "X_degC", 0.0)),
    "kelvin": ("show", shows(293.15)),
    "old-value-with-a-fault": ("show", shows(20.0, "no answer")),
    "silent-nan": ("show", shows(math.nan)),
    "other-channel": ("show", shows(20.0, "", "Y_degC")),
    "never-reads": ("show", does(())),
    "hangs": ("read", read_late),
    "": ("", None),
}


@pytest.mark.parametrize("wrong", FAULTY_THERMOMETERS)
def test_the_checks_catch_wrong_thermometers_and_let_right_ones_pass(clock, wrong):
    kind, caught = with_fault(GoodThermometers, *FAULTY_THERMOMETERS[wrong]), []
    with on_terms(patience_s=0.1):
        for check in thermometers.THERMOMETER_CHECKS:
            try:
                check(kind)
            except NotConforming:
                caught.append(check.__name__)
    assert bool(caught) == bool(wrong)
