"""When to calibrate again: one answer for each share of courses beyond the limit."""

from types import SimpleNamespace

import numpy as np
import pytest

from truepath.answers.trend.recalibration_forecast import ForecastModel
from truepath.answers.trend.trend import describe_outlook
from truepath.estimation.over_time.drift_process import Course

HOUR_S = 3600.0


def look(beyond, begin_um=0.5, runs=4, limit=2.0):
    """Look 10 h ahead where a share of 100 courses grows by 1 µm an hour."""
    at_runs = Course(HOUR_S * np.arange(runs), np.zeros((runs, 0)))
    grows = np.arange(100) < 100 * beyond

    def measure(at):
        hours = (at.time_s - at_runs.time_s[-1]) / HOUR_S
        return begin_um + grows[:, None] * hours

    stub = SimpleNamespace(
        runs=at_runs,
        course_at=lambda *time_s: Course(np.array(time_s), np.zeros((len(time_s), 0))),
        _measure_change_um=measure,
    )
    return ForecastModel.predict_exceedance(stub, limit, 10.0 * HOUR_S)


@pytest.mark.parametrize(
    ("beyond", "state", "grade", "said"),
    [
        (0.0, "not-within-horizon", "certain", "stays below 2 µm up to 13.0 h"),
        (0.04, "not-within-horizon", "certain", "stays below 2 µm up to 13.0 h"),
        (0.3, "cannot-be-said", None, "Later cannot be said: the chance to exceed it"),
        (0.6, "due", "possible", "(possible)"),
        (0.8, "due", "likely", "Calibrate again at 4."),
        (1.0, "due", "certain", "(certain)"),
    ],
)
def test_each_share_of_courses_beyond_the_limit_has_its_answer(
    beyond, state, grade, said
):
    found = look(beyond)
    assert (found.state, found.grade) == (state, grade)
    assert found.exceeded == pytest.approx(beyond)
    assert said in describe_outlook(found)
    if found.due_s is not None:
        assert found.due_s / HOUR_S == pytest.approx(4.5, abs=0.2)


def test_what_is_not_known_by_itself_and_too_few_runs_have_answers_of_their_own():
    assert look(0.0, begin_um=3.0).state == "already"
    few = look(1.0, runs=2)
    assert (few.state, few.grade, few.exceeded) == ("not-known", None, None)
    assert look(1.0, limit=None).exceeded is None
