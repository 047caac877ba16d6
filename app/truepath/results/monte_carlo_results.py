"""The stated uncertainties tested by trials: every table, and the map.

Uncertainties of tables and volumetric error follow from the linear law. Trials of the
same measurement (JCGM 101) give estimate, standard uncertainty and 95 % interval of
each number independently, and clause 8 decides whether the linear law is valid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from truepath.estimation.solve.batch import Estimate
from truepath.estimation.solve.monte_carlo import prepare_trials, run_block
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import position_unit as unit_of_axis
from truepath.kinematics.machine.symbols import SQUARENESS, find_unit, is_location
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.numerics.adaptive_trials import (
    BLOCK,
    COVERAGE,
    Mapper,
    TrialPlan,
    agrees,
    numerical_tolerance,
    propagate,
)
from truepath.progress import ShareProgress, ignore_progress
from truepath.results.error_tables import choose_table_positions
from truepath.results.volumetric_error import make_grid

MAP = "volumetric error"
METHOD = "JCGM 101:2008, adaptive (7.9.4), held against the linear law (8)"
_LINEAR, _ROTARY = 3, 2  # points of an axis, ends included
_Place = tuple[str, str, Float64[np.ndarray, "n k"], str]


@dataclass(frozen=True, slots=True)
class TrialQuantity:
    """One table, squareness or location, or the map, with the numbers of the trials.

    name : its symbol, or `MAP`; unit : "um" or "urad", of every number
    position : (n, k) of the n numbers, in mm or deg; k = 0 for a single one; of the
        map, axis positions, with x, y, z of one point after another
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
    """Trials of a whole result.

    settled : every number was stable to a fifth of its tolerance
    """

    plan: TrialPlan
    trials: int
    settled: bool
    quantities: tuple[TrialQuantity, ...]

    @property
    def numbers(self) -> int:
        """How many numbers were tested."""
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


def run_trials(
    estimate: Estimate,
    plan: TrialPlan,
    run: Mapper = map,
    on_progress: ShareProgress = ignore_progress,
) -> TrialResults:
    """Run trials of an estimate. Raises ValueError where it has not kept its fit.

    run : computes blocks of trials, here or elsewhere
    on_progress : receives the share done
    """
    if estimate.fit is None:
        raise ValueError("the estimate has not kept its fit")
    asked = list(_list_quantities(estimate))
    rows = np.concatenate([of for _, of in asked])
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
    ends = np.cumsum([len(of) for _, of in asked])
    quantities = tuple(
        TrialQuantity(*place, **{k: v[end - len(of) : end] for k, v in columns.items()})
        for (place, of), end in zip(asked, ends, strict=True)
    )
    return TrialResults(plan, moved.trials, moved.settled, quantities)


def _list_quantities(
    estimate: Estimate,
) -> Iterator[tuple[_Place, Float64[np.ndarray, "m p"]]]:
    model, stated = estimate.model, estimate.reduce_to_targets.model
    for effect in stated.effects:
        symbol = effect.iso_symbol
        if not symbol or effect.name in stated.confounded:
            continue
        at, position_unit, rows = np.zeros((1, 0)), "", np.eye(1)
        if motion := effect.motion:
            at = choose_table_positions(motion.axis)[:, None]
            position_unit, rows = unit_of_axis(motion.axis), motion.rows(at[:, 0])
        scaled = scale_of(find_unit(symbol)) * rows
        whole = scaled @ estimate.target_rows[stated.slices[effect.name]]
        yield (symbol, find_unit(symbol), at, position_unit), whole
    at = make_grid(model.machine.axes, _LINEAR, _ROTARY)
    J = build_volumetric_map(model).jacobian(make_standstill(model.machine, at))
    yield (MAP, "um", at, ""), UM_PER_MM * J.reshape(-1, model.size)


def _compare_sigmas(quantity: TrialQuantity) -> float:
    stated = quantity.linear > 2.0 * 1e-6 * quantity.linear.max(initial=0.0)
    if not stated.any():
        return 0.0
    ratio = quantity.sigma[stated] / quantity.linear[stated]
    return float(np.abs(ratio - 1.0).max())


def trials_json(held: TrialResults) -> dict[str, Any]:
    """Content of the key `monte_carlo` of `result.json`."""
    named = {q.name: q for q in held.quantities}
    return {
        "method": METHOD,
        "seed": held.plan.seed,
        "trials": held.trials,
        "block": BLOCK,
        "significant_digits": held.plan.digits,
        "coverage": COVERAGE,
        "interval": held.plan.interval,
        "settled": held.settled,
        "agrees": held.agrees,
        "numbers": held.numbers,
        "agreeing": held.agreeing,
        "largest_disagreement": held.disagreement,
        "error_tables": {
            q.name: {
                f"position_{q.position_unit}": q.position[:, 0].tolist(),
                **_columns_json(q),
            }
            for q in held.quantities
            if q.position_unit
        },
        "squareness_urad": {
            n: _single_json(q) for n, q in named.items() if n in SQUARENESS
        },
        "axis_location": {
            n: _single_json(q) for n, q in named.items() if is_location(n)
        },
        "volumetric_error": {
            "of": "x, y and z of one position after another",
            "position": named[MAP].position.tolist(),
            **_columns_json(named[MAP]),
        },
    }


def _columns_json(q: TrialQuantity) -> dict[str, Any]:
    return {
        f"value_{q.unit}": q.value.tolist(),
        f"linear_uncertainty_{q.unit}": q.linear.tolist(),
        f"mean_{q.unit}": q.mean.tolist(),
        f"uncertainty_{q.unit}": q.sigma.tolist(),
        f"interval_95_low_{q.unit}": q.low.tolist(),
        f"interval_95_high_{q.unit}": q.high.tolist(),
        f"tolerance_{q.unit}": q.tolerance.tolist(),
        "agrees": q.agrees.tolist(),
    }


def _single_json(q: TrialQuantity) -> dict[str, Any]:
    return {key: value[0] for key, value in _columns_json(q).items()}
