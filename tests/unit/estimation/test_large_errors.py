"""Machines that err by a millimetre and a milliradian: right, and honest about it."""

import numpy as np

from estimating import estimate, judge_map
from truepath.alignment.align import align
from truepath_simulators.worlds.synthetic import Setting


def test_errors_of_a_millimetre_are_found_to_a_micrometre(record):
    run, truth = record(5, rows=40, setting=Setting(error_scale=25.0))
    left = judge_map(estimate(align(run)), truth.deviation_mm)
    true_mm = truth.deviation_mm(truth.recording.commanded_mm[::500])
    assert np.linalg.norm(true_mm, axis=1).max() > 0.8
    assert left.left_mm < 1.5e-3
    assert left.inside > 0.85
