"""What a fit leaves that noise does not explain: of cells, of lines, of time.

Everything here is a score test (Rao 1948): how far would the fit improve if a parameter
were added, told by the residuals of the fit as it is, without another solve. With
r = y − Aθ, W = V⁻¹ (timing of the lines taken out), H = AᵀWA + prior and columns B of
what might be added, the gain is gᵀF⁻¹g with g = BᵀWr and F = BᵀWB − BᵀWA H⁻¹ AᵀWB.

A step of the tracker's or the reflector's place has the columns of the pose for all
that comes after it. Sums over lines, accumulated from the end, give B for all moments
at once. A step counts only as far as slow drift of pose and size does not explain it as
well, and as far as it stands out from what no step explains: a machine that warms, or
an effect that the model lacks, is no knock.

The noise is at most what is usual here: it must not explain what it should show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from app.estimation.design_matrix import DesignMatrix, Linearisation
from app.estimation.direction import Fit
from app.estimation.information import Information, add_information
from app.estimation.noise import NoiseModel, total_precision
from app.estimation.runs import RunInformation
from app.numerics.correlated_noise import Whitener
from app.numerics.scaled_cholesky import ScaledCholesky

_MOST_OU, _LONGEST_OU_S = 0.3, 2.0  # of the stated noise: more is for a test to show
_DRIFTS = 36  # pose and strain, each with three polynomials of time
_AT_ONCE = 64  # steps within a line
_UNSEEN = 0.02  # of a column's information: the fit explains it all


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the pose before one cell.

    cell : the first after it; gain : of −2 log likelihood, beyond that of a drift
    alone : gain where there is no drift; moved_mm : by how far, at the middle
    """

    cell: int
    gain: float
    alone: float
    moved_mm: float


@dataclass(frozen=True, slots=True)
class Misfit:
    """What the fit leaves of one Run.

    cell : (n,) squares of the cells' residuals, whitened; off_mm : (n,) their size
    begin, end : (l,) cells of each line or standstill
    line : (l,) gain of a shift of each
    square : of all residuals, whitened; freedom : what noise alone would make of it
    drift : gain of a drift of pose and size; drift_mm : root mean square of it
    step : the best, None where none can be told
    """

    cell: Float64[np.ndarray, " n"]
    off_mm: Float64[np.ndarray, " n"]
    begin: Int64[np.ndarray, " l"]
    end: Int64[np.ndarray, " l"]
    line: Float64[np.ndarray, " l"]
    square: float
    freedom: float
    drift: float
    drift_mm: float
    step: Step | None

    @property
    def rest(self) -> float:
        """What neither step nor drift explains, of what noise alone would leave."""
        explained = self.drift + (self.step.gain if self.step else 0.0)
        return max(1.0, (self.square - explained) / self.freedom)


def assess_misfit(fit: Fit, number: int) -> Misfit:
    """Return what the fit leaves of one of its Runs."""
    return _Examination(fit, number).assess()


class _Examination:
    """One Run about the solution under the usual noise, and its sums by line."""

    def __init__(self, fit: Fit, number: int) -> None:
        run = fit.runs[number]
        noise = limit_noise(run.noise)
        run = run if noise == run.noise else run.replace_noise(noise)
        self.seen, self.about = run.observations, run.linearisation
        self.machine = self.about.machine_model.size
        factor, self.theta = _solve(fit, run, number)
        self.solve = factor.solve
        time_s = self.seen.at.time_s
        middle, half = 0.5 * (time_s[0] + time_s[-1]), 0.5 * (time_s[-1] - time_s[0])
        self.span_s = float(middle), max(float(half), 1e-9)
        self.centre = self.seen.at.point_mm.mean(axis=0)

    def assess(self) -> Misfit:
        """Return what the fit leaves."""
        begin, end = np.array(self.seen.lines, np.int64).T
        p, drifts = self.about.size, _DRIFTS
        # By line: columns of fit, residual and drift, times those of the pose.
        pose = np.zeros((len(begin), p + 1 + drifts, 6))
        smooth = np.zeros((p + 1 + drifts, drifts))
        squares: list[Float64[np.ndarray, " k"]] = []
        off: list[Float64[np.ndarray, " k"]] = []
        drift_square = np.zeros((drifts, drifts))
        shifts: list[float] = []
        square, freedom = 0.0, 3.0 * len(self.seen)
        for design in self.about.split(self.seen):
            whitener = design.whiten(self.about.noise)
            rest = design.residual - design.columns @ self.theta
            S = self._drift_columns(design)
            all_ = np.concatenate([design.columns, rest[:, :, None], S], axis=2)
            weighted = weigh(design, whitener, all_[:, :, self.machine : p])
            for first, last in design.observations.lines:
                part = all_[first:last].reshape(-1, all_.shape[2])
                pose[len(shifts)] = part.T @ weighted[first:last].reshape(-1, 6)
                shifts.append(self._shift(design, rest, slice(first, last)))
            flat = all_.reshape(-1, all_.shape[2])
            smooth += flat.T @ weigh(design, whitener, S).reshape(len(flat), -1)
            drift_square += np.einsum("nip,niq->pq", S, S)
            left = rest[:, :, None]
            square += float(np.sum(left * weigh(design, whitener, left)))
            freedom -= design.timing.shape[2] + _count_untimed(design, self.about)
            rest = rest - explain_timing(design, whitener, rest)
            squares.append(_cell_squares(design, rest, self.about.noise))
            off.append(np.linalg.norm(rest, axis=1))
        drift = _Gain(self, smooth, p)
        size = drift.size @ drift_square @ drift.size / max(len(self.seen), 1)
        return Misfit(
            np.concatenate(squares),
            np.concatenate(off),
            begin,
            end,
            np.array(shifts),
            square,
            freedom,
            drift.gain,
            float(np.sqrt(max(size, 0.0))),
            self._best_step(pose, drift, begin, end),
        )

    def _shift(
        self, design: DesignMatrix, rest: Float64[np.ndarray, "n 3"], cells: slice
    ) -> float:
        """Return the gain of a shift of one line, by itself."""
        own = replace(
            design,
            observations=design.observations.select(np.r_[cells]),
            frame=design.frame[cells],
            rows=design.rows[cells],
        )
        timing = own.timing.any(axis=(0, 1))
        kept = np.concatenate([np.ones(own.fixed + 1, bool), timing])
        own = replace(own, rows=own.rows[:, :, kept])
        P = own.columns[:, :, self.machine : self.machine + 3]
        weighted = weigh(own, own.whiten(self.about.noise), P).reshape(-1, 3)
        F = P.reshape(-1, 3).T @ weighted
        pulled = rest[cells].reshape(-1) @ weighted
        return float(pulled @ invert(F, np.diag(F)) @ pulled)

    def _drift_columns(self, design: DesignMatrix) -> Float64[np.ndarray, "n 3 s"]:
        """Return pose and strain, each growing with polynomials of time."""
        at = design.observations.at
        pose = design.columns[:, :, self.machine :]
        x, y, z = ((at.point_mm - self.centre) / 1e3).T  # µm/mm is 1e-3
        strain = np.zeros((len(at), 3, 6))
        strain[:, 0, 0], strain[:, 1, 1], strain[:, 2, 2] = x, y, z
        strain[:, 0, 3], strain[:, 0, 4], strain[:, 1, 5] = y, z, z
        columns = np.concatenate([pose, design.frame @ strain], axis=2)
        u = (at.time_s - self.span_s[0]) / self.span_s[1]
        time = (u, 1.5 * u**2 - 0.5, 2.5 * u**3 - 1.5 * u)  # Legendre's
        return np.concatenate([columns * t[:, None, None] for t in time], axis=2)

    def _best_step(
        self,
        pose: Float64[np.ndarray, "l q 6"],
        drift: _Gain,
        begin: Int64[np.ndarray, " l"],
        end: Int64[np.ndarray, " l"],
    ) -> Step | None:
        after = np.cumsum(pose[::-1], axis=0)[::-1]
        steps = drift.add(begin[1:], after[1:])
        if not steps:
            return None
        best = max(range(len(steps)), key=lambda k: steps[k].gain)
        later = np.concatenate([after[1:], np.zeros_like(after[:1])])
        for line in (best, best + 1):
            inside = np.arange(int(begin[line]), int(end[line]))
            sums = self._sum_within(inside) + later[line]
            steps += drift.add(inside[1:], sums)
        return max(steps, key=lambda step: step.gain)

    def _sum_within(
        self, inside: Int64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "s q 6"]:
        """Return the sums over a line for steps before its second cell and later.

        inside : its cells
        """
        design = self.about.build(self.seen.select(inside))
        whitener, p = design.whiten(self.about.noise), self.about.size
        rest = design.residual - design.columns @ self.theta
        S = self._drift_columns(design)
        all_ = np.concatenate([design.columns, rest[:, :, None], S], axis=2)
        P = all_[:, :, self.machine : p]
        # V⁻¹ is symmetric: weight what they are multiplied with, once for all steps.
        weighted = weigh(design, whitener, all_)
        each = np.swapaxes(weighted, 1, 2) @ P
        sums = np.cumsum(each[::-1], axis=0)[::-1][1:]
        sums[:, self.machine : p] = _square_tails(design, whitener, P)
        return sums


class _Gain:
    """The gain of a drift, and that of a step beside it."""

    def __init__(
        self, of: _Examination, sums: Float64[np.ndarray, "q s"], fixed: int
    ) -> None:
        self.of, self.fixed = of, fixed
        self.columns = sums[:fixed]
        F = sums[fixed + 1 :] - self.columns.T @ of.solve(self.columns)
        self.inverse = invert(F, np.diag(sums[fixed + 1 :]))
        self.pulled = sums[fixed]
        self.size = self.inverse @ self.pulled
        self.gain = float(self.pulled @ self.size)

    def add(
        self, cells: Int64[np.ndarray, " s"], sums: Float64[np.ndarray, "s q 6"]
    ) -> list[Step]:
        """Return steps before some cells, beside the drift."""
        p, count = self.fixed, len(cells)
        columns = np.moveaxis(sums[:, :p], 0, 1).reshape(p, 6 * count)
        solved = self.of.solve(columns).reshape(p, count, 6)
        return [
            Step(int(cell), *self._add(sums[k], solved[:, k]))
            for k, cell in enumerate(cells)
        ]

    def _add(
        self, sums: Float64[np.ndarray, "q 6"], solved: Float64[np.ndarray, "p 6"]
    ) -> tuple[float, float, float]:
        """Return the gain of a step beside the drift, and alone, and its size in mm."""
        of, p = self.of, self.fixed
        columns, pulled = sums[:p], sums[p]
        F = sums[of.machine : p] - columns.T @ solved
        cross = sums[p + 1 :] - self.columns.T @ solved
        raw = np.diag(sums[of.machine : p])
        step = invert(F, raw) @ pulled
        alone, moved_mm = float(pulled @ step), float(np.linalg.norm(step[:3]))
        beside = F - cross.T @ self.inverse @ cross
        pulled = pulled - cross.T @ self.size
        return float(pulled @ invert(beside, raw) @ pulled), alone, moved_mm


def _solve(
    fit: Fit, run: RunInformation, number: int
) -> tuple[ScaledCholesky, Float64[np.ndarray, " p"]]:
    """Return factor and solution of a Run, what else is known of the machine given."""
    size = fit.model.size
    others = [r for k, r in enumerate(fit.runs) if k != number]
    prior = Information.of_matrix(fit.prior.precision_matrix(size))
    known = add_information(
        [fit.known.add_to(prior, fit.model), *(r.own.eliminate() for r in others)]
    )
    matrix, vector = run.data.matrix.copy(), run.data.vector.copy()
    matrix[:size, :size] += known.matrix
    vector[:size] += known.vector
    factor = ScaledCholesky.of(matrix)
    return factor, factor.solve(vector)


def limit_noise(noise: NoiseModel) -> NoiseModel:
    """Return the noise, of which more than is usual is for a test to show."""
    beam, across = noise.ou
    return replace(
        noise,
        ou=(min(beam, _MOST_OU), min(across, _MOST_OU)),
        ou_time_s=min(noise.ou_time_s, _LONGEST_OU_S),
    )


def raise_noise(noise: NoiseModel) -> NoiseModel:
    """Return the noise as loud as is usual: few lines do not tell how loud it is."""
    return replace(noise, ou=(_MOST_OU, _MOST_OU), ou_time_s=_LONGEST_OU_S)


def _count_untimed(design: DesignMatrix, about: Linearisation) -> int:
    """Return of how many cells only what is across the travel counts."""
    seen = design.observations
    moves = seen.direction.any(axis=1)
    return int((moves & (seen.is_ramp | (not about.has_timing))).sum())


def weigh(
    design: DesignMatrix, whitener: Whitener, columns: Float64[np.ndarray, "n 3 p"]
) -> Float64[np.ndarray, "n 3 p"]:
    """Return V⁻¹ columns, the timing of the lines taken out."""
    timing, weighted = design.fit_timing(whitener, columns)
    return whitener.apply(columns) - weighted @ timing


def _square_tails(
    design: DesignMatrix, whitener: Whitener, P: Float64[np.ndarray, "n 3 6"]
) -> Float64[np.ndarray, "s 6 6"]:
    """Return PᵀV⁻¹P of the cells from the second on, from the third on, and so on."""
    number = np.arange(len(P))
    squares: list[Float64[np.ndarray, "c 6 6"]] = [np.zeros((0, 6, 6))]
    for first in range(1, len(P), _AT_ONCE):
        begin = number[first : first + _AT_ONCE]
        after = number[:, None] >= begin
        tails = np.where(after[:, None, :, None], P[:, :, None, :], 0.0)
        flat = tails.reshape(len(P), 3, -1)
        weighted = weigh(design, whitener, flat).reshape(tails.shape)
        squares.append(np.einsum("nick,nicl->ckl", tails, weighted))
    return np.concatenate(squares)


def explain_timing(
    design: DesignMatrix, whitener: Whitener, rest: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Return what the timing of the lines explains."""
    timing, _ = design.fit_timing(whitener, rest[:, :, None])
    return (design.timing @ timing)[:, :, 0]


def _cell_squares(
    design: DesignMatrix, rest: Float64[np.ndarray, "n 3"], noise: NoiseModel
) -> Float64[np.ndarray, " n"]:
    """Return the square of each cell by itself, in units of its noise."""
    precision = total_precision(design.observations, noise, design.travel)
    return np.einsum("ni,nij,nj->n", rest, precision, rest)


def invert(
    F: Float64[np.ndarray, "p p"], raw: Float64[np.ndarray, " p"]
) -> Float64[np.ndarray, "p p"]:
    """Return the inverse of what the fit leaves of information on columns.

    raw : that before; directions of which the fit explains all have none
    """
    scale = np.where(raw > 0.0, 1.0 / np.sqrt(np.maximum(raw, 1e-300)), 0.0)
    value, vector = np.linalg.eigh(F * scale[:, None] * scale)
    seen = value > _UNSEEN
    inverse = np.where(seen, 1.0 / np.where(seen, value, 1.0), 0.0)
    return (vector * inverse) @ vector.T * scale[:, None] * scale
