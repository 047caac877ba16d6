"""What trials say of a result, as the key `monte_carlo` of `result.json` states it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from app.kinematics.symbols import SQUARENESS, is_location
from app.numerics.adaptive_trials import BLOCK, COVERAGE
from app.results.trial_results import MAP, TrialQuantity, TrialResults

METHOD = "JCGM 101:2008, adaptive (7.9.4), held against the linear law (8)"


def trials_json(held: TrialResults) -> dict[str, Any]:
    """Return what the trials say, beside what the linear law says."""
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
                **_stated(q),
            }
            for q in _tables(held.quantities)
        },
        "squareness_urad": {n: _single(q) for n, q in named.items() if n in SQUARENESS},
        "axis_location": {n: _single(q) for n, q in named.items() if is_location(n)},
        "volumetric_error": {
            "of": "x, y and z of one position after another",
            "position": named[MAP].position.tolist(),
            **_stated(named[MAP]),
        },
    }


def _tables(quantities: Iterable[TrialQuantity]) -> list[TrialQuantity]:
    return [q for q in quantities if q.position_unit]


def _stated(q: TrialQuantity) -> dict[str, Any]:
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


def _single(q: TrialQuantity) -> dict[str, Any]:
    return {key: value[0] for key, value in _stated(q).items()}
