"""A measurement whose path grows: parts, one after another, in one Run."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from truepath.errors import PlanningError
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import (
    CellVerb,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    PartRequested,
    RunClosed,
)
from truepath.measurement.progress import ProgressEstimator, schedule_rows
from truepath.measurement.run_file.run_reading import open_run
from truepath.motion.configurations import Configurations, append_part
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path

pytestmark = pytest.mark.usefixtures("clock")

ON = [(10.0, 60.0, -40.0), (210.0, 60.0, -40.0), (210.0, 160.0, -140.0)]


def path_through(rows, like):
    n = len(rows)
    return Path(like.axes, np.array(rows), np.full(n, 6000.0), np.full(n, 0.1))


class Growing:
    """A measurement on fake devices, in a thread; it asks for parts."""

    def __init__(self, order, tracker, motion, journal, settings):
        devices = {"tracker": tracker.connect(), "motion": motion.connect()}
        self.order, self.journal, self.motion = order, journal, motion
        self.measurement = Measurement(
            order, tracker, motion, devices, journal.report, settings
        )
        self.thread = threading.Thread(target=self.measurement.run)
        self.thread.start()

    def until_asked(self, times):
        self.journal.wait(lambda: len(self.journal.of(PartRequested)) == times)

    def ended(self):
        self.journal.wait(lambda: bool(self.journal.of(RunClosed)))
        host_clock.join(self.thread, 5.0)
        return self.journal.states[-1]

    @property
    def run(self):
        return open_run(self.order.run_file)


@pytest.fixture
def grown(mill, square, tracker, motion, journal, calm, tmp_path):
    begun = []

    def begin(commanded=square):
        file = str(tmp_path / "grown.sqlite")
        order = MeasurementOrder(
            "grown", file, mill, commanded, reserve_bytes=0, grows=True
        )
        begun.append(Growing(order, tracker, motion, journal, calm))
        return begun[-1]

    yield begin
    for one in begun:
        if one.thread.is_alive():
            one.measurement.obey(CellVerb.ABORT)
            host_clock.join(one.thread, 5.0)


def test_a_path_grows_in_the_same_run(grown, square, motion, journal):
    one = grown()
    one.until_asked(1)
    part = path_through(ON, square)
    one.measurement.obey(part)
    one.until_asked(2)
    np.testing.assert_array_equal(motion.loaded.position, part.position)
    one.measurement.obey(CellVerb.CONCLUDE)
    assert one.ended() == "finished"
    assert motion.calls == ["abort", "move_to", *(2 * ["load", "start"])]
    run = one.run
    rows = np.vstack([square.position, ON[1:]])
    np.testing.assert_array_equal(run.commanded.position, rows)
    assert (np.diff(run.tracker.sequence) == 1).all()
    done = [p.done for p in journal.of(MeasurementProgress)]
    assert done == sorted(done)
    assert (done[-1], journal.of(MeasurementProgress)[-1].total) == (5, 5)


def test_a_machine_that_waits_for_a_part_stands(grown, motion):
    one = grown()
    one.until_asked(1)
    here = motion.status().position
    assert motion.calls[-1] == "start"
    np.testing.assert_array_equal(here, one.order.commanded.position[-1])
    one.measurement.obey(CellVerb.CONCLUDE)
    assert one.ended() == "finished"
    assert len(one.run.commanded) == 4


def test_points_grow_one_by_one(grown, square, motion):
    points = Configurations(square.axes, square.position[:2], np.full(2, 0.5))
    one = grown(points)
    for times, place in enumerate(ON, 1):
        one.until_asked(times)
        part = Configurations(square.axes, np.array([place]), np.array([0.5]))
        one.measurement.obey(part)
    one.until_asked(4)
    one.measurement.obey(CellVerb.CONCLUDE)
    assert one.ended() == "finished"
    run = one.run
    np.testing.assert_array_equal(run.commanded.position[2:], ON)
    done = [e.text.split(" until ")[0] for e in run.events if e.kind == "point"]
    assert done == [f"row {i}" for i in range(1, 6)]


def test_a_part_out_of_travel_is_never_loaded(grown, square, motion, journal):
    one = grown()
    one.until_asked(1)
    one.measurement.obey(path_through([ON[0], (510.0, 60.0, -40.0)], square))
    assert one.ended() == "failed"
    assert "row 2: X = 510 mm exceeds 500 mm" in journal.of(FaultReported)[-1].text
    assert motion.calls.count("load") == 1
    assert len(one.run.commanded) == 4


def test_a_part_that_begins_elsewhere_is_never_loaded(grown, square, motion):
    one = grown()
    one.until_asked(1)
    one.measurement.obey(path_through(ON[1:], square))
    assert one.ended() in ("failed", "faulted")
    assert motion.calls.count("load") == 1


def test_a_pause_between_parts_keeps_the_next_one_waiting(grown, square, motion):
    one = grown()
    one.until_asked(1)
    one.measurement.obey(CellVerb.PAUSE)
    one.journal.wait(lambda: one.journal.states[-1] == "paused")
    one.measurement.obey(path_through(ON, square))
    looks = len(one.journal.of(MeasurementProgress))
    one.journal.wait(lambda: len(one.journal.of(MeasurementProgress)) > looks + 3)
    assert motion.calls.count("load") == 1
    one.measurement.obey(CellVerb.RESUME)
    one.until_asked(2)
    one.measurement.obey(CellVerb.CONCLUDE)
    assert one.ended() == "finished"


@pytest.mark.fault_row(21)
def test_a_machine_that_leaves_its_last_row_while_it_waits_is_a_fault(
    grown, square, motion, journal
):
    one = grown()
    one.until_asked(1)
    motion.here = motion.here + 2.0
    assert one.ended() == "faulted"
    assert journal.faults == ["runs-on"]
    assert motion.calls.count("load") == 1


def test_a_machine_that_is_moved_by_hand_in_a_pause_is_no_fault(grown, square, motion):
    one = grown()
    one.until_asked(1)
    one.measurement.obey(CellVerb.PAUSE)
    one.journal.wait(lambda: one.journal.states[-1] == "paused")
    motion.here = motion.here + 2.0
    looks = len(one.journal.of(MeasurementProgress))
    one.journal.wait(lambda: len(one.journal.of(MeasurementProgress)) > looks + 3)
    one.measurement.obey(CellVerb.RESUME)
    one.measurement.obey(path_through(ON, square))
    one.until_asked(2)
    one.measurement.obey(CellVerb.CONCLUDE)
    assert one.ended() == "finished"


def test_parts_of_another_mode_or_place_are_refused(square):
    points = Configurations(square.axes, square.position[-1:], np.ones(1))
    with pytest.raises(PlanningError, match="the mode"):
        append_part(square, points)
    with pytest.raises(PlanningError, match="where the machine stands"):
        append_part(square, path_through(ON[1:], square))
    with pytest.raises(PlanningError, match="axes"):
        append_part(square, replace(path_through(ON, square), axes=("Y", "X", "Z")))


def test_how_long_a_machine_may_stand_counts_rows_that_came_later(square):
    progress = ProgressEstimator(schedule_rows(square, 6000.0), 1.0)
    before_s = progress.longest_row_s
    rows = square.position[::-1]
    slow = replace(square, position=rows, dwell_s=np.full(len(rows), 60.0))
    progress.extend(schedule_rows(append_part(square, slow), 6000.0))
    assert before_s < 60.0 < progress.longest_row_s


@pytest.mark.parametrize("is_row_done", [True, False])
def test_a_line_that_was_driven_to_its_end_counts_when_the_rest_is_left_out(
    square, is_row_done
):
    progress = ProgressEstimator(schedule_rows(square, 6000.0), 1.0)
    progress.begin()
    progress.follow(1)
    assert progress.next_report().done == 0
    progress.leave_out_rest(is_row_done=is_row_done)
    progress.end()
    assert progress.next_report().done == is_row_done
