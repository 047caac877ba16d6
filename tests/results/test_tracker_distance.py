"""A tracker whose distances are all off is told by the result itself."""

import pytest

from truepath.files.earlier.verdict import Verdict
from truepath.results.analysis import analyse
from truepath_simulators.hidden.tracker import TrackerRangeOffset
from truepath_simulators.worlds.synthetic import Setting


def reasons_of(verdict: Verdict):
    return [reason for reason in verdict.reasons if reason.kind == "range-off"]


@pytest.mark.parametrize(
    ("offset_um", "state"),
    [
        (-40.0, "doubtful"),
        pytest.param(250.0, "not-usable", marks=pytest.mark.long),
    ],
)
def test_a_wrong_home_distance_is_named_with_its_size(record, offset_um, state):
    setting = Setting(hidden=(TrackerRangeOffset(offset_um),))
    run, _ = record(31, rows=60, setting=setting)
    (reason,) = reasons_of(analyse(run).verdict)
    assert reason.state == state
    found, within = reason.values["distance_um"], reason.values["within_um"]
    assert abs(found - offset_um) < 1.5 * within
    assert within < 6.0


def test_a_good_tracker_is_not_suspected(record):
    run, _ = record(31, rows=60)
    assert reasons_of(analyse(run).verdict) == []
