"""Positions with good status that cannot be: of the axes, and of the target."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.measurement.conftest import FakeMotion
from tests.measurement.test_polled_points import (  # noqa: F401
    FakePolled,
    measure,
    polled,
)

from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import (
    CellVerb,
    FaultReported,
    LinesDamaged,
    LivePoints,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.run_file.run_reading import open_run
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.transport.modbus_link import DeviceBusy

pytestmark = pytest.mark.usefixtures("clock")

Lie = Callable[[np.ndarray], np.ndarray]
LIES: dict[str, Lie] = {
    "far beyond": lambda here: np.add(here, [214748.3648, 0.0, 0.0]),
    "all zero": lambda here: 0.0 * here,
    "65 536 counts off": lambda here: np.add(here, [0.0, 6.5536, 0.0]),
    "no numbers": lambda here: here * np.nan,
}


class LyingMotion(FakeMotion):
    """A controller whose positions may be wrong; it goes where it is sent."""

    lie: Lie | None = None

    def status(self):
        status = super().status()
        if self.lie is None:
            return status
        return replace(status, position=tuple(self.lie(np.array(status.position))))


@pytest.fixture
def motion() -> LyingMotion:
    return LyingMotion()


@pytest.fixture
def order(mill, square, tmp_path) -> MeasurementOrder:
    position = np.tile([[10.0, 10.0, -10.0], [410.0, 310.0, -210.0]], (9, 1))
    n = len(position)
    path = replace(
        square,
        position=position,
        feed_mm_min=np.full(n, 6000.0),
        dwell_s=np.zeros(n),
    )
    file = str(tmp_path / "odd.sqlite")
    return MeasurementOrder("odd", file, mill, path, reserve_bytes=0)


class Running:
    """A measurement whose path has begun a while ago."""

    def __init__(self, begun, journal, order) -> None:
        self.begun, self.journal, self.order = begun, journal, order

    def until(self, *codes: str) -> None:
        """Wait until the feed is held and these codes were told, within seconds."""
        self.journal.wait(lambda: len(self.journal.faults) >= len(codes), 6.0)
        self.journal.wait(lambda: self.journal.states[-1] == "paused", 6.0)
        assert tuple(self.journal.faults) == codes

    def end(self) -> None:
        self.begun.obey(CellVerb.ABORT)
        self.journal.wait(lambda: bool(self.journal.of(RunClosed)))

    @property
    def run(self):
        return open_run(self.order.run_file)


@pytest.fixture
def running(tracker, motion, journal, calm, order):
    """At 20 mm in a look of a fiftieth of a second."""
    tracker.speed = motion.speed = 4.0
    devices = {"tracker": tracker.connect(), "motion": motion.connect()}
    settings = replace(calm, timeouts=replace(calm.timeouts, beam_s=1.0))
    begun = Measurement(order, tracker, motion, devices, journal.report, settings)
    thread = threading.Thread(target=begun.run)
    thread.start()
    journal.wait(
        lambda: any(p.axes and p.axes[0] > 20.0 for p in journal.of(LivePoints))
    )
    host_clock.sleep_s(1.2)  # until then it may be the program before
    yield Running(begun, journal, order)
    if thread.is_alive():
        begun.obey(CellVerb.ABORT)
        host_clock.join(thread, 5.0)


@pytest.mark.fault_row(42)
@pytest.mark.parametrize("lie", LIES)
def test_positions_that_cannot_be_hold_the_feed_and_are_nowhere_kept(
    running, motion, journal, lie
):
    shown = len(journal.of(LivePoints))
    motion.lie = LIES[lie]
    running.until("position-implausible")
    assert "hold" in motion.calls
    running.end()
    axes = running.run.axis_samples.position_mm
    kept = axes[(axes != 0.0).any(axis=1)][5:]  # behind the approach
    along = (kept - [10.0, 10.0, -10.0]) / [400.0, 300.0, -200.0]
    assert np.ptp(along, axis=1).max() < 0.005
    for points in journal.of(LivePoints)[shown:]:
        assert np.ptp((np.array(points.axes) - [10, 10, -10]) / [400, 300, -200]) < 0.01


@pytest.mark.fault_row(42)
def test_one_odd_reading_is_left_out_and_nothing_else(running, motion, journal):
    motion.lie = lambda here: setattr(motion, "lie", None) or here + 100.0
    host_clock.sleep_s(0.3)
    assert (motion.lie, journal.faults) == (None, [])
    assert journal.states == ["running"]


@pytest.mark.fault_row(42)
def test_an_axis_that_the_plan_does_not_name_is_not_sent_to_a_moments_reading(
    tracker, motion, journal, calm, order
):
    """It would be told to stay where the first reading has it."""
    motion.here = np.array([10.0, 10.0, -150.0])
    path = order.commanded
    plane = replace(path, axes=("X", "Y"), position=path.position[:, :2])
    looks = iter([True])
    motion.lie = lambda here: here * ([1, 1, 0] if next(looks, False) else [1, 1, 1])
    devices = {"tracker": tracker.connect(), "motion": motion.connect()}
    order = replace(order, commanded=plane)
    measurement = Measurement(order, tracker, motion, devices, journal.report, calm)
    measurement.run()
    assert journal.faults == ["position-implausible"]
    assert "move_to" not in motion.calls


@pytest.mark.fault_row(41)
def test_a_tracker_frozen_bit_for_bit_holds_and_its_lines_are_driven_again(
    running, tracker, motion, journal
):
    tracker.frozen = True
    running.until("tracker-frozen")
    tracker.frozen, motion.speed, motion.override = False, 40.0, 10.0
    running.begun.obey(CellVerb.RESUME)
    journal.wait(lambda: bool(journal.of(LinesDamaged)), 20.0)


@pytest.mark.fault_row(41)
def test_a_tracker_that_stays_where_it_was_but_for_noise_disagrees(running, tracker):
    tracker.follows = None
    running.until("tracker-disagrees")


@pytest.mark.fault_row(41)
def test_a_stream_rounded_to_a_tenth_without_noise_is_not_frozen(
    running, tracker, motion, journal
):
    see = tracker._see
    tracker._see = lambda count: np.round(see(count), 1)
    motion.stand("operator")
    host_clock.sleep_s(1.0)  # it stands, and repeats what it shows
    motion.go_on()
    host_clock.sleep_s(1.0)
    assert set(journal.faults) <= {"held-at-machine"}


@pytest.mark.parametrize("odd", [np.nan, np.inf, 1e300])
def test_what_is_no_place_is_a_lost_beam_whatever_its_status(running, tracker, odd):
    see = tracker._see
    tracker._see = lambda count: see(count) * odd
    running.until("beam-lost")
    running.end()
    samples = running.run.tracker
    assert (np.abs(samples.position_mm[samples.status == 0]) < 1e4).all()


@pytest.mark.fault_row(44)
def test_a_hold_of_the_watchdog_bears_the_name_of_what_kept_the_beats_away(
    running, motion, journal
):
    reach = motion._reach
    monitor = running.begun._monitor

    def is_busy() -> None:
        raise DeviceBusy("exception 6")

    monitor.settings = monitor._machine._settings = replace(
        monitor.settings, stale_s=0.2
    )
    motion._reach = is_busy
    host_clock.sleep_s(0.5)
    motion.stand("watchdog")
    motion._reach = reach
    running.until(*["control-busy"] * 2)


def abort_at_fault(measure, journal) -> None:  # noqa: F811
    report = journal.report

    def look(event) -> None:
        report(event)
        if isinstance(event, FaultReported):
            measure.measurement.obey(CellVerb.ABORT)

    journal.report = look


@pytest.fixture
def points(order) -> MeasurementOrder:
    rng = np.random.default_rng(3)
    position = rng.uniform([10, 10, -290], [490, 390, -10], (4, 3))
    return replace(
        order,
        commanded=Configurations(("X", "Y", "Z"), position, np.full(4, 0.03)),
    )


@pytest.mark.fault_row(41)
def test_a_polled_tracker_that_repeats_a_point_is_held_and_it_is_not_stored(
    measure,  # noqa: F811
    polled,  # noqa: F811
    points,
    motion,
    journal,
):
    first: list[np.ndarray] = []

    def freeze(asked: int) -> None:
        if asked == 1:
            first.append(motion.here.copy())
        if asked == 4:  # unseen so far
            measure.measurement.obey(CellVerb.ABORT)

    class Still:
        @property
        def here(self) -> np.ndarray:
            return first[0]

    polled.before, polled.motion = freeze, Still()
    abort_at_fault(measure, journal)
    polled._rng = type("Calm", (), {"normal": lambda *_: np.zeros(3)})()
    _, run = measure(points)
    assert run.points.row.tolist() == [0]
    codes = [fault.code for fault in journal.of(FaultReported)]
    assert codes == ["tracker-frozen"]


@pytest.mark.fault_row(41)
def test_a_polled_point_without_a_number_is_a_lost_beam(
    measure,  # noqa: F811
    polled,  # noqa: F811
    points,
    journal,
):
    def spoil(asked: int) -> None:
        if asked == 2:
            polled._rng = type("Odd", (), {"normal": lambda *_: np.full(3, np.nan)})()
        if asked > 2:
            measure.measurement.obey(CellVerb.ABORT)

    polled.before = spoil
    abort_at_fault(measure, journal)
    _, run = measure(points)
    assert run.points.row.tolist() == [0]
    assert journal.faults == ["beam-lost"]


def test_samples_of_a_block_that_are_nowhere_are_lost_and_the_others_good():
    position = np.array([[1.0, 2.0, 3.0], [np.nan, 2.0, 3.0], [1e300, 2.0, 3.0]])
    block = TrackerSamples(
        np.arange(3), 0.002 * np.arange(3), position, np.zeros(3, int)
    )
    assert (block.status == 0).tolist() == [True, False, False]
