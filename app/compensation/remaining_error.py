"""What the files of a format leave of the error, as their controller reads them.

It is computed on a grid and between the rows of the tables. For an effect the files are
written and read back once more without it: the difference is its correction. That needs
no knowledge of what a format does with sag, with a screw's wave between its rows, or
with lost motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64
from scipy.stats import qmc

from truepath.app.compensation.error_map import ErrorMap, find_own_arm
from truepath.app.compensation.format import Correction
from truepath.app.compensation.tabulation import Tabulation
from truepath.app.compensation.unmeasured import MeasuredRange
from truepath.app.files.result_file import CalibrationResult
from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.conditions import make_standstill
from truepath.app.kinematics.model import CatalogueEffect
from truepath.app.kinematics.symbols import is_positioning
from truepath.app.numerics.rigid import cross_matrix
from truepath.app.results.lost_motion_across import draw_across_mm, remove_across
from truepath.app.results.volumetric_error import draw_parameters

GRID, EVEN = 5, 512  # positions an axis of the grid; those that fill the travel
_NOTHING_MM = 1e-9
_FEWEST = 12  # places that have a mean beside their rigid motion
# Of a standard deviation that a file does not say how well it knows: 50 values.
_UNSTATED_SCALE = 0.1
SIDES = (1.0, -1.0)  # + and − direction
COVERAGE = 2.0  # k of expanded uncertainties


def _sample_positions(
    errors: ErrorMap,
) -> tuple[Float64[np.ndarray, "n a"], Float64[np.ndarray, " n"]]:
    """Return positions over the travel and what each counts in a mean, 1 in all.

    Those that count fill the travel evenly, between the rows of the tables; a grid with
    the corners, where errors are largest, counts for the largest alone.
    """
    low = np.array([axis.low for axis in errors.axes])
    high = np.array([axis.high for axis in errors.axes])
    places = np.meshgrid(*[np.linspace(0.0, 1.0, GRID)] * len(low), indexing="ij")
    grid = np.stack(places, -1).reshape(-1, len(low))
    even = qmc.Sobol(len(low), rng=np.random.default_rng(0)).random(EVEN)
    unit = np.vstack([grid, even])
    position = np.tile(errors.middle_mm, (len(unit), 1))
    position[:, : len(low)] = low + unit * (high - low)
    return position, np.append(np.zeros(len(grid)), np.full(EVEN, 1.0 / EVEN))


def remove_rigid_motion(
    position_mm: Float64[np.ndarray, "n a"],
    error_mm: Float64[np.ndarray, "n 3 ..."],
    weight: Float64[np.ndarray, " n"] | None = None,
) -> Float64[np.ndarray, "n 3 ..."]:
    """Remove the best-fit rigid motion, which is not an error of the machine.

    error_mm : of one map, or of many beside one another
    """
    root = np.sqrt(np.ones(len(position_mm)) if weight is None else weight)
    point = position_mm[:, :3] - position_mm[:, :3].mean(axis=0)
    shifts = np.broadcast_to(np.eye(3), (len(point), 3, 3))
    columns = np.concatenate([shifts, cross_matrix(point)], axis=2).reshape(-1, 6)
    rows, root = error_mm.reshape(len(columns), -1), np.repeat(root, 3)[:, None]
    fit, *_ = np.linalg.lstsq(root * columns, root * rows, rcond=None)
    return error_mm - (columns @ fit).reshape(error_mm.shape)


@dataclass(frozen=True, slots=True)
class RemainingError:
    """What the errors leave at positions over the travel, both directions, in mm.

    position_mm : (n, 3 or more), of the straight axes or the tool, others after these
    left_mm : (s, n, 3) of the map with the correction, without rigid motion
    drawn_mm : (s, n, 3, d) what the map may be wrong by, drawn from its covariance
    is_measured : (n,) where every axis was measured
    weight : (n,) what each position counts in a mean
    scale : how well the size of what was drawn is known itself, k = 1, of 1
    """

    position_mm: Float64[np.ndarray, "n a"]
    left_mm: Float64[np.ndarray, "s n 3"]
    drawn_mm: Float64[np.ndarray, "s n 3 d"]
    is_measured: Bool[np.ndarray, " n"]
    weight: Float64[np.ndarray, " n"]
    scale: float

    def state_map(self, *, measured: bool = False) -> dict[str, float]:
        """Return mean and largest length of the map itself, µm.

        measured : at the places alone where every axis was measured, if there are
            enough; what is left has no rigid motion of these
        """
        if measured and (part := self._keep_measured()) is not None:
            return part.state_map()
        every = UM_PER_MM * np.linalg.norm(self.left_mm, axis=2)
        mean = np.average(every.mean(axis=0), weights=self.weight)
        return {"mean": float(mean), "largest": float(every.max())}

    def state(self, *, measured: bool = False) -> dict[str, float] | None:
        """Return mean length, largest and standard uncertainty of the mean, µm.

        As `state_map`, of errors that the measurement allows; None without such places.
        """
        if measured:
            part = self._keep_measured()
            return None if part is None else part.state()
        total = self.left_mm[..., None] + self.drawn_mm
        lengths = UM_PER_MM * np.linalg.norm(total, axis=2)
        mean = np.average(lengths.mean(axis=0), axis=0, weights=self.weight)
        largest = lengths.max(axis=(0, 1))
        of_map = self.state_map()["mean"]
        expected, sigma = expect_length(mean, of_map, self.scale)
        return {
            "mean": expected,
            "largest": float(largest.mean()),
            "mean_uncertainty": sigma,
        }

    def find_map_uncertainty_um(self) -> float:
        """Return the standard uncertainty of the mean length of the map, µm.

        What the measurement does not know makes the map longer than the error is: not
        taken off, it counts as an uncertainty.
        """
        total = self.left_mm[..., None] + self.drawn_mm
        lengths = UM_PER_MM * np.linalg.norm(total, axis=2)
        mean = np.average(lengths.mean(axis=0), axis=0, weights=self.weight)
        return float(np.hypot(mean.std(), mean.mean() - self.state_map()["mean"]))

    def find_difference_um(self, other: RemainingError) -> float:
        """Return the root mean square length of what two corrections differ by."""
        return self._average_um((self.left_mm - other.left_mm) ** 2)

    @property
    def rms_um(self) -> float:
        """Root mean square of the length that the map leaves."""
        return self._average_um(self.left_mm**2)

    @property
    def unknown_um(self) -> float:
        """Root mean square of the length that the measurement does not know."""
        return self._average_um(np.mean(self.drawn_mm**2, axis=3))

    def _keep_measured(self) -> RemainingError | None:
        """Return what is left where every axis was measured; None at too few places.

        The rigid motion of errors that nobody measured is no part of it.
        """
        kept = self.is_measured
        weight = self.weight[kept]
        if np.count_nonzero(weight) < _FEWEST:
            return None
        position = self.position_mm[kept]
        left, drawn = (
            remove_from_both(position, list(errors[:, kept]), weight)
            for errors in (self.left_mm, self.drawn_mm)
        )
        return replace(
            self,
            position_mm=position,
            left_mm=left,
            drawn_mm=drawn,
            is_measured=kept[kept],
            weight=weight / weight.sum(),
        )

    def _average_um(self, squares_mm2: Float64[np.ndarray, "k n 3"]) -> float:
        """Return the root mean square length of squares over k sets of positions."""
        each = squares_mm2.sum(axis=2).mean(axis=0)
        return UM_PER_MM * float(np.sqrt(self.weight @ each))


def expect_length(
    drawn: Float64[np.ndarray, " d"], of_map: float, scale: float
) -> tuple[float, float]:
    """Return the expected length that is left, and its standard uncertainty.

    drawn : lengths of errors that the measurement allows; of_map : that of the map
    scale : how well the size of what was drawn is known itself, k = 1, of 1

    The uncertainty is the spread over what was drawn, and how well its size is known.
    """
    mean = float(drawn.mean())
    return mean, float(np.hypot(drawn.std(), scale * (mean - of_map)))


def find_remaining(
    errors: ErrorMap,
    measured: Mapping[str, MeasuredRange],
    correction: Correction | None = None,
) -> RemainingError:
    """Return what is left of the errors with a correction, or without any."""
    position, weight = _sample_positions(errors)
    left: list[Float64[np.ndarray, "n 3"]] = []
    for side in SIDES:
        error = errors.error_mm(position, side)
        if correction is not None:
            error = error + correction(position, side)
        left.append(error)
    # One rigid motion of both directions: what lost motion is between them stays.
    both = remove_from_both(position, left, weight)
    inside = [
        (position[:, column] >= one.low) & (position[:, column] <= one.high)
        for column, one in enumerate(measured[axis.name] for axis in errors.axes)
    ]
    return RemainingError(
        position,
        both,
        draw_errors_mm(errors, position),
        np.all(inside, axis=0),
        weight,
        find_scale(errors.result),
    )


def find_scale(result: CalibrationResult) -> float:
    """Return the relative uncertainty of a standard deviation of ν values, 1/√(2ν).

    ν are the independent values that the measurement has of its slow noise, which
    decides how well errors are known (JCGM 100, E.4.3).
    """
    if result.noise_freedom is None:
        return _UNSTATED_SCALE
    return float(1.0 / np.sqrt(2.0 * result.noise_freedom))


def draw_errors_mm(
    errors: ErrorMap, position: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "s n 3 d"]:
    """Return what the map may be wrong by in both directions, lost motion with it."""
    at = make_standstill(errors.machine, position)
    J = errors.volumetric_map.jacobian(at).reshape(3 * len(position), -1)
    drawn = (J @ draw_parameters(errors.result.covariance)).reshape(
        len(position), 3, -1
    )
    both = np.stack([drawn] * len(SIDES))
    rng = np.random.default_rng(1)
    both += draw_across_mm(errors.result, at, drawn.shape[2])
    for column, axis in enumerate(errors.axes):
        sigma = errors.half_difference_sigma_mm(axis.name, position[:, column])
        half = np.outer(sigma, rng.standard_normal(drawn.shape[2]))
        moved = find_own_arm(axis, at)[:, :, None] * half[:, None]
        for number, side in enumerate(SIDES):
            both[number] += side * moved
    return both


def evaluate_effects(
    errors: ErrorMap, made: Tabulation, correction: Correction
) -> Iterator[dict[str, Any]]:
    """Yield what remains of each effect of the model, as the account states it.

    made : the tables that the format writes; correction : of its files

    The root mean square is that over both directions without rigid motion; it is 0
    where the effect depends on speed, temperature or the distance since a reversal.
    """
    position, weight = _sample_positions(errors)
    for effect in errors.result.model.catalogue_effects:
        other = _remove_effect(errors, effect)
        reread = made.read_back(other)
        own = [
            errors.error_mm(position, s) - other.error_mm(position, s) for s in SIDES
        ]
        done = [correction(position, s) - reread(position, s) for s in SIDES]
        remains = [error + added for error, added in zip(own, done, strict=True)]
        before = _compute_rms(position, own, weight)
        after = _compute_rms(position, remains, weight)
        beyond = before < _NOTHING_MM
        if beyond:
            before = after = 0.0
        yield {
            "name": effect.family,
            **dict(effect.keys),
            "rms_um": {"before": UM_PER_MM * before, "after": UM_PER_MM * after},
            "note": _explain_nothing(effect) if beyond else "",
        }


def _explain_nothing(effect: CatalogueEffect) -> str:
    """Return why an effect is not in the numbers."""
    if effect.half_difference:
        return "lost motion of a rotary axis: in the account of that axis"
    return "depends on more than place and direction: no table has it"


def _compute_rms(
    position: Float64[np.ndarray, "n a"],
    error_mm: Sequence[Float64[np.ndarray, "n 3"]],
    weight: Float64[np.ndarray, " n"],
) -> float:
    """Return the root mean square over both directions, without rigid motion."""
    every = remove_from_both(position, error_mm, weight)
    return float(np.sqrt(weight @ (every**2).sum(axis=2).mean(axis=0)))


def remove_from_both(
    position: Float64[np.ndarray, "n a"],
    error_mm: Sequence[Float64[np.ndarray, "n 3 ..."]],
    weight: Float64[np.ndarray, " n"],
) -> Float64[np.ndarray, "s n 3 ..."]:
    """Return errors of each direction without their common rigid motion."""
    every = remove_rigid_motion(
        np.concatenate([position] * len(error_mm)),
        np.concatenate(error_mm),
        np.concatenate([weight] * len(error_mm)),
    )
    return every.reshape(len(error_mm), *error_mm[0].shape)


def _remove_effect(errors: ErrorMap, effect: CatalogueEffect) -> ErrorMap:
    """Return the error map of the model without the effect."""
    theta = errors.result.theta.copy()
    theta[errors.result.model.slices[effect.name]] = 0.0
    half_um = dict(errors.result.half_difference_um)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half_um.pop(lost.axis.name, None)
    result = replace(errors.result, theta=theta, half_difference_um=half_um)
    if lost:
        result = remove_across(result, lost.symbol)
    return replace(errors, result=result)
