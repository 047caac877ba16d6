"""Several targets on one machine: the tracker chooses, and each point is checked."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import measurement_fixtures as fixtures
from truepath.kinematics.machine.machine import Target
from truepath.measurement import messages
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import BeamLost, NotOffered, Refused
from truepath_drivers.interfaces.tracker import TargetChoice
from truepath_drivers.interfaces.tracker_records import PointMeasurement

pytestmark = pytest.mark.usefixtures("clock")

OFFSET_MM = {"T1": (0.0, 0.0, -100.0), "T2": (120.0, 40.0, -100.0)}
TURNS = ("T1", "T2", "T2", "T1")


class Choosing(TargetChoice):
    """Turns to the target that it was told, unless a test makes it do otherwise."""

    def __init__(self, motion):
        super().__init__()
        self.motion, self.asked, self.on = motion, [], "T1"
        self.failures, self.goes_to = [], {}

    def select_target(self, name):
        self.asked.append(name)
        if self.failures:
            raise self.failures.pop(0)
        self.on = self.goes_to.get(name, name)

    @property
    def seen_mm(self):
        return fixtures.PLACE_MM + self.motion.here + OFFSET_MM[self.on]


class ChoosingStream(Choosing, fixtures.FakeTracker):
    def select_target(self, name):
        super().select_target(name)
        assert self.motion.status().state != "running" or len(self.asked) == 1

    def _new(self):
        samples = super()._new()
        return replace(samples, position_mm=np.tile(self.seen_mm, (len(samples), 1)))


class ChoosingTracker(Choosing, fixtures.FakePolledTracker):
    def measure(self, dwell_s):
        return PointMeasurement.average(np.array([0.0]), self.seen_mm[None])


@pytest.fixture
def tracker(motion):
    motion.speed = 2000.0
    return ChoosingTracker(motion)


@pytest.fixture
def calm():
    return fixtures.QUICK


@pytest.fixture
def order(order):
    targets = tuple(Target(name, "tool", at) for name, at in OFFSET_MM.items())
    points = fixtures.standing_at(order, fixtures.draw_rows(4), 0.03, TURNS)
    return replace(points, machine=replace(order.machine, targets=targets))


@pytest.fixture
def measure(begin, order, journal):
    """Measure to the end, resuming once the tracker is mended by `mend`."""

    def made(mend=lambda: None, order=order, **given):
        running = begin(order, **given)
        while running.thread.is_alive():
            if journal.states[-1:] == ["paused"]:
                mend()
                running.obey(messages.CellVerb.RESUME)
            host_clock.join(running.thread, 0.05)
        return running

    return made


@pytest.mark.parametrize(
    ("given", "by_hand", "asked", "faults"),
    [
        ({}, [], "T1 T2 T1", []),
        ({"failures": [BeamLost("not near")]}, [], "T1 T1 T2 T1", ["beam-lost"]),
        ({"failures": [NotOffered("v1")]}, ["T2", "T1"], "T1", ["wrong-target"] * 2),
        ({"goes_to": {"T2": "T1"}}, ["T2"], "T1 T2 T1", ["wrong-target"]),
    ],
    ids=["chooses", "does not see it", "cannot choose", "is at another one"],
)
def test_each_point_is_of_its_target_chosen_or_brought_by_hand(
    measure, tracker, journal, given, by_hand, asked, faults
):
    vars(tracker).update(given)
    hands = iter(by_hand)

    def aim_by_hand():
        tracker.on = next(hands, tracker.on)

    running = measure(aim_by_hand)
    assert journal.states[-1] == "finished"
    run, offsets = running.run, np.array([OFFSET_MM[name] for name in TURNS])
    places = fixtures.PLACE_MM + run.commanded.position + offsets
    np.testing.assert_allclose(run.tracker.position_mm, places, atol=1e-6)
    assert (tracker.asked, journal.faults) == (asked.split(), faults)


def test_an_unknown_target_ends_the_measurement(measure, tracker, journal):
    tracker.failures = [Refused("knows T5, T6")]
    running = measure()
    assert journal.states[-1] == "failed"
    assert not len(running.run.tracker)


class SlowTracker(ChoosingTracker):
    verb_limit_s = 0.0

    def __init__(self, motion):
        super().__init__(motion)
        self.turned = threading.Event()

    def select_target(self, name):
        host_clock.wait(self.turned, 1.5)
        super().select_target(name)


@pytest.mark.parametrize(
    ("limit_s", "state"), [(5.0, "finished"), (-0.9, "faulted")], ids=["long", "short"]
)
def test_a_driver_says_its_time_to_turn(begin, motion, order, journal, limit_s, state):
    tracker = SlowTracker(motion)
    tracker.verb_limit_s, motion.speed = limit_s, 2000.0
    assert begin(order, tracker=tracker).ended() == state
    assert journal.faults == ([] if state == "finished" else ["tracker-silent"])
    tracker.turned.set()


@pytest.fixture
def drive(measure, motion, order):
    names = ("T1", "T1", "T1", "T2", "T2", "T2", "T1", "T1")
    corners = [[10.0, 10, -10], [400, 300, -10], [400, 10, -200]]
    rows = np.array(corners)[[0, 1, 2, 2, 0, 1, 1, 2]]
    lines = fixtures.along(order, rows, target=names)

    def driven(tracker, mend=lambda: None):
        motion.speed = 20.0
        given = {"tracker": tracker, "settings": replace(fixtures.QUICK, lead_s=0.5)}
        return measure(mend, lines, **given)

    return driven


@pytest.mark.parametrize(
    ("failures", "asked", "programs"),
    [([], "T1 T2 T1", 3), ([NotOffered("speaks version 1")], "T1", 1)],
    ids=["can choose", "cannot"],
)
def test_lines_of_several_targets_need_nobody_one_program_for_each_that_is_chosen(
    drive, motion, journal, failures, asked, programs
):
    tracker = ChoosingStream(motion)
    tracker.failures = failures
    running = drive(tracker)
    assert (journal.states, tracker.asked) == (["running", "finished"], asked.split())
    assert journal.faults == []
    assert motion.calls.count("load") == motion.calls.count("start") == programs
    assert len(running.run.commanded) == 8
    done = [(p.done, p.total) for p in journal.of(messages.MeasurementProgress)]
    assert (done[-1], done) == ((7, 7), sorted(done))


def test_a_wrong_target_at_a_change_holds_before_its_lines(drive, motion, journal):
    tracker, begun = ChoosingStream(motion), []
    tracker.goes_to = {"T2": "T1"}

    def mend():
        begun.append(motion.calls.count("start"))
        tracker.goes_to = {}

    drive(tracker, mend)
    assert (journal.states[-1], journal.faults) == ("finished", ["wrong-target"])
    assert (set(begun), tracker.asked) == ({1}, ["T1", "T2", "T2", "T1"])
