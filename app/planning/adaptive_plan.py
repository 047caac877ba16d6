"""The next part of an adaptive measurement: planned anew from all that is known by now.

Before each part the planner is told what the live estimate has found out: where the
tracker stands, the noise, how smooth the error motions are, and which rows have been
recognised. A line that the beam was lost on has not, so it tells nothing, and what it
should have told is planned for again. On the fly a part is a few lines; at standstill
it is the next point (Brunn & Hanebeck 2005), looking a few points ahead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.errors import PlanningError
from app.estimation.live import LiveFindings
from app.kinematics.machine import Machine, remove_rotary_axes
from app.measurement.progress import schedule_rows
from app.motion.configurations import Commanded, Configurations, append_part
from app.motion.motion_times import Drive, drive_of
from app.motion.paths import ACCELERATION_MM_S2
from app.planning.design_state import DesignState, inverse
from app.planning.initial_design import start_line_design, start_point_design
from app.planning.plan import LINE_DWELL_S, POINT_DWELL_S, PlanRequest
from app.planning.planner import Planner
from app.planning.predicted_cells import EXPECTED_NOISE
from drivers.interfaces.records import Path

LINES_AHEAD, POINTS_AHEAD = 3, 1  # of the longest: two or three times as many
_LEAST_JITTER = 0.1


@dataclass(frozen=True, slots=True)
class Part:
    """What to drive next, and what it will bring.

    commanded : None where no more fits into the time
    rows : lines or points in it; duration_s : its motion and dwells
    predicted_sigma_mm : volumetric, after it
    """

    commanded: Commanded | None
    rows: int = 0
    duration_s: float = 0.0
    predicted_sigma_mm: float = 0.0


class AdaptivePlanner:
    """Chooses part after part. One thread.

    commanded : all rows so far
    request : its minutes are those of the whole measurement
    """

    def __init__(
        self, machine: Machine, commanded: Commanded, request: PlanRequest
    ) -> None:
        self.commanded = commanded
        self._request = request
        self._on_the_fly = request.mode == "otf"
        self._machine = machine
        self._moving = remove_rotary_axes(machine) if self._on_the_fly else machine
        self._known_effects = request.known(machine)
        self._number = 0

    def next(self, found: LiveFindings, sigma_mm: float) -> Part:
        """Return the next part; its rows count as commanded from now on.

        sigma_mm : volumetric, by the live estimate
        """
        planner = self._make_planner(found)
        here = self.commanded.position[-1, : len(self._moving.axes)]
        left_s = 60.0 * (self._request.minutes or np.inf) - self._used_s
        budget_s = min(self._horizon_s, left_s)
        self._number += 1
        try:
            seed = self._request.seed + self._number
            planned = planner.plan(budget_s, start=here, seed=seed)
        except PlanningError:
            return Part(None)  # nothing that is allowed fits in any more
        told = planner.measured(planned if self._on_the_fly else _rows(planned, 2))
        ratio = _criterion(told.design) / _criterion(planner.design)
        part = planned if self._on_the_fly else _rows(planned, 2, first=1)
        before_s = self._used_s
        self.commanded = append_part(self.commanded, part)
        rows = len(part) - self._on_the_fly
        predicted_mm = sigma_mm * float(np.sqrt(ratio))
        return Part(part, rows, self._used_s - before_s, predicted_mm)

    def _make_planner(self, found: LiveFindings) -> Planner:
        design, request = self._make_design(found), self._request
        feeds, drive = request.feeds_mm_min, self._drive
        told = np.zeros_like(design.precision)
        for row in sorted(self._recognised_rows(found)):
            legs = self.commanded.position[max(row - 1, 0) : row + 1]
            feed = np.full(len(legs), feeds[0])
            if isinstance(self.commanded, Path):
                feed = self.commanded.feed_mm_min[max(row - 1, 0) : row + 1]
            told += design.information(legs[:, : len(self._moving.axes)], feed, drive)
        known = replace(design, precision=design.precision + told)
        return Planner(self._machine, known, request.workspace, drive, feeds)

    def _recognised_rows(self, found: LiveFindings) -> set[int]:
        """Return the rows that have told something.

        The last one may wait for samples that come after it.
        """
        return set(found.rows) | {len(self.commanded) - 1}

    def _make_design(self, found: LiveFindings) -> DesignState:
        # Few lines may show no jitter of the feed at all; there is always some.
        least_mm = _LEAST_JITTER * EXPECTED_NOISE.along_sigma_mm
        along_mm = max(found.noise.along_sigma_mm, least_mm)
        noise = replace(found.noise, along_sigma_mm=along_mm)
        if self._on_the_fly:
            return start_line_design(
                self._machine,
                found.station_mm,
                known=self._known_effects,
                perpendicular_only=self._request.perpendicular_only,
                noise=noise,
                prior_precision=found.prior_precision,
            )
        return start_point_design(
            self._machine,
            found.station_mm,
            self.commanded.target[-1] if self.commanded.target else "",
            known=self._known_effects,
            noise=noise,
            prior_precision=found.prior_precision,
        )

    @property
    def _drive(self) -> Drive:
        usual = LINE_DWELL_S if self._on_the_fly else POINT_DWELL_S
        dwell_s = self._request.dwell_s or usual
        return drive_of(
            self._moving, acceleration_mm_s2=ACCELERATION_MM_S2, dwell_s=dwell_s
        )

    @property
    def _horizon_s(self) -> float:
        """How far ahead is looked: so many of the longest legs."""
        low, high = np.array([(a.low, a.high) for a in self._moving.axes]).T
        slowest = np.array([min(self._request.feeds_mm_min)])
        leg_s = float(self._drive.times_s(low[None], high[None], slowest)[0])
        return (LINES_AHEAD if self._on_the_fly else POINTS_AHEAD) * leg_s

    @property
    def _used_s(self) -> float:
        feed = self._request.feeds_mm_min[0]
        return float(schedule_rows(self.commanded, feed).row_s.sum())


def _rows(points: Commanded, count: int, *, first: int = 0) -> Configurations:
    """Return the first points of a plan, less those before `first`."""
    return Configurations(
        points.axes,
        points.position[first:count],
        points.dwell_s[first:count],
        points.target[first:count],
    )


def _criterion(design: DesignState) -> float:
    """Return J, the integrated variance (brunn-hanebeck-2005, eq. 34)."""
    return float(np.sum(inverse(design.precision) * design.gram))
