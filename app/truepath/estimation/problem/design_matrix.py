"""The design matrix: partial derivatives of measured minus nominal.

Every estimate, live or batch, every plan and every discovery takes its rows from here:
the Jacobian of the machine's effects, the pose of the tracker and the timing of the
lines, rotated into the beam frame. The pose is linearised about its latest value and
solved jointly with the errors, never by fitting points to the closest point of the
path, which would absorb errors into the pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from truepath.alignment.observations.observations import CellMeans, Observations
from truepath.estimation.problem.noise import NoiseModel, cell_noise
from truepath.kinematics.effects.base import Effect, EffectOfRun, Parameter
from truepath.kinematics.effects.pose_timing_seats import TimingLaw, TrackerPose
from truepath.kinematics.model import MachineModel
from truepath.numerics.correlated_noise import Whitener, factorise
from truepath.numerics.rigid import RigidTransform

_CELLS = 500  # of a block: few enough for the processor's cache, enough for its BLAS


@dataclass(frozen=True, slots=True)
class DesignMatrix:
    """Rows of some cells, in the beam frame.

    frame : (n, 3, 3) workpiece to beam frame
    rows : (n, 3, p + 1 + t) over machine and poses, then the residual, then phase and
        speed of each line
    fixed : p, columns of machine and poses; lines : those with columns of timing
    """

    observations: Observations
    frame: Float64[np.ndarray, "n 3 3"]
    rows: Float64[np.ndarray, "n 3 q"]
    fixed: int
    lines: tuple[int, ...]

    @property
    def columns(self) -> Float64[np.ndarray, "n 3 p"]:
        """Machine first, then poses."""
        return self.rows[:, :, : self.fixed]

    @property
    def residual(self) -> Float64[np.ndarray, "n 3"]:
        """Measured minus nominal, mm."""
        return self.rows[:, :, self.fixed]

    @property
    def timing(self) -> Float64[np.ndarray, "n 3 t"]:
        """Phase and speed of each line."""
        return self.rows[:, :, self.fixed + 1 :]

    @property
    def travel(self) -> Float64[np.ndarray, "n 3"]:
        """Unit vector in the beam frame, 0 at a standstill."""
        return np.einsum("nij,nj->ni", self.frame, self.observations.direction)

    def restrict_to(self, along: Float64[np.ndarray, "m r"]) -> DesignMatrix:
        """Amplitudes of some directions of the first parameters in place of all."""
        size, count = along.shape
        flat = self.rows.reshape(-1, self.rows.shape[2])  # as one product, not by cells
        rows = np.hstack([flat[:, :size] @ along, flat[:, self.fixed :]])
        return replace(self, rows=rows.reshape(len(self.rows), 3, -1), fixed=count)

    def whiten(self, noise: NoiseModel) -> Whitener:
        """V⁻¹ of the cells, in the beam frame."""
        precision, ou_sigma = cell_noise(self.observations, noise, self.travel)
        time_s = self.observations.at.time_s
        return factorise(time_s, precision, ou_sigma, noise.ou_time_s)

    def fit_timing(
        self, whitener: Whitener, columns: Float64[np.ndarray, "n 3 p"]
    ) -> tuple[Float64[np.ndarray, "t p"], Float64[np.ndarray, "n 3 t"]]:
        """Least-squares phase and speed for columns, and V⁻¹ timing."""
        timing = self.timing
        weighted = whitener.apply(timing)
        if not timing.size:
            return np.zeros((timing.shape[2], columns.shape[2])), weighted
        H = np.tensordot(weighted, timing, axes=((0, 1), (0, 1)))
        right = np.tensordot(weighted, columns, axes=((0, 1), (0, 1)))
        return np.linalg.lstsq(H, right, rcond=None)[0], weighted

    def weigh(
        self, whitener: Whitener, columns: Float64[np.ndarray, "n 3 p"]
    ) -> Float64[np.ndarray, "n 3 p"]:
        """V⁻¹ columns, the timing of the lines taken out."""
        timing, weighted = self.fit_timing(whitener, columns)
        return whitener.apply(columns) - weighted @ timing

    def explain_timing(
        self, whitener: Whitener, rest: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Part of residuals that phase and speed of the lines explain."""
        timing, _ = self.fit_timing(whitener, rest[:, :, None])
        return (self.timing @ timing)[:, :, 0]


@dataclass(frozen=True)
class Linearisation:
    """The point about which the problem is linear; constant while rows are built.

    machine_model : effects of the machine, whose parameters come first
    tracker : the correction of the pose
    pose : workpiece to tracker, about which the pose is linear
    theta : (m,) of the machine, about which it is linear; None for 0
    runs : number of Runs that share the machine's parameters here, each with a separate
        pose; 0 for a single Run
    """

    machine_model: MachineModel
    tracker: TrackerPose
    pose: RigidTransform
    noise: NoiseModel
    theta: Float64[np.ndarray, " m"] | None = None
    runs: int = 0

    @cached_property
    def model(self) -> MachineModel:
        """The machine's effects, then the poses."""
        poses: list[Effect] = [self.tracker]
        if self.runs:
            poses = [EffectOfRun(self.tracker, run) for run in range(self.runs)]
        return self.machine_model.with_effects(*poses)

    @property
    def size(self) -> int:
        return self.model.size

    @property
    def about(self) -> Float64[np.ndarray, " k"]:
        """Linearisation point of the machine's parameters; empty for 0."""
        return np.zeros(0) if self.theta is None else self.theta

    @property
    def pose_parameters(self) -> tuple[Parameter, ...]:
        return self.model.parameters[self.machine_model.size :]

    @property
    def has_timing(self) -> bool:
        """False where only deviations across the travel count."""
        return bool(np.isfinite(self.noise.along_sigma_mm))

    def count_untimed(self, observations: Observations) -> int:
        """Number of cells of which only the components across the travel count."""
        moves = observations.direction.any(axis=1)
        return int((moves & (observations.is_ramp | (not self.has_timing))).sum())

    def build(
        self,
        observations: Observations,
        *,
        solved: Float64[np.ndarray, " p"] | None = None,
    ) -> DesignMatrix:
        """Rows of cells that form whole lines or standstills.

        solved : all parameters, if known: their columns are omitted, and the residual
            is measured minus modelled
        """
        p, local, lines = self._build_local(observations, solved)
        return self._turn(observations, p, local, lines)

    def build_merged(self, observations: Observations, merge: int) -> DesignMatrix:
        """Rows of all cells, up to `merge` neighbours of a line averaged to one."""
        merged, p = _merge_cells(observations, merge), self.size
        lines = self._list_lines(observations)
        local = np.zeros((len(merged), 3, p + 1 + len(TimingLaw(lines).parameters)))
        row = column = 0
        for cells in cut_into_blocks(observations):
            part = observations.select(np.r_[cells])
            own = _build_means(part, merge).of(self._build_local(part, None)[1])
            rows, last = slice(row, row + len(own)), column + own.shape[2] - p - 1
            local[rows, :, : p + 1] = own[:, :, : p + 1]
            local[rows, :, p + 1 + column : p + 1 + last] = own[:, :, p + 1 :]
            row, column = row + len(own), last
        return self._turn(merged, p, local, lines)

    def _turn(
        self,
        observations: Observations,
        fixed: int,
        local: Float64[np.ndarray, "n 3 q"],
        lines: tuple[int, ...],
    ) -> DesignMatrix:
        frame = observations.beam_frame @ self.pose.rotation
        return DesignMatrix(observations, frame, frame @ local, fixed, lines)

    def _build_local(
        self, observations: Observations, solved: Float64[np.ndarray, " p"] | None
    ) -> tuple[int, Float64[np.ndarray, "n 3 q"], tuple[int, ...]]:
        p, at = self.size if solved is None else 0, observations.at
        lines = self._list_lines(observations)
        timing = TimingLaw(lines)
        local = np.empty((len(observations), 3, p + 1 + len(timing.parameters)))
        local[:, :, p] = self.pose.invert().apply(observations.tracker_mm) - at.point_mm
        if solved is None:
            for effect in self.model.effects:
                local[:, :, self.model.slices[effect.name]] = effect.jacobian(at)
            local[:, :, p] -= local[:, :, : len(self.about)] @ self.about
        else:
            whole = solved + np.pad(self.about, (0, len(solved) - len(self.about)))
            local[:, :, p] -= self.model.displacement_mm(at, whole)
        if lines:
            local[:, :, p + 1 :] = timing.jacobian(at)
            local[observations.is_ramp, :, p + 1 :] = 0.0  # they are not timed
        return p, local, lines

    def _list_lines(self, observations: Observations) -> tuple[int, ...]:
        line = observations.at.line
        lines = np.unique(line[line >= 0]) if self.has_timing else ()
        return tuple(int(line) for line in lines)

    def split(
        self,
        observations: Observations,
        solved: Float64[np.ndarray, " p"] | None = None,
    ) -> Iterator[DesignMatrix]:
        """Rows of all cells in their order, some whole lines at a time.

        solved : as in `build`
        """
        for cells in cut_into_blocks(observations):
            yield self.build(observations.select(np.r_[cells]), solved=solved)

    def correct_pose(self, theta: Float64[np.ndarray, " p"]) -> RigidTransform:
        own = theta[self.model.slices[self.tracker.name]]
        return self.tracker.correct(self.pose, own)

    def restrict(self, effects: Sequence[Effect]) -> Linearisation:
        model = replace(self.machine_model, effects=tuple(effects))
        return replace(self, machine_model=model)

    def select_columns(self, effects: Sequence[Effect]) -> Bool[np.ndarray, " p"]:
        """Mask of the columns that remain if only these effects of the machine do."""
        names = {effect.name for effect in effects}
        keep = np.ones(self.size, bool)
        for effect in self.machine_model.effects:
            keep[self.model.slices[effect.name]] = effect.name in names
        return keep


def cut_into_blocks(observations: Observations) -> Iterator[slice]:
    """Whole lines, at least 500 cells a block where possible."""
    first = 0
    for _, last in observations.lines:
        if last - first >= _CELLS or last == len(observations):
            yield slice(first, last)
            first = last


def linearise(
    observations: Observations,
    machine_model: MachineModel,
    pose: RigidTransform,
    noise: NoiseModel,
) -> Linearisation:
    """The problem of one Run; its pose turns about the middle of the points."""
    tracker = TrackerPose(middle_of(observations))
    return Linearisation(machine_model, tracker, pose, noise)


def middle_of(observations: Observations) -> tuple[float, float, float]:
    x, y, z = observations.at.point_mm.mean(axis=0)
    return float(x), float(y), float(z)


def _build_means(observations: Observations, merge: int) -> CellMeans:
    bounds = [np.arange(a, b, merge) for a, b in observations.stretches]
    return CellMeans(observations.count, np.concatenate(bounds))


def _merge_cells(observations: Observations, merge: int) -> Observations:
    """Averages in the workpiece frame, where a line keeps its direction."""
    means = _build_means(observations, merge)
    at, firsts = observations.at, observations.select(means.starts)
    travel = means.of(observations.direction)  # on an arc it turns on the way
    speed = np.linalg.norm(travel, axis=1, keepdims=True)
    return replace(
        firsts,
        at=replace(
            firsts.at,
            time_s=means.of(at.time_s),
            line_time_s=means.of(at.line_time_s),
        ),
        tracker_mm=means.of(observations.tracker_mm),
        count=means.count,
        direction=travel / np.maximum(speed, 1e-12),
    )
