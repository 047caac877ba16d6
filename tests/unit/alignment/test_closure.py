"""How far an interrupted Run has got; what is too little to go on from."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.alignment.closure import find_committed
from truepath.errors import AlignmentError
from truepath_simulators.motion.program import Program

# To and fro along Y, then far away: the first three places are on one line.
PLACES = [
    [10.0, 8.0, 6.0], [10.0, 84.0, 6.0], [10.0, 8.0, 6.0], [436.0, 8.0, 42.0],
    [288.0, 83.0, 294.0], [60.0, 300.0, 200.0], [400.0, 250.0, 60.0],
]  # fmt: skip


@pytest.fixture(scope="module")
def run(record):
    n = len(PLACES)
    program = Program(np.array(PLACES), np.full(n, 100.0), np.full(n, 0.5))
    return record(3, program=program)[0]


@pytest.fixture(scope="module")
def cut(run):
    """Return a function: the Run as it is if it ends late within a line."""
    seen = align(run)

    def end_within(row):
        end_s = np.quantile(
            seen.at.time_s[(seen.row == row) & (seen.at.line >= 0)], 0.9
        )
        kept = np.flatnonzero(run.tracker.device_time_s < end_s)
        return replace(run, tracker=run.tracker.select(kept))

    return end_within


def test_a_run_goes_on_behind_its_last_whole_line(cut):
    assert find_committed(cut(5)).next_row == 5


def test_places_on_one_straight_line_are_nothing_to_go_on_from(cut):
    align(cut(3))  # the line that was cut short tells the pose, and is driven again
    with pytest.raises(
        AlignmentError, match="what was driven lies on one straight line"
    ):
        find_committed(cut(3))
