"""The batch estimate as an analysis makes it, and how far it is off the truth."""

from typing import NamedTuple

import numpy as np
from tests.conftest import without_rigid_motion

from truepath.estimation.checks.robust_estimate import estimate_checked
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.estimation.solve import batch
from truepath.files.bundle.one_machine import one_machine
from truepath.kinematics import conditions, volumetric_map
from truepath.kinematics.coarse_model import build_run_models

MARGIN_MM = 15.0  # of the travel of linear axes that is not judged at either end


def estimate(*observed, names=(), known=None, **options):
    names = names or [f"Run {number}" for number in range(1, len(observed) + 1)]
    machine = one_machine([each.at.machine for each in observed], names)
    known = known or PriorEffects()
    models = build_run_models(machine, [each.at for each in observed], known.effects)
    return batch.estimate(models, observed, known=known, **options)


def estimate_one(seen):
    """Estimate from one Run as an analysis does: what is wrong in it is left out."""
    return estimate_checked(build_run_models(seen.at.machine, [seen.at]), [seen])


class Judged(NamedTuple):
    """What an estimate has left of the volumetric error of the truth."""

    share: float
    inside: float  # share of it that lies within two sigma
    left_mm: float


def judge_map(result, deviation_mm, target="", count=300):
    """Hold the volumetric map of a target against deviation_mm(positions)."""
    machine = result.model.machine
    target = machine.target(target)
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    linear = [axis.name for axis in machine.linear_axes]
    margin = MARGIN_MM * np.isin([axis.name for axis in machine.axes], linear)
    q = np.random.default_rng(7).uniform(low + margin, high - margin, (count, len(low)))
    at = conditions.make_standstill(machine, q, np.tile(target.offset_mm, (count, 1)))
    found = volumetric_map.build_volumetric_map(result.model, target.name)
    before = without_rigid_motion(at.point_mm, deviation_mm(q))
    told = without_rigid_motion(at.point_mm, found.error_mm(at, result.theta))
    left = before - told
    inside = np.abs(left) < 2.0 * found.sigma_mm(at, result.covariance)
    size, whole = (np.linalg.norm(each, axis=1).mean() for each in (left, before))
    return Judged(size / whole, float(inside.mean()), size)
