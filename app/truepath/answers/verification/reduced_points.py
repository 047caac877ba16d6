"""A measurement reduced to points: standstills, and segments of lines.

A point is the mean of a standstill in three components, or of about a second of a line
in the two across it: along it the tracker's clock says only when the machine was where.
The noise of all points together is that of the cells: white, and correlated in time.

Everything here is linear in the pose of the tracker, which is unknown like the seats of
further targets: remove both before stating a deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import block_diag

from truepath.alignment.observations.observations import CellMeans, Observations
from truepath.estimation.problem.noise import NoiseModel, split_sigma_mm
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.pose_timing_seats import TrackerPose, list_target_seats
from truepath.numerics.rigid import RigidTransform

_SEGMENT_S = 1.0  # of a line: longer than most correlation times, shorter than a shape
_MOST_POINTS = 500
_SEEN = 0.5
_RESTS = 0.02  # of its travel: an axis at rest


@dataclass(frozen=True)
class ReducedPoints:
    """n points, with m measured components, in mm.

    at, row : (n,) conditions, and rows of the path or points
    run : (n,) which of several Runs measured each, from 0
    cells, means : what the points are means of
    component : (m, 3) unit directions in the frame that the tracker is mounted on
    owner : (m,) the point of each
    residual_mm : (m,) measured less nominal
    nuisance : (m, k) columns of pose and seats
    noise_mm2 : (m, m) covariance
    """

    at: Conditions
    row: Int64[np.ndarray, " n"]
    run: Int64[np.ndarray, " n"]
    cells: Conditions
    means: CellMeans
    component: Float64[np.ndarray, "m 3"]
    owner: Int64[np.ndarray, " m"]
    residual_mm: Float64[np.ndarray, " m"]
    nuisance: Float64[np.ndarray, "m k"]
    noise_mm2: Float64[np.ndarray, "m m"]

    def __len__(self) -> int:
        return len(self.row)

    def project(
        self, vectors: Float64[np.ndarray, "c 3 ..."]
    ) -> Float64[np.ndarray, "m ..."]:
        """Measured components of the mean vector of each point.

        vectors : at the cells; errors bend within the segment of a line
        """
        mean = self.means.of(vectors)[self.owner]
        return np.einsum("mi,mi...->m...", self.component, mean)

    def collect(
        self, values: Float64[np.ndarray, "m ..."]
    ) -> Float64[np.ndarray, "n 3 ..."]:
        """Vector of each point, 0 in a direction that was not measured."""
        vectors = np.zeros((len(self), 3, *values.shape[1:]))
        trailing = (1,) * (values.ndim - 1)
        np.add.at(
            vectors,
            self.owner,
            self.component.reshape(-1, 3, *trailing) * values[:, None],
        )
        return vectors

    def collect_covariance(
        self, covariance: Float64[np.ndarray, "m m"]
    ) -> Float64[np.ndarray, "n 3 3"]:
        """Covariance of the vector of each point."""
        found = np.zeros((len(self), 3, 3))
        for place in range(len(self)):
            own = np.flatnonzero(self.owner == place)
            part = self.component[own]
            found[place] = part.T @ covariance[np.ix_(own, own)] @ part
        return found

    @property
    def is_complete(self) -> bool:
        """Whether all three components were measured at every point."""
        return len(self.owner) == 3 * len(self)

    @property
    def unseen_directions(self) -> tuple[str, ...]:
        """Directions without data: across no line and at no standstill.

        A component counts as along one that is less than 60° from it.
        """
        share = np.abs(self.component).max(axis=0, initial=0.0)
        return tuple(n for n, one in zip("XYZ", share, strict=True) if one < _SEEN)

    @property
    def resting_axes(self) -> tuple[str, ...]:
        """Axes that moved by less than 2 % of their travel."""
        machine = self.at.machine
        moved = np.ptp(self.at.position_mm, axis=0)
        return tuple(
            axis.name
            for axis, one in zip(machine.axes, moved, strict=True)
            if one < _RESTS * (axis.high - axis.low)
        )

    @property
    def sees_all(self) -> bool:
        """Whether every direction was measured, and every linear axis moved.

        Rotary axes rest in all tests of linear ones, which say nothing of them.
        """
        linear = {axis.name for axis in self.at.machine.linear_axes}
        return not self.unseen_directions and not linear & {*self.resting_axes}


def reduce_to_points(
    observations: Observations, pose: RigidTransform, noise: NoiseModel
) -> ReducedPoints:
    """Points of a Run. pose : workpiece to tracker, near the true one"""
    cells = observations.exclude_ramps()
    starts = _compute_starts(cells)
    reduced, means = cells.join(starts), CellMeans(cells.count, starts)
    component, owner = _list_components(reduced)
    frame = np.matmul(reduced.beam_frame, pose.rotation)
    local = np.einsum("mi,mji->mj", component, frame[owner])  # in each beam frame
    nuisance = _build_nuisance(reduced)
    points = ReducedPoints(
        reduced.at,
        reduced.row,
        np.zeros(len(reduced.row), np.int64),
        cells.at,
        means,
        component,
        owner,
        np.zeros(len(owner)),
        np.einsum("mi,mik->mk", component, nuisance[owner]),
        _build_noise(reduced, noise, local, owner),
    )
    residual = pose.invert().apply(cells.tracker_mm) - cells.at.point_mm
    return replace(points, residual_mm=points.project(residual))


def merge_points(parts: Sequence[ReducedPoints]) -> ReducedPoints:
    """Points of several Runs, one after another, each with its own pose."""
    if len(parts) == 1:
        return parts[0]
    points = np.cumsum([0, *(len(part) for part in parts[:-1])])
    cells = np.cumsum([0, *(len(part.means.weight) for part in parts[:-1])])
    weight = np.concatenate([part.means.weight for part in parts])
    starts = [part.means.starts + k for part, k in zip(parts, cells, strict=True)]
    owner = [part.owner + k for part, k in zip(parts, points, strict=True)]
    return ReducedPoints(
        _merge_conditions([part.at for part in parts]),
        np.concatenate([part.row for part in parts]),
        np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        _merge_conditions([part.cells for part in parts]),
        CellMeans(weight, np.concatenate(starts)),
        np.concatenate([part.component for part in parts]),
        np.concatenate(owner),
        np.concatenate([part.residual_mm for part in parts]),
        block_diag(*(part.nuisance for part in parts)),
        block_diag(*(part.noise_mm2 for part in parts)),
    )


def _merge_conditions(parts: Sequence[Conditions]) -> Conditions:
    """Without recorded quantities, which belong to one Run alone."""
    first = parts[0]
    return Conditions(
        first.machine,
        np.concatenate([part.position_mm for part in parts]),
        np.concatenate([part.offset_mm for part in parts]),
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([part.line for part in parts]),
        np.concatenate([part.line_time_s for part in parts]),
        np.concatenate([part.velocity_mm_s for part in parts]),
        np.concatenate([part.approach for part in parts]),
        first.observer,
        _merge_columns([part.on_workpiece for part in parts], parts),
        _merge_columns([part.line_speed_mm_s for part in parts], parts),
        seat_mm=_merge_columns([part.seat_mm for part in parts], parts),
        acceleration=_merge_columns([part.acceleration for part in parts], parts),
    )


def _merge_columns(
    columns: Sequence[np.ndarray | None], parts: Sequence[Conditions]
) -> Any:
    """Concatenate what some parts state; zero, or False, in those that do not."""
    stated = next((column for column in columns if column is not None), None)
    if stated is None:
        return None
    return np.concatenate(
        [
            np.zeros((len(part), *stated.shape[1:]), stated.dtype)
            if column is None
            else column
            for column, part in zip(columns, parts, strict=True)
        ]
    )


def _compute_starts(observations: Observations) -> Int64[np.ndarray, " n"]:
    rate_hz = observations.at.machine.tracker.rate_hz
    ends = observations.lines
    stretches = observations.count.sum() / rate_hz / _SEGMENT_S
    longest_s = _SEGMENT_S * max(1.0, stretches / max(_MOST_POINTS - len(ends), 1))
    starts: list[Int64[np.ndarray, " k"]] = []
    for first, last in ends:
        parts = 1
        if observations.at.line[first] >= 0:
            span_s = float(observations.count[first:last].sum()) / rate_hz
            parts = min(max(1, int(span_s / longest_s)), last - first)
        starts.append(first + np.arange(parts) * (last - first) // parts)
    return np.concatenate(starts)


def _list_components(
    reduced: Observations,
) -> tuple[Float64[np.ndarray, "m 3"], Int64[np.ndarray, " m"]]:
    """Three directions at a standstill, the two across it on a line."""
    directions: list[Float64[np.ndarray, "k 3"]] = []
    for travel, line in zip(reduced.direction, reduced.at.line, strict=True):
        if line < 0 or not travel.any():
            directions.append(np.eye(3))
        else:
            # The last rows of V span the plane normal to the travel.
            directions.append(np.linalg.svd(travel[None, :])[2][1:])
    owner = np.repeat(np.arange(len(reduced)), [len(each) for each in directions])
    return np.concatenate(directions), owner


def _build_nuisance(reduced: Observations) -> Float64[np.ndarray, "n 3 k"]:
    x, y, z = reduced.at.point_mm.mean(axis=0)
    targets = [
        target
        for target in reduced.at.machine.targets
        if (
            np.abs(reduced.at.offset_mm - np.array(target.offset_mm)).max(1) < 1e-6
        ).any()
    ]
    effects = [
        TrackerPose((float(x), float(y), float(z))),
        *list_target_seats([targets]),
    ]
    return np.concatenate([effect.jacobian(reduced.at) for effect in effects], axis=2)


def _build_noise(
    reduced: Observations,
    noise: NoiseModel,
    local: Float64[np.ndarray, "m 3"],
    owner: Int64[np.ndarray, " m"],
) -> Float64[np.ndarray, "m m"]:
    white, ou = split_sigma_mm(reduced, noise)
    shared = correlate_means(
        reduced.at.time_s,
        reduced.count / reduced.at.machine.tracker.rate_hz,
        noise.ou_time_s,
    )
    scaled = local * ou[owner]
    covariance = (scaled @ scaled.T) * shared[np.ix_(owner, owner)]
    own = local * white[owner]
    return covariance + (own @ own.T) * (owner[:, None] == owner)


def correlate_means(
    time_s: Float64[np.ndarray, " n"], span_s: Float64[np.ndarray, " n"], tau_s: float
) -> Float64[np.ndarray, "n n"]:
    """Covariance of means of an Ornstein–Uhlenbeck process of variance 1.

    time_s : (n,) middles of spans that do not overlap; span_s : (n,) their lengths
    """
    x = np.maximum(span_s / tau_s, 1e-6)
    # ln of the mean of e^(u/τ) over a span about 0, without overflow.
    log_mean = 0.5 * x + np.log(-np.expm1(-x) / x)
    apart = np.abs(time_s[:, None] - time_s) / tau_s
    apart = np.maximum(apart, 0.5 * (x[:, None] + x))
    shared = np.exp(log_mean[:, None] + log_mean - apart)
    np.fill_diagonal(shared, 2.0 * (x + np.expm1(-x)) / x**2)
    return shared
