"""Information of a measurement from a station, before the lines are chosen.

The same survey of the travel is put through the estimator's own equations from every
station: the part that the station does not see is dropped, as a plan's lines would
avoid it, the tracker's pose and the timing of the lines are integrated out, and the
rest is scaled to one second of measuring. So stations compare at equal time, whatever
each sees. In addition to the machine's parameters there are the tracker's errors within
its specification, as in every estimate: those common to all stations, and those of
each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.errors import Unidentifiable
from truepath.estimation.problem.normal_equations import RunInput, collect_information
from truepath.kinematics.coarse_model import add_half_widths
from truepath.kinematics.effects.instrument import (
    FineCircle,
    SetUpErrors,
    TrackerErrors,
)
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import row_times_s
from truepath.motion.workspace import Workspace, add_resting_axes
from truepath.numerics.scaled_cholesky import ScaledCholesky
from truepath.planning.forecast import Assumptions
from truepath.planning.simulated_cells import predict_cells
from truepath_drivers.interfaces.records import Path

INTERVALS = 6  # of the knots, as lines are chosen by
_CELLS_ACROSS = 16  # of the longest diagonal: as many as knots resolve
_GRID = 6  # positions of each axis at which visibility is checked


@dataclass(frozen=True)
class StationInformation:
    """Information of one second of measuring from one station.

    matrix : (q, q) on the machine, the common tracker errors and this set-up, pose
        integrated out
    sees : (v,) visible points of the travel
    """

    place_mm: Float64[np.ndarray, "3"]
    matrix: Float64[np.ndarray, "q q"]
    sees: Bool[np.ndarray, " v"]


@dataclass(frozen=True)
class StationVariance:
    """Variance after measuring from stations, root mean square over the travel.

    random_mm : uncertainty that time averages; systematic_mm : addition by the
        tracker's own errors
    covariance : (p, p) of both; seen : visible share of the travel
    """

    random_mm: float
    systematic_mm: float
    covariance: Float64[np.ndarray, "p p"]
    seen: float

    @property
    def sigma_mm(self) -> float:
        return float(np.hypot(self.random_mm, self.systematic_mm))

    def scale_random(self, factor: float) -> StationVariance:
        """Scales the part that time averages."""
        return replace(
            self,
            random_mm=factor * self.random_mm,
            covariance=factor**2 * self.covariance,
        )


@dataclass(frozen=True)
class Survey:
    """Lines or points for the evaluation of stations.

    machine : with all its axes; measured : as it moves while it is measured
    feed_mm_min : between points
    """

    machine: Machine
    measured: Machine
    commanded: Commanded
    workspace: Workspace
    feed_mm_min: float


@dataclass(frozen=True)
class StationEvaluator:
    """Evaluates stations by a survey.

    model : of the machine, then the tracker's errors, those of a set-up last
    prior, gram : of the machine; shared : number of tracker parameters common to all
        stations
    """

    survey: Survey
    assumed: Assumptions
    model: MachineModel
    prior: Float64[np.ndarray, "p p"]
    gram: Float64[np.ndarray, "p p"]
    shared: int

    @staticmethod
    def of(
        survey: Survey, assumed: Assumptions, specification: TrackerSpecification
    ) -> StationEvaluator:
        """For the survey's targets and the tracker's specification."""
        targets = survey.measured.targets
        names = set(survey.commanded.target) or {targets[0].name}
        offsets_mm = np.array([t.offset_mm for t in targets if t.name in names], float)
        motions, _ = build_identifiable_model(
            survey.measured, offsets_mm, intervals=INTERVALS
        )
        machine = add_half_widths(motions.with_effects(*assumed.known.effects))
        tracker = TrackerErrors(
            specification,
            FineCircle(-np.pi, np.pi),
            FineCircle(-0.5 * np.pi, 0.5 * np.pi),
            isinstance(survey.commanded, Path),
        )
        takes_s = float(row_times_s(survey.commanded, survey.feed_mm_min).sum())
        set_up = SetUpErrors(specification, 0.0, takes_s)
        return StationEvaluator(
            survey,
            assumed,
            machine.with_effects(tracker, set_up),
            assumed.make_prior(machine),
            compute_volumetric_gram(machine),
            len(tracker.parameters),
        )

    def assess(self, place_mm: Float64[np.ndarray, "3"]) -> StationInformation | None:
        """None where the station does not even determine its own pose."""
        survey = self.survey
        workspace = survey.workspace.place_tracker(place_mm)
        cells = predict_cells(
            survey.measured, survey.commanded, place_mm, cell_mm=self._cell_mm
        )
        at_mm = cells.at.position_mm
        seen = workspace.allows(survey.measured, at_mm, at_mm)
        if not seen.any():
            return None
        seconds = row_times_s(survey.commanded, survey.feed_mm_min).sum()
        seconds *= cells.count[seen].sum() / cells.count.sum()
        cells = cells.select(np.flatnonzero(seen))
        run = RunInput(cells, cells.pose, self.assumed.used_noise)
        try:
            found = collect_information([run], self.model)[0].own.eliminate()
        except Unidentifiable:
            return None
        everywhere = self._grid
        return StationInformation(
            place_mm,
            found.matrix / seconds,
            workspace.allows(survey.machine, everywhere, everywhere),
        )

    def evaluate(
        self, stations: Sequence[StationInformation], time_s: float
    ) -> StationVariance:
        p, each_s = len(self.prior), time_s / len(stations)
        common = p + self.shared
        own = self.model.size - common
        precision = np.eye(common + len(stations) * own)
        precision[:p, :p] = self.prior
        for k, one in enumerate(stations):
            first = common + k * own
            place = np.r_[:common, first : first + own]
            precision[np.ix_(place, place)] += each_s * one.matrix
        covariance = ScaledCholesky.of(precision).invert()[:p, :p]
        perfect = ScaledCholesky.of(precision[:p, :p]).invert()
        total, random = (float(np.sum(self.gram * C)) for C in (covariance, perfect))
        return StationVariance(
            random**0.5,
            max(total - random, 0.0) ** 0.5,
            covariance,
            float(np.any([one.sees for one in stations], axis=0).mean()),
        )

    def motion_sigmas_mm(self, found: StationVariance) -> dict[str, float]:
        """Uncertainty at the tool by each error motion alone, by its symbol."""
        return {
            motion.name: float(np.sum(self.gram[p, p] * found.covariance[p, p])) ** 0.5
            for motion in self.model.error_motions
            for p in (self.model.slices[motion.name],)
        }

    @property
    def _cell_mm(self) -> float:
        axes = self.survey.machine.linear_axes
        diagonal_mm = np.linalg.norm([axis.high - axis.low for axis in axes])
        return float(diagonal_mm) / _CELLS_ACROSS

    @property
    def _grid(self) -> Float64[np.ndarray, "v a"]:
        machine = self.survey.machine
        ticks = [np.linspace(a.low, a.high, _GRID) for a in machine.linear_axes]
        places = np.stack([g.ravel() for g in np.meshgrid(*ticks)], axis=1)
        return add_resting_axes(machine, places)
