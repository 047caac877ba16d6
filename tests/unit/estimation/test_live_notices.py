"""What changes while it is measured is noticed, and named where a name holds."""

from dataclasses import replace

import numpy as np
import pytest

from following import follow_lines, shift
from truepath.estimation.checks.change_detection import (
    KNOCK,
    LINE,
    LOST_MOTION,
    UNNAMED,
    Change,
    revise,
)

ROWS = tuple(range(1, 21))


@pytest.fixture(scope="module")
def usual(record):
    run, _ = record(31, rows=32)
    time_s = run.tracker.device_time_s
    return run, (time_s - time_s[0]) / (time_s[-1] - time_s[0])


def test_nothing_is_noticed_where_nothing_changes_and_a_drift_is_no_knock(usual):
    run, share = usual
    told = follow_lines(run).noticed
    assert len(told) > 25
    assert not any(notices for _, notices in told)
    drifting = shift(run, np.outer(share, [0.012, 0.012, -0.012]))
    told = follow_lines(drifting).noticed
    assert [n.kind for n in told[-1][1] if not n.is_over] == ["set-up-drifts"]
    assert KNOCK not in {n.kind for _, notices in told for n in notices}


@pytest.mark.fault_row(11)
def test_a_knock_is_noticed_by_the_next_line_and_named_with_its_size(usual, measured):
    run, share = usual
    late = share > 0.7
    told = follow_lines(shift(run, np.outer(late, [0.006, -0.006, 0.006]))).noticed
    knocked_s = run.tracker.device_time_s[np.argmax(late)]
    assert not any(notices for now_s, notices in told if now_s < knocked_s)
    first_s, notices = next((now_s, n) for now_s, n in told if n)
    finished = [now_s for now_s, _ in told if knocked_s < now_s <= first_s]
    assert len(finished) <= 2
    assert notices[0].number == 1
    (notice,) = told[-1][1]
    assert (notice.kind, notice.grade, notice.is_over) == (KNOCK, "certain", False)
    assert notice.noticed_s == pytest.approx(first_s, abs=3.0)
    assert abs(1e3 * notice.size_mm - 10.4) < 4e3 * notice.sigma_mm
    assert 1e3 * notice.sigma_mm < 1.5
    measured(
        f"10.4 µm stated as {1e3 * notice.size_mm:.1f} ± "
        f"{2e3 * notice.sigma_mm:.1f} µm, {first_s - knocked_s:.0f} s after it"
    )


def test_a_knock_half_way_on_a_line_is_one_change(usual):
    run, share = usual
    moved = shift(run, np.outer(share > 0.56, [0.007, -0.007, 0.007]))
    told = follow_lines(moved).noticed
    shown = [[n.kind for n in notices if not n.is_over] for _, notices in told]
    assert max(map(len, shown)) == 1
    assert shown[-1] == [KNOCK]


def change(kind, onset, margin=30.0, size_mm=0.01, axis=""):
    return Change(kind, axis, onset, 100.0, 50.0, margin, size_mm, 0.001)


def test_a_change_has_no_name_while_another_kind_or_one_line_explains_it():
    (notice,) = revise((), [change(KNOCK, 15, margin=3.0)], ROWS, 9.0)
    assert (notice.kind, notice.grade, notice.since_row) == (UNNAMED, "possible", 16)
    (notice,) = revise((), [change(KNOCK, 19)], ROWS, 9.0)
    assert notice.kind == UNNAMED


@pytest.mark.parametrize(("margin", "grade"), [(9.0, "likely"), (21.0, "certain")])
def test_the_grade_is_how_much_worse_the_next_kind_is(margin, grade):
    (notice,) = revise((), [change(LOST_MOTION, 5, margin, axis="Y")], ROWS, 9.0)
    assert (notice.kind, notice.axis, notice.grade) == (LOST_MOTION, "Y", grade)


def test_a_notice_keeps_its_number_when_named_may_have_begun_elsewhere_and_ends():
    first = revise((), [change(LINE, 15, margin=1.0)], ROWS[:16], 9.0)
    (later,) = revise(first, [change(KNOCK, 14, size_mm=0.02)], ROWS, 30.0)
    assert (later.number, later.noticed_s, later.noticed_row) == (1, 9.0, 16)
    assert (later.kind, later.size_mm) == (KNOCK, 0.02)
    first = revise((), [change(LINE, 6, margin=1.0)], ROWS[:16], 9.0)
    (later,) = revise(first, [change(KNOCK, 14)], ROWS, 30.0)
    assert (later.number, later.kind, later.since_row) == (1, KNOCK, 15)
    both = revise((later,), [change(KNOCK, 14), change(KNOCK, 6)], ROWS, 40.0)
    assert [n.since_row for n in both] == [15, 7]
    first = revise((), [change(KNOCK, 15)], ROWS, 9.0)
    (over,) = revise(first, [], ROWS, 12.0)
    assert over == replace(first[0], is_over=True)
    both = revise((over,), [change(KNOCK, 3)], ROWS, 15.0)
    assert [(n.number, n.is_over) for n in both] == [(1, True), (2, False)]
