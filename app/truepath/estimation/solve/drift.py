"""Error parameters over time, from the information of each of several Runs.

Each Run was estimated alone, with separate knots, direction of approach and noise, so
that a machine which has changed between them affects none. Here all refer to one model,
which has each effect as fine as any Run has it. The tracker's position and the seats of
targets belong to one Run and are integrated out: a rigid motion of the whole volume
between two Runs is not determined.

The parameters at Run k are θ + B dₖ: θ is constant, B are the shapes of change, and the
course of each shape is an independent Gaussian process. All information is on (θ, d₁ …
d_K) and adds as that of cells does; θ is integrated out once, so that other sizes of
the process are cheap to try. This is the smoother of Rauch, Tung and Striebel over the
states of the process, in information form and for all Runs at once.

The process is a sum of states that start at the first Run: two that settle, each with a
time constant, a random walk, the daily cycle of the hall, and a part linear in
temperatures:

    d(t) = a exp(−t/τ₁) + b exp(−t/τ₂) + w(t) + h(t) − h(0) + Σ c_s T_s(t) / √n.

a, b and c are random constants, w is a Wiener process, h one of Matérn's of order 3/2
(Särkkä & Solin 2019, section 12.3). Runs of a few hours do not show the day that
follows, and its effect on all shapes has one cause: it is set to a typical share of the
settling parts.

Sizes and time constants are unknown too. Some shapes change much and others not at all,
so each has a separate size, which the data determine about a common centre, as they
determine the precisions of the prior of an estimate (`prior`). Sizes of the states are
sampled in proportion to their prior and to the likelihood of all Runs, by population
Monte Carlo (Cappé et al. 2004), and all results are the mixture over the samples. Few
Runs leave them wide.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from truepath.errors import BadInput
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import Information, OwnParameters
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior import pool_precision
from truepath.estimation.solve.batch import Estimate
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.error_motion import ErrorMotion, get_typical_size
from truepath.kinematics.machine.symbols import is_straightness
from truepath.kinematics.model import MachineModel
from truepath.numerics.scaled_cholesky import ScaledCholesky


@dataclass(frozen=True, slots=True)
class CommonBasis:
    """Information of Runs of one machine on the parameters of one model.

    precision : of the prior of the constant part, as the Runs have found it
    told : by each Run, its pose and seats integrated out
    """

    model: MachineModel
    precision: Float64[np.ndarray, "p p"]
    told: tuple[Information, ...]


def compute_common_basis(estimates: Sequence[Estimate]) -> CommonBasis:
    """Information of single-Run estimates in a common basis.

    estimates : of one machine, each with its fit
    Raises BadInput if the Runs do not measure the same targets.
    """
    fits = [one.stored_fit for one in estimates]
    effects = _select_finest([fit.model for fit in fits])
    names = {effect.name for effect in effects}
    if any(m.confounded != fits[0].model.confounded for m in (f.model for f in fits)):
        raise BadInput("the Runs do not measure the same targets: follow those apart")
    own = [effect for effect in effects if effect.role is Role.NUISANCE]
    machine = [effect for effect in effects if effect.role is not Role.NUISANCE]
    whole = MachineModel(
        fits[0].model.machine,
        (*machine, *own),
        fits[0].model.confounded & names,
    )
    model = replace(whole, effects=tuple(machine))
    precision = _combine_precisions(whole, fits)
    told = tuple(_collect_runs(fit, whole, model.size, precision) for fit in fits)
    return CommonBasis(model, precision[: model.size, : model.size], told)


def _select_finest(models: Sequence[MachineModel]) -> list[Effect]:
    """Each effect of any model once, with the most parameters that it has.

    Without confounded turns that others make up for: the model fits as well.
    """
    found: dict[str, Effect] = {}
    for model in models:
        for effect in model.effects:
            known = found.get(effect.name)
            finer = known is None or len(effect.parameters) > len(known.parameters)
            if finer and effect.name not in model.compensated_turns:
                found[effect.name] = effect
    return list(found.values())


def _combine_precisions(
    model: MachineModel, fits: Sequence[Fit]
) -> Float64[np.ndarray, "p p"]:
    total = np.zeros((model.size, model.size))
    for effect in model.effects:
        name, part = effect.name, model.slices[effect.name]
        having = [fit.prior for fit in fits if name in fit.prior.penalties]
        same = [p for p in having if len(p.penalties[name].form) == len(total[part])]
        if same:
            logs = [np.log(prior.precision[name]) for prior in having]
            total[part, part] = np.exp(np.mean(logs)) * same[0].penalties[name].form
    return total


def _collect_runs(
    fit: Fit,
    whole: MachineModel,
    kept: int,
    precision: Float64[np.ndarray, "p p"],
) -> Information:
    parts = [
        RunInput(run.observations, run.linearisation.pose, run.noise)
        for run in fit.runs
    ]
    told = combine_runs(collect_information(parts, whole))
    matrix = told.matrix.copy()
    matrix[kept:, kept:] += precision[kept:, kept:]
    return OwnParameters.of(replace(told, matrix=matrix), kept).eliminate()


# Logarithms: median and standard deviation of plausible sizes. A size of 1 is
# 10 µm or 20 µrad over the travel.
_USUAL = (
    (1.0, 1.2),  # size of the quick part
    (0.5, 1.2),  # of the slow part
    (0.5, 1.0),  # quick time constant, h
    (3.0, 0.7),  # how many times slower the slow one is, beyond 1.5
    (0.03, 1.2),  # walk in one hour
    (0.5, 0.3),  # daily cycle of the hall, of the settling parts
    (0.2, 1.0),  # for one K
)
SIZES = len(_USUAL)
_HOUR_S = 3600.0
_DAY_S = 6.0 * _HOUR_S  # in which air and foundations of a hall change


@dataclass(frozen=True, slots=True)
class Course:
    """Times in s since the first Run, with the temperatures then, (n, sensors)."""

    time_s: Float64[np.ndarray, " n"]
    celsius: Float64[np.ndarray, "n s"]


@dataclass(frozen=True, slots=True)
class DriftSizes:
    """Sizes of the states, relative to typical ones, and their time constants.

    walk : in one hour; per_kelvin : of all sensors together
    """

    quick: float
    slow: float
    quick_s: float
    slow_s: float
    walk: float
    day: float
    per_kelvin: float

    def compute_covariance(
        self, one: Course, other: Course
    ) -> Float64[np.ndarray, "n m"]:
        t, u = one.time_s[:, None], other.time_s[None, :]
        quick = self.quick**2 * np.exp(-(t + u) / self.quick_s)
        slow = self.slow**2 * np.exp(-(t + u) / self.slow_s)
        walk = self.walk**2 * np.minimum(t, u) / _HOUR_S
        day = self.day**2 * (
            _smooth(t - u) - _smooth(t) - _smooth(u) + _smooth(np.zeros((1, 1)))
        )
        sensors = max(one.celsius.shape[1], 1)
        warm = self.per_kelvin**2 * (one.celsius @ other.celsius.T) / sensors
        return quick + slow + walk + day + warm


def make_sizes(unit: Float64[np.ndarray, " s"]) -> DriftSizes:
    """From standard normal numbers to log-normal sizes."""
    quick, slow, hours, ratio, walk, day, warm = (
        median * float(np.exp(spread * z))
        for z, (median, spread) in zip(unit, _USUAL, strict=True)
    )
    quick_s = _HOUR_S * hours
    settles = float(np.hypot(quick, slow))
    slow_s = (1.5 + ratio) * quick_s
    return DriftSizes(quick, slow, quick_s, slow_s, walk, day * settles, warm)


def compute_prior_log(unit: Float64[np.ndarray, "n s"]) -> Float64[np.ndarray, " n"]:
    """Log density of the standard normal numbers, one for each row."""
    return -0.5 * (unit**2 + np.log(2.0 * np.pi)).sum(axis=1)


def _smooth(apart_s: Float64[np.ndarray, "n m"]) -> Float64[np.ndarray, "n m"]:
    share = np.sqrt(3.0) * np.abs(apart_s) / _DAY_S
    return (1.0 + share) * np.exp(-share)


# Straight shapes have no prior: so wide that none is needed.
_WIDE = {"mm": 1.0, "rad": 2e-3}
_FIRST_ROUNDS, _ROUNDS, _POPULATION = 5, 3, 7  # 2^7 draws a round
_WIDER = 1.3  # than the last population, so that tails are sampled
_RESIZINGS = 6
_SCATTER = 2.5  # of the log of the precisions of shapes
_DRAWS = 64  # in the mixture
_ROUNDING = 1e-9  # of the variance of a course


@dataclass(frozen=True)
class DriftData:
    """Runs of one machine at their times, θ integrated out.

    shapes : B; static : posterior precision of θ at given d; mean : (p,) of θ where d
        is 0; follow : (p, K m), θ decreases by it times d
    matrix, vector : information on d, Run by Run
    """

    basis: CommonBasis
    at: Course
    shapes: Float64[np.ndarray, "p m"]
    static: ScaledCholesky
    mean: Float64[np.ndarray, " p"]
    follow: Float64[np.ndarray, "p q"]
    matrix: Float64[np.ndarray, "q q"]
    vector: Float64[np.ndarray, " q"]

    @staticmethod
    def of(
        basis: CommonBasis, at: Course, shapes: Float64[np.ndarray, "p m"]
    ) -> DriftData:
        B, told = shapes, basis.told
        wide = np.array([_WIDE.get(p.unit, 1.0) for p in basis.model.parameters])
        precision = basis.precision + np.diag(wide**-2.0)
        static = ScaledCholesky.of(precision + sum(one.matrix for one in told))
        total = np.sum([one.vector for one in told], axis=0)
        coupling = np.hstack([one.matrix @ B for one in told])
        half, right = static.solve_half(coupling), static.solve_half(total)
        matrix = -half.T @ half
        size = B.shape[1]
        for k, one in enumerate(told):
            part = np.s_[k * size : (k + 1) * size]
            matrix[part, part] += B.T @ one.matrix @ B
        vector = np.concatenate([B.T @ one.vector for one in told]) - half.T @ right
        follow, mean = static.solve(coupling), static.solve(total)
        return DriftData(basis, at, B, static, mean, follow, matrix, vector)

    @cached_property
    def static_root(self) -> Float64[np.ndarray, "p p"]:
        """R with R Rᵀ the covariance of θ at given d."""
        return np.linalg.cholesky(self.static.invert())


@dataclass(frozen=True, slots=True, eq=False)
class DriftPosterior:
    """d of all Runs for given sizes of the process.

    d = (L ⊗ 1) z; z has `mean` and precision M = U Uᵀ, `factor` being U
    log_likelihood : of all Runs, up to a constant
    """

    data: DriftData
    sizes: DriftSizes
    root: Float64[np.ndarray, "k k"]
    mean: Float64[np.ndarray, " q"]
    factor: Float64[np.ndarray, "q q"]
    log_likelihood: float

    @staticmethod
    def of(data: DriftData, sizes: DriftSizes) -> DriftPosterior:
        L = _compute_root(sizes.compute_covariance(data.at, data.at))
        runs, size = len(L), data.shapes.shape[1]
        A = data.matrix.reshape(runs, size, runs, size)
        turned = np.tensordot(np.tensordot(L, A, (0, 0)), L, (2, 0))
        told = turned.transpose(0, 1, 3, 2).reshape(runs * size, -1)
        v = (L.T @ data.vector.reshape(runs, size)).ravel()
        U = np.linalg.cholesky(told + np.eye(runs * size))
        half = solve_triangular(U, v, lower=True, check_finite=False)
        mean = solve_triangular(U, half, lower=True, trans=1, check_finite=False)
        log = 0.5 * float(half @ half) - float(np.log(np.diag(U)).sum())
        return DriftPosterior(data, sizes, L, mean, U, log)

    def draw(
        self,
        at: Course,
        columns: Float64[np.ndarray, "p r"],
        count: int,
        rng: np.random.Generator,
    ) -> Float64[np.ndarray, "c t r"]:
        """Random courses of the parameters times `columns`: (count, times, columns)."""
        data, size = self.data, self.data.shapes.shape[1]
        z = rng.standard_normal((len(self.mean), count))
        z = self.mean[:, None] + solve_triangular(self.factor, z, lower=True, trans=1)
        z = z.reshape(len(self.root), size * count)
        d = (self.root @ z).reshape(-1, count)
        static = data.static_root @ rng.standard_normal((len(data.mean), count))
        theta = data.mean[:, None] - data.follow @ d + static
        weights, spread = self._continue(at)
        later = weights @ z + spread @ rng.standard_normal((len(spread), z.shape[1]))
        change = later.reshape(-1, size, count).transpose(2, 0, 1)
        return (theta.T @ columns)[:, None] + change @ (data.shapes.T @ columns)

    def _continue(
        self, at: Course
    ) -> tuple[Float64[np.ndarray, "t k"], Float64[np.ndarray, "t t"]]:
        """Weights of z in the process at these times, and a root of the rest."""
        across = self.sizes.compute_covariance(self.data.at, at)
        half = solve_triangular(self.root, across, lower=True, check_finite=False)
        own = self.sizes.compute_covariance(at, at)
        return half.T, _compute_root(own - half.T @ half, own)

    def predict(
        self, at: Course
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "p p"]]:
        data, size = self.data, self.data.shapes.shape[1]
        weights, spread = self._continue(at)
        static = -data.follow.reshape(-1, len(self.root), size)
        turned = np.tensordot(self.root, static, (0, 1)).transpose(1, 0, 2)
        moved = weights[0][:, None] * data.shapes[:, None]
        G: Float64[np.ndarray, "p q"] = (turned + moved).reshape(len(moved), -1)
        half = solve_triangular(self.factor, G.T, lower=True, check_finite=False)
        rest, root = spread[0, 0] * data.shapes, data.static_root
        covariance = half.T @ half + root @ root.T + rest @ rest.T
        return data.mean + G @ self.mean, covariance


@dataclass(frozen=True, slots=True)
class Drift:
    """Error parameters over time, as a mixture with equal weights."""

    data: DriftData
    shares: tuple[DriftPosterior, ...]

    def predict(
        self, at: Course
    ) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "p p"]]:
        """Mean and covariance of the parameters at one time, from all Runs."""
        means: list[Float64[np.ndarray, " p"]] = []
        within = np.zeros(2 * (len(self.data.mean),))
        for share, count in Counter(self.shares).items():
            mean, covariance = share.predict(at)
            means += [mean] * count
            within += count / len(self.shares) * covariance
        return np.mean(means, axis=0), within + np.cov(np.array(means).T, bias=True)

    def draw(
        self, at: Course, columns: Float64[np.ndarray, "p r"], count: int
    ) -> Float64[np.ndarray, "c t r"]:
        """Random courses of the parameters times `columns`, `count` a component."""
        rng = np.random.default_rng(1)
        return np.concatenate(
            [share.draw(at, columns, count, rng) for share in self.shares]
        )

    def list_sizes(self) -> list[DriftSizes]:
        """One for each component of the mixture, with repetitions."""
        return [share.sizes for share in self.shares]


def estimate_drift(basis: CommonBasis, at: Course) -> Drift:
    """Mixture over 64 samples of the sizes; at : the Runs, the first at time 0."""
    shapes = build_drift_shapes(basis.model)
    data = DriftData.of(basis, at, shapes)
    sizes, _ = _sample_populations(data, _Normal.usual(), _FIRST_ROUNDS)
    for _ in range(_RESIZINGS):
        found = DriftPosterior.of(data, make_sizes(sizes.centre))
        data = DriftData.of(basis, at, shapes * _size_shapes(found, shapes))
    sizes, unit = _sample_populations(data, sizes, _ROUNDS)
    weight = sizes.weight
    # Systematic resampling: each sample in proportion to its weight.
    places = (np.arange(_DRAWS) + 0.5) / _DRAWS
    chosen = np.searchsorted(np.cumsum(weight), places).clip(max=len(unit) - 1)
    known = {k: DriftPosterior.of(data, make_sizes(unit[k])) for k in set(chosen)}
    return Drift(data, tuple(known[k] for k in chosen))


def _size_shapes(
    found: DriftPosterior, shapes: Float64[np.ndarray, "p m"]
) -> Float64[np.ndarray, " m"]:
    """Size of each shape relative to the typical one. shapes : of typical size"""
    runs, count = len(found.root), shapes.shape[1]
    inverse = solve_triangular(found.factor, np.eye(len(found.mean)), lower=True)
    variance = np.sum(inverse**2, axis=0).reshape(runs, count)
    told = np.sum(1.0 - variance, axis=0)
    now = np.linalg.norm(found.data.shapes, axis=0) / np.linalg.norm(shapes, axis=0)
    energy = now**2 * np.sum(found.mean.reshape(runs, count) ** 2, axis=0)
    pairs = zip(told.tolist(), energy.tolist(), strict=True)
    precision = [pool_precision(max(g, 0.0), e, 1.0, _SCATTER) for g, e in pairs]
    return np.array(precision) ** -0.5


@dataclass(frozen=True, slots=True)
class _Normal:
    """Proposal for the logarithms of the sizes, with the weights of its samples."""

    centre: Float64[np.ndarray, " s"]
    root: Float64[np.ndarray, "s s"]
    weight: Float64[np.ndarray, " n"]

    @staticmethod
    def usual() -> _Normal:
        return _Normal(np.zeros(SIZES), np.eye(SIZES), np.zeros(0))

    @staticmethod
    def of(unit: Float64[np.ndarray, "n s"], log: Float64[np.ndarray, " n"]) -> _Normal:
        weight = np.exp(log - log.max())
        weight /= weight.sum()
        centre = weight @ unit
        off = unit - centre
        spread: Float64[np.ndarray, "s s"] = (off.T * weight) @ off
        root = np.linalg.cholesky(spread + 0.02 * np.eye(SIZES))
        return _Normal(centre, root, weight)


def _sample_populations(
    data: DriftData, known: _Normal, rounds: int
) -> tuple[_Normal, Float64[np.ndarray, "n s"]]:
    # Imported where it is used: the library takes a third of a second to come up.
    from scipy.stats import qmc

    unit: Float64[np.ndarray, "n s"] = np.zeros((0, SIZES))
    for number in range(rounds):
        z = ndtri(qmc.Sobol(SIZES, seed=number).random_base2(_POPULATION))
        unit = known.centre + _WIDER * z @ known.root.T
        sizes = [make_sizes(one) for one in unit]
        found = [DriftPosterior.of(data, one).log_likelihood for one in sizes]
        log = np.array(found) + compute_prior_log(unit)
        log -= compute_prior_log(z)  # of the draws, up to a constant
        # The first rounds are tempered, so that they keep more than their best draw.
        known = _Normal.of(unit, log * min(1.0, (number + 1.0) / (rounds - 1.0)))
    return known, unit


def _compute_root(
    covariance: Float64[np.ndarray, "n n"],
    scale: Float64[np.ndarray, "n n"] | None = None,
) -> Float64[np.ndarray, "n n"]:
    """The covariance may be singular to rounding."""
    scale = covariance if scale is None else scale
    floor = _ROUNDING * (np.diag(scale) + float(np.diag(scale).max()))
    return np.linalg.cholesky(covariance + np.diag(floor))


# A scale that grows makes a straight line of a positioning error, a column that is warm
# on one side a curve of an angle. Of each error motion the smoothest shapes may change,
# the straight one by a usual size, bends by less. Squarenesses and locations change as
# numbers. What depends on the direction of approach is taken to stay.
_SIZES = 1.0, 0.5, 0.2  # of the straight shape, one bend, two bends
_USUAL_NUMBER = {"mm": 0.01, "rad": 2e-5}
_PLACES = 33


def build_drift_shapes(model: MachineModel) -> Float64[np.ndarray, "p m"]:
    """Shapes in which the parameters of a model change, one a column.

    Each changes its error motion by at most 10 µm or 20 µrad over the travel, times the
    typical share of its form.
    """
    columns: list[Float64[np.ndarray, " p"]] = []
    for effect in model.effects:
        part = model.slices[effect.name]
        for shape in _yield_shapes(effect):
            column = np.zeros(model.size)
            column[part] = shape
            columns.append(column)
    return np.stack(columns, axis=1)


def _yield_shapes(effect: Effect) -> Iterator[Float64[np.ndarray, " k"]]:
    size = len(effect.parameters)
    if isinstance(effect, ErrorMotion):
        axis = effect.axis
        rows = effect.rows(np.linspace(axis.low, axis.high, _PLACES))
        # The shapes of an error motion are sorted: straight ones first.
        sizes = _SIZES[1:] if is_straightness(effect.symbol) else _SIZES
        for shape, share in zip(np.eye(size), sizes, strict=False):
            usual = share * get_typical_size(effect.symbol)
            yield usual * shape / float(np.abs(rows @ shape).max())
    elif effect.iso_symbol:
        yield np.array([_USUAL_NUMBER[p.unit] for p in effect.parameters])
