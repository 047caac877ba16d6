"""The mean and spread of a scanned value whose likelihood is not symmetric.

A time constant longer than the Run hardly differs from a longer one, and the final
growth depends on it: the slope at the best value understates the uncertainty. Values
around the best one are weighted by their evidence, all values of the scan being equally
likely beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.discovery.term_data import TermData
from app.kinematics.effects.candidate_term import CandidateTerm

_BELOW, _ABOVE = -4, 10  # standard uncertainties by the slope, in whole steps
_FEWEST = 3  # values, for any to lie between others


def average_value(
    data: TermData, beside: Sequence[CandidateTerm], term: CandidateTerm
) -> CandidateTerm:
    """Return a term at the mean of its scanned value, with the spread of all values.

    beside : terms that are fitted with it
    term : at its best value, its uncertainty by the slope
    """
    at = data.conditions_of(term)
    scan, best = term.scan(at), term.candidate.value
    if scan is None or best is None:
        return term
    steps = best + term.value_sigma * np.arange(_BELOW, _ABOVE + 1)
    values = np.unique(np.clip(steps, scan.values[0], scan.values[-1]))
    if len(values) < _FEWEST:
        return term
    trials = data.try_values(beside, term, values)
    # Where values of the scan lie farther apart, fewer of them are equally likely.
    density = 1.0 / np.interp(values, scan.values, np.gradient(scan.values))
    weight = np.exp(trials.log_bayes - trials.log_bayes.max())
    weight *= density * np.gradient(values)
    weight /= weight.sum()
    mean = float(weight @ values)
    off = trials.theta - weight @ trials.theta
    return replace(
        term.with_value(mean),
        value_sigma=float(np.sqrt(weight @ (values - mean) ** 2)),
        covariance=np.tensordot(weight, trials.covariance, 1) + (off.T * weight) @ off,
    )
