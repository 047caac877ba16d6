"""A quick scan of nonlinear values: leads, time constants, event times.

The term is taken as orthogonal to the machine and the Ornstein–Uhlenbeck noise as
white: accurate enough to find where a scan peaks. The exact evidence comes later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from truepath.discovery.evidence import log_bayes
from truepath.discovery.line_blocks import Residual
from truepath.estimation.checks.intra_cell_motion import transform
from truepath.kinematics.effects.family import CandidateTerm, Scan, Wave
from truepath.kinematics.effects.sinusoid import attenuate_wave

_RATES = 8  # groups of cells of similar rate
_FINER = 17  # values between neighbours of a scan's best one
_SHARP = 0.01  # of the distance between neighbours
_HOPELESS = 1.0  # log Bayes factor of a best value that neighbours cannot raise enough


def scan_term(term: CandidateTerm, residuals: Sequence[Residual]) -> CandidateTerm:
    """The term at the most promising value of its scan.

    residuals : of all Runs, in their order
    """
    if term.run is not None:
        residuals = residuals[term.run : term.run + 1]
    at = residuals[0].at
    scan, wave = term.scan(at), term.wave(at)
    if scan is None:
        return term
    if wave is not None:
        value = _best_wave(term, scan, wave, residuals)
    else:
        value = _best_value(term, scan, residuals)
    price = float(np.log(max(len(scan.values) / 4.0, 1.0)))
    return replace(term.with_value(value), price=price)


def _best_wave(
    term: CandidateTerm, scan: Scan, wave: Wave, residuals: Sequence[Residual]
) -> float:
    best = int(np.argmax(_wave_gains(term, wave.waves, residuals)))
    around = slice(max(best - 1, 0), best + 2)
    order = np.argsort(wave.waves[around])
    waves, values = wave.waves[around][order], scan.values[around][order]
    share = np.arange(_FINER) / (_FINER - 1)
    fine = float(waves[0]) + share * float(waves[-1] - waves[0])
    best = int(np.argmax(_wave_gains(term, fine, residuals)))
    return float(np.interp(float(fine[best]), waves, values))


def _best_value(
    term: CandidateTerm, scan: Scan, residuals: Sequence[Residual]
) -> float:
    if term.family.happens_once:
        gains = _moment_gains(term, residuals, scan.values)
    else:
        gains = np.array([_gain(term, residuals, float(v)) for v in scan.values])
    best = int(np.argmax(gains))
    if gains[best] < _HOPELESS:
        return float(scan.values[best])
    around = scan.values[max(best - 1, 0) : best + 2]
    found = minimize_scalar(
        lambda v: -_gain(term, residuals, float(v)),
        bounds=(around[0], around[-1]),
        method="bounded",
        options={"xatol": _SHARP * float(np.ptp(around)), "maxiter": 20},
    )
    return float(found.x) if -found.fun >= gains[best] else float(scan.values[best])


def _gain(term: CandidateTerm, residuals: Sequence[Residual], value: float) -> float:
    candidate = term.with_value(value).candidate
    data, information = np.zeros(term.size), np.zeros((term.size, term.size))
    for one in residuals:
        J = candidate.effect.jacobian(one.at)
        flat = J.reshape(-1, term.size)
        data += flat.T @ one.weighted.ravel()
        information += flat.T @ np.matmul(one.precision, J).reshape(flat.shape)
        if one.within is not None and term.is_fast:
            fast, _ = one.within.sums([candidate.effect], 1)
            information += fast[0, :-1, :-1]
            data += fast[0, :-1, -1]
    return log_bayes(information, data, candidate.prior_sigma)


def _moment_gains(
    term: CandidateTerm,
    residuals: Sequence[Residual],
    moment_s: Float64[np.ndarray, " v"],
) -> Float64[np.ndarray, " v"]:
    """Quick log Bayes factor of a one-time term at each moment.

    All cells before a moment are as if it never came, all others as if it had been.
    """
    count, size = len(moment_s), term.size
    data, information = np.zeros((count, size)), np.zeros((count, size, size))
    for one in residuals:
        begin = np.searchsorted(one.at.time_s, moment_s)
        pulled: list[Float64[np.ndarray, "n p"]] = []
        square: list[Float64[np.ndarray, "n p p"]] = []
        for at_s in (np.inf, -np.inf):
            J = term.with_value(at_s).candidate.effect.jacobian(one.at)
            pulled.append(np.einsum("nip,ni->np", J, one.weighted))
            square.append(np.swapaxes(J, 1, 2) @ one.precision @ J)
        data += _sum_sides(pulled[0], pulled[1], begin)
        information += _sum_sides(square[0], square[1], begin)
    each, typical = zip(information, data, strict=True), term.candidate.prior_sigma
    return np.array([log_bayes(S, r, typical) for S, r in each])


def _sum_sides(
    before: Float64[np.ndarray, "n ..."],
    after: Float64[np.ndarray, "n ..."],
    begin: Int64[np.ndarray, " v"],
) -> Float64[np.ndarray, "v ..."]:
    """Sums over rows, those from each beginning on from `after`."""
    change = np.cumsum(before - after, axis=0)
    change = np.concatenate([np.zeros_like(change[:1]), change])
    return after.sum(axis=0) + change[begin]


def _wave_gains(
    term: CandidateTerm,
    waves: Float64[np.ndarray, " v"],
    residuals: Sequence[Residual],
) -> Float64[np.ndarray, " v"]:
    data, information = np.zeros(len(waves), complex), np.zeros(len(waves))
    for one in residuals:
        wave = term.wave(one.at)
        if wave is None:
            continue
        wave = replace(wave, waves=waves)
        parts = [_wave_sums(wave, one)]
        if one.within is not None and term.is_fast:
            parts.append(one.within.wave(wave))
        for products, weight in parts:
            data += products
            information += weight
    typical = float(term.candidate.prior_sigma[0])
    information *= typical**2
    power = 0.5 * np.abs(data) ** 2 * typical**2
    return power / (1.0 + information) - np.log1p(information)


def _wave_sums(
    wave: Wave, residual: Residual
) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
    """Data and information of a Run for each wave.

    Cells of similar rate average a wave alike, and have it at a similar frequency in
    time, where the Ornstein–Uhlenbeck noise adds to the white noise.
    """
    data = np.einsum("ni,ni->n", wave.arm, residual.weighted)
    weight = np.einsum("ni,nij,nj->n", wave.arm, residual.precision, wave.arm)
    around = residual.at.recorded
    span = np.zeros(len(data)) if around is None else around.span_s
    products = np.zeros(len(wave.waves), complex)
    information = np.zeros(len(wave.waves))
    for cells in _group_by_rate(wave.rate):
        rate = float(np.mean(wave.rate[cells]))
        angular_rate = 2.0 * np.pi * wave.waves * rate
        span_s = np.full(len(angular_rate), float(np.mean(span[cells])))
        kept = attenuate_wave(angular_rate, span_s)
        products += kept * transform(wave.coordinate[cells], data[cells], wave.waves)
        share = 1.0 / (1.0 + residual.ou_density(wave.waves * rate))
        information += 0.5 * kept**2 * share * float(weight[cells].sum())
    return products, information


def _group_by_rate(rate: Float64[np.ndarray, " n"]) -> list[Int64[np.ndarray, " m"]]:
    if np.ptp(rate) <= 1e-9 * max(float(rate.max()), 1e-12):
        return [np.arange(len(rate))]
    order = np.argsort(rate, kind="stable")
    return [part for part in np.array_split(order, _RATES) if len(part)]
