"""Machines that err by a millimetre and a milliradian: right, and honest about it."""

import numpy as np
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath_simulators.worlds.synthetic import Setting

FAR_OFF = Setting(error_scale=25.0)


def test_errors_of_a_millimetre_are_found_to_a_micrometre(record, rng):
    run, truth = record(5, rows=40, setting=FAR_OFF)
    found = estimate(align(run))
    low, high = np.array([(axis.low, axis.high) for axis in run.machine.axes]).T
    position = rng.uniform(low, high, (300, 3))
    volume, at = (
        build_volumetric_map(found.model),
        make_standstill(run.machine, position),
    )
    true = truth.deviation_mm(position)
    moved = np.zeros((300, 3, 6))
    moved[:, :, :3] = np.eye(3)
    for k in range(3):
        moved[:, :, 3 + k] = np.cross(np.eye(3)[k], at.point_mm - volume.centre_mm)
    off = (true - volume.error_mm(at, found.theta)).reshape(-1)
    flat = moved.reshape(-1, 6)
    off -= flat @ np.linalg.lstsq(flat, off, rcond=None)[0]
    sigma = volume.sigma_mm(at, found.covariance).reshape(-1)
    assert np.linalg.norm(true, axis=1).max() > 0.8
    assert np.linalg.norm(off.reshape(-1, 3), axis=1).mean() < 1.5e-3
    assert (np.abs(off) < 2.0 * sigma).mean() > 0.85
