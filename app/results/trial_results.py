"""The stated uncertainties held against trials: every table, and the map.

What the tables and the volumetric error state follows from the linear law. Trials of
the same measurement (JCGM 101) give each number's estimate, standard uncertainty and
95 % interval anew, and clause 8 says whether the linear law stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float64

from app.estimation.batch import Estimate
from app.estimation.monte_carlo import prepare_trials, run_block
from app.estimation.volumetric_map import build_volumetric_map
from app.files.units import UM_PER_MM, scale_of
from app.kinematics.conditions import make_standstill
from app.kinematics.machine import RotaryAxis
from app.kinematics.model import MachineModel
from app.kinematics.symbols import find_unit
from app.numerics.adaptive_trials import (
    Mapper,
    TrialPlan,
    agrees,
    numerical_tolerance,
    propagate,
)
from app.progress import ShareProgress, ignore_progress
from app.results.error_tables import choose_table_positions

MAP = "volumetric error"
_GRID, _TURNED = 3, 2  # points of a linear and of a rotary axis, ends included


@dataclass(frozen=True, slots=True)
class TrialQuantity:
    """One table, squareness or location, or the map, with what the trials make of it.

    name : its symbol, or `MAP`; unit : "um" or "urad", of every number
    position : (n, k) where the n numbers stand, in mm or deg; k = 0 for a single one;
        of the map, axis positions, with x, y, z of one point after another
    value, linear : (m,) as stated, and its standard uncertainty by the linear law
    mean, sigma, low, high : (m,) by the trials; low and high end the 95 % interval
    tolerance : (m,) δ; agrees : (m,) clause 8 validates the linear law
    """

    name: str
    unit: str
    position: Float64[np.ndarray, "n k"]
    position_unit: str
    value: Float64[np.ndarray, " m"]
    linear: Float64[np.ndarray, " m"]
    mean: Float64[np.ndarray, " m"]
    sigma: Float64[np.ndarray, " m"]
    low: Float64[np.ndarray, " m"]
    high: Float64[np.ndarray, " m"]
    tolerance: Float64[np.ndarray, " m"]
    agrees: Bool[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class TrialResults:
    """What the trials say of a whole result.

    settled : every number stood still to a fifth of its tolerance
    """

    plan: TrialPlan
    trials: int
    settled: bool
    quantities: tuple[TrialQuantity, ...]

    @property
    def numbers(self) -> int:
        """How many numbers were held against the trials."""
        return sum(len(q.agrees) for q in self.quantities)

    @property
    def agreeing(self) -> int:
        """For how many of them the linear law is validated."""
        return sum(int(q.agrees.sum()) for q in self.quantities)

    @property
    def agrees(self) -> bool:
        """Whether the linear law is validated for every number."""
        return self.settled and self.agreeing == self.numbers

    @property
    def disagreement(self) -> float:
        """Largest relative difference of both standard uncertainties."""
        return max(_compare_sigmas(q) for q in self.quantities)


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A quantity and its rows in the parameters of the machine."""

    name: str
    unit: str
    position: Float64[np.ndarray, "n k"]
    position_unit: str
    rows: Float64[np.ndarray, "m p"]


def run_trials(
    estimate: Estimate,
    plan: TrialPlan,
    run: Mapper = map,
    on_progress: ShareProgress = ignore_progress,
) -> TrialResults:
    """Run trials of an estimate that has kept its fit.

    run : computes blocks of trials, here or elsewhere
    on_progress : receives the share done
    """
    if estimate.fit is None:
        raise ValueError("the estimate has not kept its fit")
    asked = _list_quantities(estimate.model)
    rows = np.concatenate([a.rows for a in asked])
    trials = prepare_trials(estimate.fit, rows, plan)
    moved = propagate(partial(run_block, trials), plan, run, on_progress)
    linear = np.sqrt(np.einsum("op,op->o", rows @ estimate.covariance, rows).clip(0.0))
    columns = {
        "value": rows @ estimate.theta,
        "linear": linear,
        "mean": rows @ estimate.theta + moved.mean,
        "sigma": moved.sigma,
        "low": rows @ estimate.theta + moved.low,
        "high": rows @ estimate.theta + moved.high,
        "tolerance": numerical_tolerance(linear, plan.digits),
        "agrees": agrees(moved, np.zeros(len(rows)), linear, plan.digits),
    }
    ends = np.cumsum([len(a.rows) for a in asked])
    quantities = tuple(
        TrialQuantity(
            a.name,
            a.unit,
            a.position,
            a.position_unit,
            **{k: v[end - len(a.rows) : end] for k, v in columns.items()},
        )
        for a, end in zip(asked, ends, strict=True)
    )
    return TrialResults(plan, moved.trials, moved.settled, quantities)


def _list_quantities(model: MachineModel) -> list[_Quantity]:
    asked: list[_Quantity] = []
    for effect in model.effects:
        at, position_unit = np.zeros((1, 0)), ""
        if not effect.iso_symbol:
            continue
        rows = np.eye(1)
        if motion := effect.motion:
            at = choose_table_positions(motion.axis)[:, None]
            position_unit = "deg" if isinstance(motion.axis, RotaryAxis) else "mm"
            rows = motion.rows(at[:, 0])
        whole = np.zeros((len(rows), model.size))
        stated = find_unit(effect.iso_symbol)
        whole[:, model.slices[effect.name]] = scale_of(stated) * rows
        asked.append(_Quantity(effect.iso_symbol, stated, at, position_unit, whole))
    return [*asked, _map_quantity(model)]


def _map_quantity(model: MachineModel) -> _Quantity:
    travel = [
        np.linspace(
            axis.low, axis.high, _TURNED if isinstance(axis, RotaryAxis) else _GRID
        )
        for axis in model.machine.axes
    ]
    at = np.stack([g.ravel() for g in np.meshgrid(*travel, indexing="ij")], axis=1)
    J = build_volumetric_map(model).jacobian(make_standstill(model.machine, at))
    return _Quantity(MAP, "um", at, "", UM_PER_MM * J.reshape(-1, model.size))


def _compare_sigmas(quantity: TrialQuantity) -> float:
    stated = quantity.linear > 2.0 * 1e-6 * quantity.linear.max(initial=0.0)
    if not stated.any():
        return 0.0
    ratio = quantity.sigma[stated] / quantity.linear[stated]
    return float(np.abs(ratio - 1.0).max())
