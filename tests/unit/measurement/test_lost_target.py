"""A tracker that can search finds a lost target by itself, and nothing else.

Where it should be is known from where it was seen.
"""

from dataclasses import replace

import numpy as np
import pytest

import measurement_fixtures
from truepath.files.bundle.run import summarize_run
from truepath.measurement import target as target_search
from truepath.measurement.messages import CellVerb, LinesDamaged
from truepath.measurement.target import ObservedPoints
from truepath.measurement.time_limits import EngineSettings, StreamTimeouts
from truepath.numerics.rigid import RigidTransform, build_rotation
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import BeamLost, NotHomed, NotOffered
from truepath_drivers.interfaces.tracker import TargetFinder
from truepath_drivers.interfaces.tracker_records import PointMeasurement

pytestmark = pytest.mark.usefixtures("clock")

TURN = build_rotation(np.array([0.02, -0.03, 1.1]))
TO_TRACKER = RigidTransform(TURN, np.array([1500.0, 600.0, 80.0]))
ELSEWHERE_MM = np.array([0.0, 300.0, 0.0])
WAITS = StreamTimeouts(silent_s=30.0, dead_s=60.0, search_s=30.0)
SETTINGS = EngineSettings(poll_s=0.02, confirm_s=30.0, progress_s=0.0, timeouts=WAITS)


@pytest.fixture(autouse=True)
def quick_tries(monkeypatch):
    monkeypatch.setattr(target_search, "_PAUSE_S", 0.2)


class FindingTracker(measurement_fixtures.FakeTracker, TargetFinder):
    """Follows the reflector of a machine in this process until a test takes it away."""

    def __init__(self, motion):
        super().__init__()
        self._motion = motion
        self.aimed = []
        self.homed, self.is_mended_by_home = 0, True
        self.failures = []
        self.finds_another = False
        self._off_mm = np.zeros(3)

    @property
    def place_mm(self):
        return TO_TRACKER.apply(self._motion.here[None])[0]

    def _new(self):
        samples = super()._new()
        places = np.tile(self.place_mm + self._off_mm, (len(samples), 1))
        return replace(samples, position_mm=places)

    def home(self):
        self.homed += 1
        if self.is_mended_by_home:
            self.refusal = None

    def aim(self, azimuth_rad, elevation_rad):
        self.aimed.append((azimuth_rad, elevation_rad))
        self.beam = False

    def search(self):
        if self.failures:
            raise self.failures.pop(0)
        self._off_mm = ELSEWHERE_MM if self.finds_another else np.zeros(3)
        self.beam = True


@pytest.fixture
def tracker(motion):
    motion.speed = 3.0
    return FindingTracker(motion)


@pytest.fixture
def calm():
    return SETTINGS


@pytest.fixture
def order(order):
    """Return some seconds of motion round a square, 300 mm a second."""
    corners = [[10.0, 10.0, -10], [130, 10, -10], [130, 130, -90], [10, 130, -90]]
    return measurement_fixtures.along(order, corners * 3)


@pytest.fixture
def moving(begin, order):
    running = begin(order)
    running.until_done()
    return running


def until_resumed(running):
    def resume():
        running.obey(CellVerb.RESUME)
        return running.journal.states[-1] != "paused"

    running.pass_until(resume)
    assert running.ended() == "finished"


@pytest.mark.fault_row(9)
def test_a_target_found_again_needs_nobody(moving, tracker, motion, order, measured):
    tracker.failures = [BeamLost("no target near the beam")]
    tracker.beam = False
    moving.until(lambda: "paused" in moving.states)
    place_mm = tracker.place_mm
    motion.speed = 5000.0
    assert moving.ended() == "finished"
    run = moving.run
    assert moving.faults == ["beam-lost"]
    azimuth, elevation = tracker.aimed[-1]
    x, y, z = place_mm
    level = np.hypot(x, y)
    beside_mm = level * abs(azimuth - np.arctan2(y, x))
    assert beside_mm < 150.0
    assert level * abs(elevation - np.arctan2(z, level)) < 150.0
    assert len(tracker.aimed) == 2
    (failed,), (found,) = moving.texts("search"), moving.texts("found")
    assert "try 1 of 3" in failed
    assert "no target near the beam" in failed
    assert "try 2 of 3" in found
    assert moving.told(LinesDamaged)[0].again is not None
    assert len(run.commanded) > len(order.commanded)
    measured(f"aimed {beside_mm:.0f} mm beside it, found at try 2")
    assert motion.calls.count("start") == 2
    suffered = summarize_run(run).interruptions
    assert (suffered.searches, suffered.found) == (1, 1)
    assert suffered.breaks >= 1


def lose(running, tracker, *failures):
    """Lose the target until two faults are told: it is lost, and is not found."""
    tracker.failures, tracker.beam = list(failures), False
    running.until(lambda: len(running.faults) == 2)


def test_a_target_that_stays_lost_is_told_with_its_tries(moving, tracker, motion):
    lose(moving, tracker, *[BeamLost("nothing there")] * 9)
    told = moving.fault
    assert told.code == "beam-lost"
    assert "try 3 of 3" in told.text
    assert "Resume" in told.action
    assert (len(tracker.aimed), moving.states[-1]) == (3, "paused")
    tracker.beam = True
    motion.speed = 5000.0
    until_resumed(moving)


@pytest.mark.fault_row(9)
def test_another_target_is_never_taken_for_the_lost_one(moving, tracker):
    tracker.finds_another = True
    lose(moving, tracker)
    assert "another one, " in moving.fault.text
    moving.pass_until(lambda: not tracker.beam)
    assert moving.states[-1] == "paused"
    moving.obey(CellVerb.ABORT)
    moving.ended()
    assert len(moving.texts("search")) == 3


def test_a_device_without_the_verb_is_as_any_other(moving, tracker):
    tracker.failures, tracker.beam = [NotOffered("speaks version 1")], False
    moving.until(lambda: "paused" in moving.states)
    moving.pass_until(lambda: not tracker.failures)
    host_clock.sleep_s(0.1)  # silence can only be waited for
    assert moving.faults == ["beam-lost"]
    moving.obey(CellVerb.ABORT)
    moving.ended()
    assert moving.texts("search") == ["speaks version 1"]


def test_a_beam_that_comes_back_by_itself_waits_for_somebody(moving, tracker, motion):
    tracker.failures = [BeamLost("somebody stands in the beam")]
    tracker.beam = False
    moving.pass_until(lambda: not tracker.failures)
    tracker.beam = True
    motion.speed = 5000.0
    host_clock.sleep_s(0.5)  # the next try would have been by then
    assert (moving.states[-1], len(tracker.aimed)) == ("paused", 1)
    until_resumed(moving)


def test_a_target_that_is_found_too_late_waits_for_somebody(begin, tracker, order):
    timeouts = replace(SETTINGS.timeouts, search_s=0.1)
    running = begin(order, settings=replace(SETTINGS, timeouts=timeouts))
    running.until_done()
    lose(running, tracker, BeamLost("nothing there"))
    assert "after 1 tries" in running.fault.text
    assert (len(tracker.aimed), running.states[-1]) == (1, "paused")


def test_a_point_is_measured_again_once_it_is_found(begin, tracker, order, motion):
    motion.speed = 2000.0
    position = measurement_fixtures.draw_rows(5)
    running = begin(measurement_fixtures.standing_at(order, position, 6.0))
    running.until_done()
    tracker.beam = False
    assert (running.ended(), len(running.texts("found"))) == ("finished", 1)
    rows = [text for text in running.texts("point") if "until" in text]
    run = running.run
    assert len(rows) == 5
    seen = run.tracker.position_mm[run.tracker.status == 0]
    for place in TO_TRACKER.apply(position):
        near = np.linalg.norm(seen - place, axis=1) < 0.1
        assert near.sum() > 5 * 500  # of six seconds, without a gap


class FindingPolled(measurement_fixtures.FakePolledTracker, TargetFinder):
    """Measures where the machine stands, and loses it at the sixth point."""

    def __init__(self, motion):
        self._motion, self._asked, self._is_lost = motion, 0, False

    def home(self):
        pass

    def aim(self, azimuth_rad, elevation_rad):
        x, y, z = TO_TRACKER.apply(self._motion.here[None])[0]
        assert azimuth_rad == pytest.approx(np.arctan2(y, x), abs=1e-6)
        assert elevation_rad == pytest.approx(np.arctan2(z, np.hypot(x, y)), abs=1e-6)

    def search(self):
        self._is_lost = False

    def measure(self, dwell_s):
        self._asked += 1
        self._is_lost = self._is_lost or self._asked == 6
        if self._is_lost:
            raise BeamLost("no prism in the field of view")
        place = TO_TRACKER.apply(self._motion.here[None])
        return PointMeasurement.average(np.array([host_clock.now_s()]), place)


def test_a_polled_tracker_finds_its_target_and_measures_the_point(begin, motion, order):
    motion.speed, position = 2000.0, measurement_fixtures.draw_rows(6)
    settings = replace(SETTINGS, poll_s=0.01, settle_s=0.02)
    points = measurement_fixtures.standing_at(order, position, 0.02)
    running = begin(points, tracker=FindingPolled(motion), settings=settings)
    assert running.ended() == "finished"
    run = running.run
    assert (run.points.row.tolist(), running.faults) == (list(range(6)), ["beam-lost"])
    places = TO_TRACKER.apply(position)
    np.testing.assert_allclose(run.tracker.position_mm, places, atol=1e-6)
    assert summarize_run(run).interruptions.found == 1


def test_a_tracker_is_homed_before_the_first_line(begin, tracker, motion, order):
    motion.speed = 5000.0
    tracker.refusal, home = NotHomed("not initialised"), tracker.home

    def home_slowly():
        host_clock.sleep_s(20.0)
        home()

    tracker.home = home_slowly
    patience = StreamTimeouts(silent_s=15.0, dead_s=18.0, late_s=1000.0)
    running = begin(order, settings=replace(SETTINGS, timeouts=patience))
    running.ended()
    assert (running.states, tracker.homed) == (["running", "finished"], 1)
    assert running.faults == ["tracker-homed"]
    kinds = [event.kind for event in running.run.events]
    assert kinds.index("tracker-homed") < kinds.index("start")


def test_a_tracker_that_homing_does_not_mend_is_refused(begin, tracker, motion, order):
    tracker.refusal, tracker.is_mended_by_home = NotHomed("not initialised"), False
    motion.speed = 5000.0
    assert (begin(order).ended(), tracker.homed) == ("failed", 1)
    assert "start" not in motion.calls


def test_of_one_line_is_known_where_it_was_seen_last_and_how_far_it_may_be(mill):
    places, there = ObservedPoints(mill), {"X": 160.0, "Y": 160.0, "Z": 70.0}
    assert places.predict_point(there, "") is None
    for x in (0.0, 40.0, 80.0, 120.0, 160.0):
        seen = TO_TRACKER.apply(np.array([[x, x, 0.0]]))[0]
        places.remember({"X": x, "Y": x, "Z": 0.0}, "", seen, is_still=True)
    expected = places.predict_point(there, "")
    assert expected.basis == "where it was seen last"
    np.testing.assert_allclose(expected.place_mm, seen)
    assert expected.reach_mm > 70.0
