"""How well a scanned value is known whose odds fall more slowly to one side.

A time constant longer than the Run is hardly told from a longer one, and the growth it
ends at goes with it: the slope at the best value says too little. So values about it
are weighed by what each explains, all values of the scan being as likely beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.discovery.evidence import prior_precision, rest
from app.discovery.scan import Offer
from app.discovery.sums import Lines
from app.kinematics.conditions import Conditions

_BELOW, _ABOVE = -4, 10  # standard uncertainties by the slope, in whole steps
_FEWEST = 3  # values, for any to lie between others


def spread(
    lines: Lines,
    at: Conditions,
    precision: Float64[np.ndarray, "b b"],
    others: Sequence[Offer],
    offer: Offer,
) -> Offer:
    """Return an offer at the mean of its value, with the spread of all it may be.

    at : conditions of its Run; precision : prior of base and poses
    others : known effects; offer : at its best value, its uncertainty by the slope
    """
    scan, best = offer.family.scan(offer.candidate, at), offer.candidate.value
    if scan is None or best is None:
        return offer
    steps = best + offer.value_sigma * np.arange(_BELOW, _ABOVE + 1)
    values = np.unique(np.clip(steps, scan.values[0], scan.values[-1]))
    if len(values) < _FEWEST:
        return offer
    gain, theta, covariance = _fits(lines, at, precision, others, offer, values)
    # Of values as likely beforehand there are fewer where the scan's lie further apart.
    density = 1.0 / np.interp(values, scan.values, np.gradient(scan.values))
    weight = np.exp(gain - gain.max()) * density * np.gradient(values)
    weight /= weight.sum()
    mean = float(weight @ values)
    off = theta - weight @ theta
    return replace(
        offer,
        candidate=offer.at_value(at, mean),
        value_sigma=float(np.sqrt(weight @ (values - mean) ** 2)),
        covariance=np.tensordot(weight, covariance, 1) + (off.T * weight) @ off,
    )


def _fits(
    lines: Lines,
    at: Conditions,
    precision: Float64[np.ndarray, "b b"],
    others: Sequence[Offer],
    offer: Offer,
    values: Float64[np.ndarray, " v"],
) -> tuple[
    Float64[np.ndarray, " v"], Float64[np.ndarray, "v p"], Float64[np.ndarray, "v p p"]
]:
    """Return log Bayes factor, parameters and their covariance at each value."""
    tries = [offer.at_value(at, float(v)) for v in values]
    offered = lines.offered(
        [o.effect for o in others], [offer.effect_of(c) for c in tries]
    )
    left = rest(offered, prior_precision(precision, [o.candidate for o in others]))
    known = prior_precision(np.zeros((0, 0)), [offer.candidate])
    covariance = np.linalg.inv(np.array(left.information) + known)
    theta = np.einsum("vpq,vq->vp", covariance, np.array(left.data))
    gain = [left.log_bayes(k, c.usual) for k, c in enumerate(tries)]
    return np.array(gain), theta, covariance
