"""A tracker that can search finds a lost target by itself, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.measurement.conftest import FakeTracker, Journal
from tests.measurement.running_measurement import RunningMeasurement, run_measurements

from truepath.files.bundle.run import Run, summarize_run
from truepath.measurement.messages import (
    CellVerb,
    FaultReported,
    LinesDamaged,
    MeasurementOrder,
)
from truepath.measurement.target import target_search
from truepath.measurement.time_limits import EngineSettings, StreamTimeouts
from truepath.motion.configurations import Configurations
from truepath.numerics.rigid import RigidTransform, build_rotation
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import BeamLost, NotHomed, NotOffered
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.tracker import PolledTracker, TargetFinder
from truepath_drivers.interfaces.tracker_records import (
    Clock,
    PointMeasurement,
    TrackerCapabilities,
)

pytestmark = pytest.mark.usefixtures("clock")

TO_TRACKER = RigidTransform(
    build_rotation(np.array([0.02, -0.03, 1.1])), np.array([1500.0, 600.0, 80.0])
)
ELSEWHERE_MM = np.array([0.0, 300.0, 0.0])
SETTINGS = EngineSettings(
    poll_s=0.02,
    confirm_s=30.0,
    progress_s=0.0,
    timeouts=StreamTimeouts(silent_s=30.0, dead_s=60.0, search_s=30.0),
)


@pytest.fixture(autouse=True)
def quick_tries(monkeypatch) -> None:
    monkeypatch.setattr(target_search, "_PAUSE_S", 0.2)


class FindingTracker(FakeTracker, TargetFinder):
    """Follows the reflector of a machine in this process until a test takes it away."""

    def __init__(self, motion) -> None:
        super().__init__()
        self._motion = motion
        self.aimed: list[tuple[float, float]] = []
        self.homed, self.is_mended_by_home = 0, True
        self.failures: list[Exception] = []
        self.finds_another = False
        self._off_mm = np.zeros(3)

    @property
    def place_mm(self) -> np.ndarray:
        return TO_TRACKER.apply(self._motion.here[None])[0]

    def _new(self):
        samples = super()._new()
        places = np.tile(self.place_mm + self._off_mm, (len(samples), 1))
        return replace(samples, position_mm=places)

    def home(self) -> None:
        self.homed += 1
        if self.is_mended_by_home:
            self.refusal = None

    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        self.aimed.append((azimuth_rad, elevation_rad))
        self.beam = False

    def search(self) -> None:
        if self.failures:
            raise self.failures.pop(0)
        self._off_mm = ELSEWHERE_MM if self.finds_another else np.zeros(3)
        self.beam = True


@pytest.fixture
def finder(motion) -> FindingTracker:
    motion.speed = 3.0
    return FindingTracker(motion)


@pytest.fixture
def order(mill, square, tmp_path) -> MeasurementOrder:
    """Return some seconds of motion round a square, 300 mm a second."""
    corners = [[10.0, 10.0, -10], [130, 10, -10], [130, 130, -90], [10, 130, -90]]
    path = replace(
        square,
        position=np.tile(corners, (3, 1)),
        feed_mm_min=np.full(12, 6000.0),
        dwell_s=np.zeros(12),
    )
    file = str(tmp_path / "run.sqlite")
    return MeasurementOrder("lost", file, mill, path, reserve_bytes=0)


@pytest.fixture
def begin(motion, journal) -> Iterator[Callable[..., RunningMeasurement]]:
    with run_measurements(motion, journal) as begin:
        yield lambda tracker, order, settings=SETTINGS: begin(tracker, order, settings)


def wait_until_moving(running: RunningMeasurement) -> None:
    running.wait_for_progress(lambda done: done >= 1)


@pytest.fixture
def finding_polled(motion) -> FindingPolled:
    motion.speed = 2000.0
    return FindingPolled(motion)


def texts(run: Run, kind: str) -> list[str]:
    return [event.text for event in run.events if event.kind == kind]


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = host_clock.now_s() + 25.0
    while not condition():
        assert host_clock.now_s() < deadline_s
        host_clock.sleep_s(0.005)


@pytest.mark.fault_row(9)
def test_a_target_that_is_found_again_needs_nobody_and_its_line_is_driven_again(
    begin, finder, motion, order, journal, measured
):
    running = begin(finder, order)
    wait_until_moving(running)
    finder.failures = [BeamLost("no target near the beam")]
    finder.beam = False
    journal.wait(lambda: "paused" in journal.states)
    place_mm = finder.place_mm
    motion.speed = 5000.0
    run = running.wait_for_run()
    assert journal.states[-1] == "finished"
    assert journal.faults == ["beam-lost"]
    azimuth, elevation = finder.aimed[-1]
    x, y, z = place_mm
    level = np.hypot(x, y)
    assert level * abs(azimuth - np.arctan2(y, x)) < 150.0
    assert level * abs(elevation - np.arctan2(z, level)) < 150.0
    assert len(finder.aimed) == 2
    (failed,), (found,) = texts(run, "search"), texts(run, "found")
    assert "try 1 of 3" in failed
    assert "no target near the beam" in failed
    assert "try 2 of 3" in found
    again = journal.of(LinesDamaged)[0].again
    assert again is not None
    assert len(run.commanded) > len(order.commanded)
    beside_mm = level * abs(azimuth - np.arctan2(y, x))
    measured(f"aimed {beside_mm:.0f} mm beside it, found at try 2")
    assert motion.calls.count("start") == 2
    suffered = summarize_run(run).interruptions
    assert (suffered.searches, suffered.found) == (1, 1)
    assert suffered.breaks >= 1


def test_a_target_that_stays_lost_is_told_with_its_tries_and_waits_for_somebody(
    begin, finder, motion, order, journal
):
    running = begin(finder, order)
    wait_until_moving(running)
    finder.failures = [BeamLost("nothing there") for _ in range(9)]
    finder.beam = False
    journal.wait(lambda: len(journal.faults) == 2)
    told = journal.of(FaultReported)[-1]
    assert told.code == "beam-lost"
    assert "try 3 of 3" in told.text
    assert "Resume" in told.action
    assert len(finder.aimed) == 3
    assert journal.states[-1] == "paused"
    finder.beam = True
    motion.speed = 5000.0
    wait_until(lambda: _resume(running, journal))
    running.wait_for_run()
    assert journal.states[-1] == "finished"


def _resume(running: RunningMeasurement, journal: Journal) -> bool:
    running.measurement.obey(CellVerb.RESUME)
    return journal.states[-1] != "paused"


@pytest.mark.fault_row(9)
def test_another_target_is_never_taken_for_the_lost_one(begin, finder, order, journal):
    running = begin(finder, order)
    wait_until_moving(running)
    finder.finds_another = True
    finder.beam = False
    journal.wait(lambda: len(journal.faults) == 2)
    assert "another one, " in journal.of(FaultReported)[-1].text
    wait_until(lambda: not finder.beam)
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.ABORT)
    assert len(texts(running.wait_for_run(), "search")) == 3


def test_a_device_without_the_verb_is_as_any_other(begin, finder, order, journal):
    running = begin(finder, order)
    wait_until_moving(running)
    finder.failures = [NotOffered("speaks version 1")]
    finder.beam = False
    journal.wait(lambda: "paused" in journal.states)
    wait_until(lambda: not finder.failures)
    host_clock.sleep_s(0.1)  # silence can only be waited for
    assert journal.faults == ["beam-lost"]
    running.measurement.obey(CellVerb.ABORT)
    run = running.wait_for_run()
    assert texts(run, "search") == ["speaks version 1"]


def test_a_beam_that_comes_back_by_itself_waits_for_somebody(
    begin, finder, motion, order, journal
):
    running = begin(finder, order)
    wait_until_moving(running)
    finder.failures = [BeamLost("somebody stands in the beam")]
    finder.beam = False
    wait_until(lambda: not finder.failures)
    finder.beam = True
    motion.speed = 5000.0
    host_clock.sleep_s(0.5)  # the next try would have been by then
    assert journal.states[-1] == "paused"
    assert len(finder.aimed) == 1
    wait_until(lambda: _resume(running, journal))
    running.wait_for_run()
    assert journal.states[-1] == "finished"


def test_a_target_that_is_found_too_late_waits_for_somebody(
    begin, finder, order, journal
):
    timeouts = replace(SETTINGS.timeouts, search_s=0.1)
    running = begin(finder, order, replace(SETTINGS, timeouts=timeouts))
    wait_until_moving(running)
    finder.failures = [BeamLost("nothing there")]
    finder.beam = False
    journal.wait(lambda: len(journal.faults) == 2)
    assert "after 1 tries" in journal.of(FaultReported)[-1].text
    assert len(finder.aimed) == 1
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.ABORT)
    running.wait_for_run()


def test_a_standstill_point_is_measured_again_once_the_target_is_found(
    begin, finder, order, journal, motion
):
    motion.speed = 2000.0
    position = np.random.default_rng(3).uniform([10, 10, -290], [490, 390, -10], (5, 3))
    points = Configurations(("X", "Y", "Z"), position, np.full(5, 6.0))
    running = begin(finder, replace(order, commanded=points))
    wait_until_moving(running)
    finder.beam = False
    run = running.wait_for_run()
    assert journal.states[-1] == "finished"
    assert len(texts(run, "found")) == 1
    rows = [text for text in texts(run, "point") if "until" in text]
    assert len(rows) == 5
    seen = run.tracker.position_mm[run.tracker.status == 0]
    for place in TO_TRACKER.apply(position):
        near = np.linalg.norm(seen - place, axis=1) < 0.1
        assert near.sum() > 5 * 500  # of six seconds, without a gap


class FindingPolled(PolledTracker, TargetFinder):
    """Measures where the machine stands, and loses it at the sixth point."""

    def __init__(self, motion) -> None:
        self._motion, self._asked, self._is_lost = motion, 0, False

    @property
    def capabilities(self) -> TrackerCapabilities:
        return TrackerCapabilities(streams=False, clock=Clock.HOST)

    def connect(self) -> Identity:
        return Identity("Us", "finding polled tracker", "F1", "0")

    def close(self) -> None:
        pass

    def stop(self) -> None:
        pass

    def home(self) -> None:
        pass

    def aim(self, azimuth_rad: float, elevation_rad: float) -> None:
        place = TO_TRACKER.apply(self._motion.here[None])[0]
        x, y, z = place
        assert azimuth_rad == pytest.approx(np.arctan2(y, x), abs=1e-6)
        assert elevation_rad == pytest.approx(np.arctan2(z, np.hypot(x, y)), abs=1e-6)

    def search(self) -> None:
        self._is_lost = False

    def measure(self, dwell_s: float) -> PointMeasurement:
        self._asked += 1
        self._is_lost = self._is_lost or self._asked == 6
        if self._is_lost:
            raise BeamLost("no prism in the field of view")
        place = TO_TRACKER.apply(self._motion.here[None])
        return PointMeasurement.average(np.array([host_clock.now_s()]), place)


def test_a_lost_target_of_a_polled_tracker_is_found_and_its_point_measured(
    begin, finding_polled, order, journal
):
    position = np.random.default_rng(3).uniform([10, 10, -290], [490, 390, -10], (6, 3))
    points = Configurations(("X", "Y", "Z"), position, np.full(6, 0.02))
    settings = replace(SETTINGS, poll_s=0.01, settle_s=0.02)
    running = begin(finding_polled, replace(order, commanded=points), settings)
    run = running.wait_for_run()
    assert journal.states[-1] == "finished"
    assert run.points.row.tolist() == list(range(6))
    assert journal.faults == ["beam-lost"]
    np.testing.assert_allclose(
        run.tracker.position_mm, TO_TRACKER.apply(position), atol=1e-6
    )
    assert summarize_run(run).interruptions.found == 1


def test_a_tracker_that_asks_to_be_homed_is_before_the_first_line(
    begin, finder, motion, order, journal
):
    motion.speed = 5000.0
    finder.refusal = NotHomed("not initialised")
    run = begin(finder, order).wait_for_run()
    assert journal.states == ["running", "finished"]
    assert finder.homed == 1
    assert journal.faults == ["tracker-homed"]
    assert [e.kind for e in run.events].index("tracker-homed") < [
        e.kind for e in run.events
    ].index("start")


def test_a_tracker_that_takes_its_time_to_be_homed_is_not_taken_for_silent(
    begin, finder, motion, order, journal
):
    motion.speed = 5000.0
    finder.refusal = NotHomed("not initialised")

    def home() -> None:
        host_clock.sleep_s(20.0)
        finder.refusal = None

    finder.home = home
    patience = StreamTimeouts(silent_s=15.0, dead_s=18.0, late_s=1000.0)
    settings = replace(SETTINGS, timeouts=patience)
    begin(finder, order, settings).wait_for_run()
    assert journal.states == ["running", "finished"]
    assert journal.faults == ["tracker-homed"]


def test_a_tracker_that_homing_does_not_mend_is_refused_before_the_first_line(
    begin, finder, motion, order, journal
):
    finder.refusal, finder.is_mended_by_home = NotHomed("not initialised"), False
    motion.speed = 5000.0
    begin(finder, order).wait_for_run()
    assert journal.states[-1] == "failed"
    assert finder.homed == 1
    assert "start" not in motion.calls
