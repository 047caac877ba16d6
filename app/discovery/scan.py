"""Look for what is not linear (leads, time constants, moments) in what is left.

The quick gain takes the effect as orthogonal to the base and the Ornstein–Uhlenbeck
noise as white: good enough to find where a scan peaks. What counts is then computed
exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from app.discovery.evidence import log_bayes
from app.discovery.spectrum import transform
from app.discovery.view import TIMING, FastSums, View
from app.discovery.whitened import Line
from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, in_run
from app.kinematics.effects.catalogue import Candidate, Family, Scan, Wave, averaged
from app.kinematics.effects.of_run import OfRun

_RATES = 8  # groups of cells of like rate
_FINER = 17  # values between neighbours of a scan's best one
_SHARP = 0.01  # of the distance between neighbours
_HOPELESS = (
    1.0  # log Bayes factor of a best value that neighbours cannot raise to matter
)


@dataclass(frozen=True)
class Offer:
    """A candidate with its family, and what looking for it costs.

    run : that it ends with; None for what the machine takes to all Runs
    price : log of how many values were looked at besides
    value_sigma : standard uncertainty of the scanned value
    covariance : of the effect's parameters where the scanned value is not known better
        than that
    """

    family: Family
    candidate: Candidate
    run: int | None = None
    price: float = 0.0
    value_sigma: float = 0.0
    covariance: Float64[np.ndarray, "p p"] | None = None

    @property
    def effect(self) -> Effect:
        """The candidate's effect, where it shows."""
        return self.effect_of(self.candidate)

    @property
    def label(self) -> str:
        """Name and keys, and the Run beyond the first."""
        return in_run(self.candidate.label, self.run or 0)

    def effect_of(self, candidate: Candidate) -> Effect:
        """Return the effect of the candidate at another value."""
        if self.run is None:
            return candidate.effect
        return OfRun(candidate.effect, self.run)

    def at_value(self, at: Conditions, value: float) -> Candidate:
        """Return the candidate with what is scanned at another value."""
        return self.family.at_value(self.candidate, at, value)


@dataclass(frozen=True)
class Residual:
    """What is left of a Run's data where the tracker stands, and weighted: V⁻¹ r.

    left_mm : (n, 3), phase and speed of each line taken out; weighted : (n, 3)
    precision : (n, 3, 3) of the white noise, in the frame the tracker stands on
    ou, ou_time_s : density of the Ornstein–Uhlenbeck noise over that of the white at
        frequency 0, and its correlation time
    within : samples within their cells, where fast effects show as well
    """

    at: Conditions
    left_mm: Float64[np.ndarray, "n 3"]
    weighted: Float64[np.ndarray, "n 3"]
    precision: Float64[np.ndarray, "n 3 3"]
    ou: float
    ou_time_s: float
    within: FastSums | None = None

    def ou_power(
        self, frequency_hz: Float64[np.ndarray, " f"]
    ) -> Float64[np.ndarray, " f"]:
        """Return the density of the correlated noise in units of the white noise's."""
        turn = 2.0 * np.pi * frequency_hz * self.ou_time_s
        return self.ou / (1.0 + turn**2)


def weighted_residual(
    view: View,
    lines: Sequence[Line],
    effects: Sequence[Effect],
    theta: Float64[np.ndarray, " p"],
) -> Residual:
    """Return what base and effects leave, phase and speed of each line taken out.

    lines : of this view
    """
    seen, base = view.seen, view.base
    left_mm, weighted = np.zeros((2, len(seen), 3))
    precision = np.zeros((len(seen), 3, 3))
    moved = np.zeros((len(seen), 3, 1))
    for effect, own in zip(effects, _parts(effects, theta), strict=True):
        moved[:, :, 0] += effect.jacobian(seen.at) @ own
    known = theta[: base.size, None]
    for line in lines:
        cells, frame, whitener = line.cells, line.frame, line.whitener
        timing, machine = line.rows[:, :, :TIMING], line.rows[:, :, TIMING:-1]
        left = line.rows[:, :, -1:] - machine @ known - frame @ moved[cells]
        applied = whitener.applied(np.concatenate([timing, left], axis=2))
        H = np.tensordot(timing, applied[:, :, :TIMING], axes=((0, 1), (0, 1)))
        pull = np.tensordot(timing, applied[:, :, -1], axes=((0, 1), (0, 1)))
        late = np.linalg.lstsq(H, pull, rcond=1e-10)[0]
        out = applied[:, :, -1] - applied[:, :, :TIMING] @ late
        weighted[cells] = np.einsum("nij,ni->nj", frame, out)
        left_mm[cells] = np.einsum("nij,ni->nj", frame, left[:, :, 0] - timing @ late)
        root = np.matmul(whitener.root, frame)
        precision[cells] = np.matmul(np.swapaxes(root, 1, 2), root)
    noise, rate_hz = base.noise, seen.at.machine.tracker.rate_hz
    ratio = np.mean(np.square(noise.ou)) / np.mean(np.square(noise.white))
    ou = float(ratio) * 2.0 * noise.ou_time_s * rate_hz
    return Residual(
        seen.at,
        left_mm,
        weighted,
        precision,
        ou,
        noise.ou_time_s,
        view.within,
    )


def _parts(
    effects: Sequence[Effect], theta: Float64[np.ndarray, " p"]
) -> list[Float64[np.ndarray, " q"]]:
    """Return the parameters of each effect, which are the last ones."""
    sizes = [len(effect.parameters) for effect in effects]
    first = len(theta) - sum(sizes)
    ends = first + np.cumsum([0, *sizes])
    return [theta[a:b] for a, b in pairwise(ends)]


def scanned(offer: Offer, left: Sequence[Residual]) -> Offer:
    """Return the offer at the value of its scan that promises most.

    left : of all Runs, in their order
    """
    left = left if offer.run is None else left[offer.run : offer.run + 1]
    at = left[0].at
    scan = offer.family.scan(offer.candidate, at)
    if scan is None:
        return offer
    wave = offer.family.wave(offer.candidate, at)
    if wave is not None:
        value = _best_wave(offer, scan, wave, left)
    else:
        value = _best_value(offer, scan, left)
    price = float(np.log(max(len(scan.values) / 4.0, 1.0)))
    return Offer(offer.family, offer.at_value(at, value), offer.run, price)


def _best_wave(offer: Offer, scan: Scan, wave: Wave, left: Sequence[Residual]) -> float:
    """Return the value of a scan of waves that promises most, between them as well."""
    best = int(np.argmax(_wave_gains(offer, wave.waves, left)))
    around = slice(max(best - 1, 0), best + 2)
    order = np.argsort(wave.waves[around])
    waves, values = wave.waves[around][order], scan.values[around][order]
    share = np.arange(_FINER) / (_FINER - 1)
    fine = float(waves[0]) + share * float(waves[-1] - waves[0])
    best = int(np.argmax(_wave_gains(offer, fine, left)))
    return float(np.interp(float(fine[best]), waves, values))


def _best_value(offer: Offer, scan: Scan, left: Sequence[Residual]) -> float:
    """Return the value of any other scan that promises most."""
    gains = np.array([_gain(offer, left, float(v)) for v in scan.values])
    best = int(np.argmax(gains))
    if gains[best] < _HOPELESS:
        return float(scan.values[best])
    around = scan.values[max(best - 1, 0) : best + 2]
    found = minimize_scalar(
        lambda v: -_gain(offer, left, float(v)),
        bounds=(around[0], around[-1]),
        method="bounded",
        options={"xatol": _SHARP * float(np.ptp(around)), "maxiter": 20},
    )
    return float(found.x) if -found.fun >= gains[best] else float(scan.values[best])


def _is_fast(offer: Offer) -> bool:
    return offer.candidate.effect.in_time(np.zeros(1)) is not None


def _gain(offer: Offer, left: Sequence[Residual], value: float) -> float:
    candidate = offer.at_value(left[0].at, value)
    size = len(candidate.usual)
    data, information = np.zeros(size), np.zeros((size, size))
    for one in left:
        J = candidate.effect.jacobian(one.at)
        data += np.einsum("nip,ni->p", J, one.weighted)
        information += np.einsum("nip,niq->pq", J, one.precision @ J)
        if one.within is not None and _is_fast(offer):
            fast, _ = one.within.sums([candidate.effect], 1)
            information += fast[0, :-1, :-1]
            data += fast[0, :-1, -1]
    return log_bayes(information, data, candidate.usual)


def _wave_gains(
    offer: Offer, waves: Float64[np.ndarray, " v"], left: Sequence[Residual]
) -> Float64[np.ndarray, " v"]:
    """Return the quick gain of all values of a wave at once."""
    total, told = np.zeros(len(waves), complex), np.zeros(len(waves))
    for one in left:
        wave = offer.family.wave(offer.candidate, one.at)
        if wave is not None:
            wave = replace(wave, waves=waves)
            pulled, weight = _wave_sums(wave, one)
            total += pulled
            told += weight
            if one.within is not None and _is_fast(offer):
                pulled, weight = one.within.wave(wave)
                total += pulled
                told += weight
    usual = float(offer.candidate.usual[0])
    told *= usual**2
    power = 0.5 * np.abs(total) ** 2 * usual**2
    return power / (1.0 + told) - np.log1p(told)


def _wave_sums(
    wave: Wave, left: Residual
) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
    """Return what a Run holds of each wave, and with which weight.

    Cells of like rate average a wave alike, and see it at a like frequency in time,
    where the Ornstein–Uhlenbeck noise has its share.
    """
    data = np.einsum("ni,ni->n", wave.arm, left.weighted)
    weight = np.einsum("ni,nij,nj->n", wave.arm, left.precision, wave.arm)
    around = left.at.recorded
    span = np.zeros(len(data)) if around is None else around.span_s
    total, told = np.zeros(len(wave.waves), complex), np.zeros(len(wave.waves))
    for cells in _of_like_rate(wave.rate):
        rate = float(np.mean(wave.rate[cells]))
        turn = 2.0 * np.pi * wave.waves * rate
        kept = averaged(turn, np.full(len(turn), float(np.mean(span[cells]))))
        total += kept * transform(wave.coordinate[cells], data[cells], wave.waves)
        share = 1.0 / (1.0 + left.ou_power(wave.waves * rate))
        told += 0.5 * kept**2 * share * float(weight[cells].sum())
    return total, told


def _of_like_rate(rate: Float64[np.ndarray, " n"]) -> list[Int64[np.ndarray, " m"]]:
    """Return cells in groups of like rate."""
    if np.ptp(rate) <= 1e-9 * max(float(rate.max()), 1e-12):
        return [np.arange(len(rate))]
    order = np.argsort(rate, kind="stable")
    return [part for part in np.array_split(order, _RATES) if len(part)]
