"""A measurement whose path grows: parts, one after another, in one Run."""

from dataclasses import replace

import numpy as np
import pytest

from measurement_fixtures import along, standing_at
from truepath.errors import PlanningError
from truepath.measurement.messages import CellVerb, MeasurementProgress, PartRequested
from truepath.measurement.progress import ProgressEstimator, schedule_rows
from truepath.motion.configurations import append_part

pytestmark = pytest.mark.usefixtures("clock")

ON = [(10.0, 60.0, -40.0), (210.0, 60.0, -40.0), (210.0, 160.0, -140.0)]


@pytest.fixture
def part(order):
    return along(order, ON).commanded


@pytest.fixture
def until_asked(journal):
    return lambda times: journal.wait(lambda: len(journal.of(PartRequested)) == times)


@pytest.fixture
def waiting(begin, order, until_asked):
    running = begin(replace(order, grows=True))
    until_asked(1)
    return running


@pytest.fixture
def conclude(until_asked):
    def conclude(running, parts=2):
        until_asked(parts)
        running.obey(CellVerb.CONCLUDE)
        assert running.ended() == "finished"
        return running.run

    return conclude


def test_a_path_grows_in_one_run(waiting, part, square, motion, until_asked, conclude):
    np.testing.assert_array_equal(motion.status().position, square.position[-1])
    assert motion.calls[-1] == "start"  # it stands while it waits
    waiting.obey(part)
    until_asked(2)
    np.testing.assert_array_equal(motion.loaded.position, part.position)
    run = conclude(waiting)
    assert motion.calls == ["abort", "move_to", *(2 * ["load", "start"])]
    rows = np.vstack([square.position, ON[1:]])
    np.testing.assert_array_equal(run.commanded.position, rows)
    assert (np.diff(run.tracker.sequence) == 1).all()
    done = [p.done for p in waiting.told(MeasurementProgress)]
    assert done == sorted(done)
    assert (done[-1], waiting.told(MeasurementProgress)[-1].total) == (5, 5)


def test_points_grow_one_by_one(begin, order, square, until_asked, conclude):
    one = begin(replace(standing_at(order, square.position[:2], 0.5), grows=True))
    for times, place in enumerate(ON, 1):
        until_asked(times)
        one.obey(standing_at(order, [place], 0.5).commanded)
    np.testing.assert_array_equal(conclude(one, 4).commanded.position[2:], ON)
    done = [text.split(" until ")[0] for text in one.texts("point")]
    assert done == [f"row {i}" for i in range(1, 6)]


@pytest.mark.parametrize(
    ("rows", "states", "said"),
    [
        ([ON[0], (510.0, 60.0, -40.0)], ("failed",), "row 2: X = 510 mm exceeds 500"),
        (ON[1:], ("failed", "faulted"), ""),  # begins elsewhere
    ],
)
def test_a_part_elsewhere_is_never_loaded(waiting, order, motion, rows, states, said):
    waiting.obey(along(order, rows).commanded)
    assert waiting.ended() in states
    assert said in waiting.fault.text
    assert (motion.calls.count("load"), len(waiting.run.commanded)) == (1, 4)


def test_a_pause_between_parts_keeps_the_next_waiting(waiting, part, motion, conclude):
    waiting.pause()
    motion.here = motion.here + 2.0
    waiting.obey(part)
    waiting.look()
    assert motion.calls.count("load") == 1
    waiting.obey(CellVerb.RESUME)
    conclude(waiting)


@pytest.mark.fault_row(21)
def test_a_machine_that_leaves_its_last_row_while_it_waits_is_a_fault(waiting, motion):
    motion.here = motion.here + 2.0
    waiting.ends("faulted", "runs-on")
    assert motion.calls.count("load") == 1


def test_parts_of_another_mode_or_place_are_refused(order, square, part):
    points = standing_at(order, square.position[-1:], 1.0).commanded
    with pytest.raises(PlanningError, match="the mode"):
        append_part(square, points)
    with pytest.raises(PlanningError, match="where the machine stands"):
        append_part(square, along(order, ON[1:]).commanded)
    with pytest.raises(PlanningError, match="axes"):
        append_part(square, replace(part, axes=("Y", "X", "Z")))


def test_how_long_a_machine_may_stand_counts_rows_that_came_later(square):
    progress = ProgressEstimator(schedule_rows(square, 6000.0), 1.0)
    before_s = progress.longest_row_s
    rows = square.position[::-1]
    slow = replace(square, position=rows, dwell_s=np.full(len(rows), 60.0))
    progress.extend(schedule_rows(append_part(square, slow), 6000.0))
    assert before_s < 60.0 < progress.longest_row_s


@pytest.mark.parametrize("is_row_done", [True, False])
def test_a_line_driven_to_its_end_counts_when_the_rest_is_left_out(square, is_row_done):
    progress = ProgressEstimator(schedule_rows(square, 6000.0), 1.0)
    progress.begin()
    progress.follow(1)
    assert progress.next_report().done == 0
    progress.exclude_rest(is_row_done=is_row_done)
    progress.end()
    assert progress.next_report().done == is_row_done
