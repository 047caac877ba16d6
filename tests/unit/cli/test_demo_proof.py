"""`demo`: the path that it plans, and how the truth confirms what it finds."""

import numpy as np
import pytest

from truepath.cli.demo import compare_with_truth, plan_path
from truepath.errors import PlanningError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import result_from_json
from truepath.motion.motion_times import travel_time_s
from truepath.results.prediction import predict
from truepath_simulators.scenario import load_machine


def test_the_path_takes_the_minutes_that_were_asked_or_says_the_least():
    machine = machine_from_json(load_machine("demo"))
    path = plan_path(machine, 6000.0, 1.5)
    assert travel_time_s(path) == pytest.approx(90.0, rel=0.15)
    with pytest.raises(PlanningError, match=r"give --minutes \d+\.\d or more"):
        plan_path(machine, 2500.0, 0.5)


def test_the_proof_is_exact_for_a_result_that_is_the_truth(result):
    """The truth less what the result says is nothing: 0 % left, all within 2 u."""
    loaded = result_from_json(result)

    def truth_um(position_mm):
        moved = np.cross([3e-2, -1e-2, 2e-2], position_mm) + np.array([5.0, 6.0, 7.0])
        return predict(loaded, position_mm).error_um + moved

    found = compare_with_truth(result, truth_um)
    assert found.before_um > 1.0
    assert (found.after_um, found.covered) == (pytest.approx(0.0, abs=1e-6), 1.0)
