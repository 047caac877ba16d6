"""The scale of all lengths: its uncertainty by the air, and evidence of known lengths.

No residual shows a wrong scale of the tracker, s: it looks like a machine whose axes
are all too long. So s is kept apart from the estimate with a separate variance, and a
known length L that was measured as m is an observation of it,

    m / L - 1 = s + H θ + ε,

H being the effect of the tracker's other errors on that length, by the same terms as in
the estimate. Updated by it (Kalman), the estimate loses s times the stretch that it
looks like, and its covariance includes the remaining uncertainty of s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.estimation.solve.batch import Estimate, RunEstimate
from truepath.files.bundle.run import KnownLength
from truepath.kinematics.conditions import RecordedState, make_standstill
from truepath.kinematics.effects.instrument import SetUpErrors, is_tracker_error
from truepath.kinematics.model import MachineModel, compute_scale_parameters

_CONTRADICTED = 3.0  # standard uncertainties
_ANY = 300e-6  # a hall from vacuum: the assumed air was wrong


@dataclass(frozen=True, slots=True)
class KnownScale:
    """The scale of the tracker's ranges by known lengths.

    lengths : their number
    off, sigma : relative excess of ranges, with its standard uncertainty
    is_expected : air and tracker explain it
    """

    lengths: int
    off: float
    sigma: float
    is_expected: bool


def settle_scale(
    estimate: Estimate, scale: float, known: Sequence[Sequence[KnownLength]]
) -> tuple[Estimate, float, KnownScale | None]:
    """The estimate with the scale of all lengths in it, and its uncertainty.

    scale : relative standard uncertainty by air and tracker
    known : lengths measured in each Run of the estimate
    """
    count = sum(map(len, known))
    if not count:
        return estimate.widen_by_scale(scale), scale, None
    measured = [
        _KnownLengths.of(lengths, run, estimate.model)
        for lengths, run in zip(known, estimate.runs, strict=True)
        if lengths
    ]
    H = np.vstack([one.rows for one in measured])
    off = np.concatenate([one.off for one in measured]) - H @ estimate.theta
    # One bar, most often: all share the uncertainty of its best length.
    common = np.concatenate([one.common for one in measured])
    noise = np.concatenate([one.noise for one in measured])
    least = float(common.min()) ** 2
    among = least + np.diag(common**2 - least + noise)
    other = H @ estimate.covariance @ H.T + among
    weight = np.linalg.solve(other, np.ones(count))
    found_off = float(weight @ off / weight.sum())
    sigma = float(weight.sum() ** -0.5)
    is_expected = abs(found_off) <= _CONTRADICTED * float(np.hypot(sigma, scale))
    if not is_expected:
        scale = max(scale, _ANY)
    at_all = other + scale**2
    gain_theta = np.linalg.solve(at_all, H @ estimate.covariance).T
    gain_scale = np.linalg.solve(at_all, np.full(count, scale**2))
    theta, s = estimate.theta + gain_theta @ off, float(gain_scale @ off)
    covariance = estimate.covariance - gain_theta @ H @ estimate.covariance
    shared = -(scale**2) * gain_theta.sum(axis=1)
    variance = scale**2 * (1.0 - float(gain_scale.sum()))
    stretch = compute_scale_parameters(estimate.model)
    apart = np.outer(shared, stretch)
    settled = replace(
        estimate,
        theta=theta - s * stretch,
        covariance=covariance + variance * np.outer(stretch, stretch) - apart - apart.T,
    )
    found = KnownScale(count, found_off, sigma, is_expected)
    return settled, max(variance, 0.0) ** 0.5, found


@dataclass(frozen=True, slots=True)
class _KnownLengths:
    """Relative excess of the measured known lengths of one Run.

    off : (n,), rows : (n, p) of the model
    common : (n,) standard uncertainty of the length; noise : (n,) variance of the
        tracker's noise
    """

    off: Float64[np.ndarray, " n"]
    rows: Float64[np.ndarray, "n p"]
    common: Float64[np.ndarray, " n"]
    noise: Float64[np.ndarray, " n"]

    @staticmethod
    def of(
        lengths: Sequence[KnownLength], run: RunEstimate, model: MachineModel
    ) -> _KnownLengths:
        ends_mm = np.array([one.ends_mm for one in lengths])
        measured, length, sigma = np.array(
            [(one.measured_mm, one.length_mm, one.sigma_mm) for one in lengths]
        ).T
        along = ends_mm[:, 1] - ends_mm[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        distance_mm = np.linalg.norm(ends_mm, axis=2)
        cosine = np.einsum("nei,ni->ne", ends_mm, along) / distance_mm
        noise_mm = run.tracker.sigma_mm(distance_mm.ravel()).reshape(-1, 2, 2)
        square = (noise_mm[..., 0] * cosine) ** 2
        square += noise_mm[..., 1] ** 2 * (1.0 - cosine**2)
        # Before or after the measurement, which determines the mean scale.
        drift = 0.5e-6 * run.tracker.systematic.scale_drift_ppm
        return _KnownLengths(
            measured / length - 1.0,
            _trace_errors(ends_mm, along, run, model) / length[:, None],
            np.hypot(sigma / length, drift),
            square.sum(axis=1) / length**2,
        )


def _trace_errors(
    ends_mm: Float64[np.ndarray, "n 2 3"],
    along: Float64[np.ndarray, "n 3"],
    run: RunEstimate,
    model: MachineModel,
) -> Float64[np.ndarray, "n p"]:
    rows = np.zeros((len(ends_mm), model.size))
    if run.rotation is None:
        return rows
    points_mm = ends_mm.reshape(-1, 3)
    machine = replace(model.machine, tracker=run.tracker)
    nowhere = np.zeros((len(points_mm), len(machine.axes)))
    still, endless = np.zeros_like(nowhere), np.full_like(nowhere, np.inf)
    recorded = RecordedState(
        still,
        np.zeros(len(points_mm)),
        endless,
        points_mm,
        run.rotation,
        set_up=run.set_up,
    )
    at = replace(make_standstill(machine, nowhere), recorded=recorded)
    for effect in filter(is_tracker_error, model.effects):
        if isinstance(effect, SetUpErrors) and effect.set_up in ("", run.set_up):
            middle_s = 0.5 * (effect.begin_s + effect.end_s)
            at = replace(at, time_s=np.full(len(points_mm), middle_s))
    for effect in filter(is_tracker_error, model.effects):
        moved = np.einsum("ij,njp->nip", run.rotation, effect.jacobian(at))
        first, second = moved[::2], moved[1::2]
        rows[:, model.slices[effect.name]] = np.einsum(
            "nip,ni->np", second - first, along
        )
    return rows
