"""Positions with good status that cannot be: of the axes, and of the target."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from measurement_fixtures import FakeMotion, draw_rows, standing_at, there_and_back
from truepath.measurement import messages
from truepath_drivers import host_clock
from truepath_drivers.transport.modbus_link import DeviceBusy

pytestmark = pytest.mark.usefixtures("clock")

LIES = {
    "far beyond": lambda here: np.add(here, [214748.3648, 0.0, 0.0]),
    "all zero": lambda here: 0.0 * here,
    "65 536 counts off": lambda here: np.add(here, [0.0, 6.5536, 0.0]),
    "no numbers": lambda here: here * np.nan,
}


class LyingMotion(FakeMotion):
    """A controller whose positions may be wrong; it goes where it is sent."""

    lie: Callable[[np.ndarray], np.ndarray] | None = None

    def status(self):
        status = super().status()
        if self.lie is None:
            return status
        return replace(status, position=tuple(self.lie(np.array(status.position))))


@pytest.fixture
def motion():
    return LyingMotion()


@pytest.fixture
def order(order):
    return there_and_back(order, 9)


@pytest.fixture
def running(begin, tracker, motion, journal, calm, order):
    """At 20 mm in a look of a fiftieth of a second."""
    tracker.speed = motion.speed = 4.0
    settings = replace(calm, timeouts=replace(calm.timeouts, beam_s=1.0))
    running = begin(order, settings=settings)
    live = partial(journal.of, messages.LivePoints)
    running.until(lambda: any(p.axes and p.axes[0] > 20.0 for p in live()))
    host_clock.sleep_s(1.2)  # until then it may be the program before
    return running


@pytest.fixture
def until_held(journal):
    def until(*codes):
        journal.wait(lambda: len(journal.faults) >= len(codes), 6.0)
        journal.wait(lambda: journal.states[-1] == "paused", 6.0)
        assert tuple(journal.faults) == codes

    return until


@pytest.mark.fault_row(42)
@pytest.mark.parametrize("lie", LIES)
def test_impossible_positions_hold_and_are_not_kept(running, until_held, motion, lie):
    shown = len(running.told(messages.LivePoints))
    motion.lie = LIES[lie]
    until_held("position-implausible")
    assert "hold" in motion.calls
    running.obey(messages.CellVerb.ABORT)
    running.ended()
    axes = running.run.axis_samples.position_mm
    kept = axes[(axes != 0.0).any(axis=1)][5:]  # behind the approach
    along = (kept - [10.0, 10.0, -10.0]) / [400.0, 300.0, -200.0]
    assert np.ptp(along, axis=1).max() < 0.005
    for points in running.told(messages.LivePoints)[shown:]:
        assert np.ptp((np.array(points.axes) - [10, 10, -10]) / [400, 300, -200]) < 0.01


@pytest.mark.fault_row(42)
def test_one_odd_reading_is_left_out_and_nothing_else(running, motion):
    motion.lie = lambda here: setattr(motion, "lie", None) or here + 100.0
    host_clock.sleep_s(0.3)
    assert (motion.lie, running.faults) == (None, [])
    assert running.states == ["running"]


@pytest.mark.fault_row(42)
def test_an_axis_without_a_plan_follows_no_lone_reading(begin, motion, journal, order):
    """It would be told to stay where the first reading has it."""
    motion.here = np.array([10.0, 10.0, -150.0])
    path = order.commanded
    plane = replace(path, axes=("X", "Y"), position=path.position[:, :2])
    looks = iter([True])
    motion.lie = lambda here: here * ([1, 1, 0] if next(looks, False) else [1, 1, 1])
    begin(replace(order, commanded=plane)).ended()
    assert journal.faults == ["position-implausible"]
    assert "move_to" not in motion.calls


@pytest.mark.fault_row(41)
def test_a_frozen_tracker_is_held(running, until_held, tracker, motion, journal):
    tracker.frozen = True
    until_held("tracker-frozen")
    tracker.frozen, motion.speed, motion.override = False, 40.0, 10.0
    running.obey(messages.CellVerb.RESUME)
    journal.wait(lambda: bool(running.told(messages.LinesDamaged)), 20.0)


@pytest.mark.fault_row(41)
def test_a_tracker_that_stays_but_for_noise_disagrees(running, until_held, tracker):
    tracker.follows = None
    until_held("tracker-disagrees")
    assert running.states[-1] == "paused"


@pytest.mark.fault_row(41)
def test_a_noiseless_stream_rounded_to_a_tenth_is_not_frozen(running, tracker, motion):
    see = tracker._see
    tracker._see = lambda count: np.round(see(count), 1)
    motion.stand("operator")
    host_clock.sleep_s(1.0)  # it stands, and repeats what it shows
    motion.go_on()
    host_clock.sleep_s(1.0)
    assert set(running.faults) <= {"held-at-machine"}


@pytest.mark.parametrize("odd", [np.nan, np.inf, 1e300])
def test_no_place_is_a_lost_beam_whatever_its_status(running, until_held, tracker, odd):
    see = tracker._see
    tracker._see = lambda count: see(count) * odd
    until_held("beam-lost")
    running.obey(messages.CellVerb.ABORT)
    running.ended()
    samples = running.run.tracker
    assert (np.abs(samples.position_mm[samples.status == 0]) < 1e4).all()


@pytest.mark.fault_row(44)
def test_a_watchdogs_hold_bears_the_name_of_its_cause(running, until_held, motion):
    reach = motion._reach
    monitor = running.measurement._monitor

    def is_busy(*_):
        raise DeviceBusy("exception 6")

    quick = replace(monitor.settings, stale_s=0.2)
    monitor.settings = monitor._machine._settings = quick
    motion._reach = is_busy
    host_clock.sleep_s(0.5)
    motion.stand("watchdog")
    motion._reach = reach
    until_held(*["control-busy"] * 2)


def abort_at_fault(measure, journal):
    report = journal.report

    def look(event):
        report(event)
        if isinstance(event, messages.FaultReported):
            measure.running.obey(messages.CellVerb.ABORT)

    journal.report = look


@pytest.fixture
def points(order):
    return standing_at(order, draw_rows(4), 0.03)


@pytest.mark.fault_row(41)
def test_a_repeated_polled_point_is_not_kept(measure, polled, points, motion, journal):
    first = []

    def freeze(asked):
        if asked == 1:
            first.append(motion.here.copy())
        if asked == 4:  # unseen so far
            measure.running.obey(messages.CellVerb.ABORT)

    class Still:
        @property
        def here(self):
            return first[0]

    polled.before, polled.motion = freeze, Still()
    abort_at_fault(measure, journal)
    polled._rng = type("Calm", (), {"normal": lambda *_: np.zeros(3)})()
    _, run = measure(points)
    assert (run.points.row.tolist(), journal.faults) == ([0], ["tracker-frozen"])


@pytest.mark.fault_row(41)
def test_a_polled_point_of_no_number_is_a_lost_beam(measure, polled, points, journal):
    def spoil(asked):
        if asked == 2:
            polled._rng = type("Odd", (), {"normal": lambda *_: np.full(3, np.nan)})()
        if asked > 2:
            measure.running.obey(messages.CellVerb.ABORT)

    polled.before = spoil
    abort_at_fault(measure, journal)
    _, run = measure(points)
    assert (run.points.row.tolist(), journal.faults) == ([0], ["beam-lost"])
