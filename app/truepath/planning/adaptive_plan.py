"""The next part of an adaptive measurement: planned from all information so far.

Before each part the planner takes over the findings of the live estimate: the tracker's
position, the noise, the smoothness of the error motions, and the recognised rows. A
line on which the beam was lost is not among them, so it adds no information, and its
content is planned again. On the fly a part is a few lines; at standstill it is the next
point (Brunn & Hanebeck 2005), looking a few points ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath.errors import PlanningError
from truepath.estimation.live.live_model import LiveFindings
from truepath.estimation.live.segment_check import PreviousRun
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, append_part, select_rows
from truepath.motion.motion_times import Legs, row_times_s
from truepath.planning.design_state import DesignState
from truepath.planning.initial_design import start_design
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.planner import Planner
from truepath.planning.simulated_cells import EXPECTED_NOISE

LINES_AHEAD, POINTS_AHEAD = 3, 1  # of the longest: two or three times as many
_LEAST_JITTER = 0.1


@dataclass(frozen=True, slots=True)
class Part:
    """Next rows to measure, with the predicted result.

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
    order : its minutes are those of the whole measurement
    earlier : Runs of the measurement that it continues
    """

    def __init__(
        self,
        machine: Machine,
        commanded: Commanded,
        order: PlanRequirements,
        earlier: Sequence[PreviousRun] = (),
    ) -> None:
        self.commanded = commanded
        # On the fly only the first target is measured, while the rotary axes stand.
        order = replace(order, turns=False)
        self._machine, self._order = machine, order
        self._moving, self._drive = order.moving(machine), order.drive(machine)
        self._assumed, self._feeds = order.assume(machine), order.feeds(machine)
        self._number, self._earlier = 0, earlier

    def next(self, found: LiveFindings, sigma_mm: float) -> Part:
        """The next part; its rows count as commanded from now on.

        sigma_mm : volumetric, by the live estimate
        """
        planner, order = self._make_planner(found), self._order
        here = self.commanded.position[-1, : len(self._moving.axes)]
        used_s = self._used_s
        left_s = 60.0 * (order.minutes or np.inf) - used_s
        budget_s = min(self._horizon_s, left_s)
        self._number += 1
        try:
            plan = planner.plan(budget_s, start=here, seed=order.seed + self._number)
        except PlanningError:
            return Part(None)  # nothing that is allowed fits in any more
        part = plan
        if not order.is_on_the_fly:
            plan, part = select_rows(plan, slice(2)), select_rows(plan, slice(1, 2))
        after = planner.update(plan).design.integrated_variance
        ratio = after / planner.design.integrated_variance
        self.commanded = append_part(self.commanded, part)
        predicted_mm = sigma_mm * float(np.sqrt(ratio))
        rows = len(part) - order.is_on_the_fly
        return Part(part, rows, self._used_s - used_s, predicted_mm)

    def _make_planner(self, found: LiveFindings) -> Planner:
        """Planner with the information of all recognised rows.

        The last one may wait for samples that come after it.
        """
        order, design = self._order, self._make_design(found)
        workspace = order.workspace
        if workspace.stations is not None:
            workspace = workspace.place_tracker(found.station_mm)
        is_free = order.is_on_the_fly and not order.feeds_mm_min
        planner = Planner(self._machine, design, workspace, self._feeds, is_free)
        here = self.commanded, {*found.rows, len(self.commanded) - 1}
        for rows, measured in (*((e.executed, e.rows) for e in self._earlier), here):
            for row in sorted(measured):
                line = slice(max(row - 1, 0), row + 1)
                planner = planner.update(select_rows(rows, line))
        return planner

    def _make_design(self, found: LiveFindings) -> DesignState:
        # Few lines may show no jitter of the feed, but there is always some.
        least_mm = _LEAST_JITTER * EXPECTED_NOISE.along_sigma_mm
        along_mm = max(found.noise.along_sigma_mm, least_mm)
        assumed = replace(
            self._assumed,
            noise=replace(found.noise, along_sigma_mm=along_mm),
            prior_precision=found.prior_precision,
        )
        target = None
        if not self._order.is_on_the_fly:
            target = self.commanded.target[-1] if self.commanded.target else ""
        return start_design(
            self._order.design_kind,
            self._machine,
            found.station_mm,
            self._drive,
            assumed,
            target=target,
        )

    @property
    def _horizon_s(self) -> float:
        low, high = self._moving.travel
        slowest = np.array([min(self._feeds)])
        leg_s = float(self._drive.times_s(Legs(low[None], high[None], slowest))[0])
        return (LINES_AHEAD if self._order.is_on_the_fly else POINTS_AHEAD) * leg_s

    @property
    def _used_s(self) -> float:
        driven = (*(run.executed for run in self._earlier), self.commanded)
        feed, limits = self._feeds[0], self._machine.motion
        return sum(float(row_times_s(rows, feed, limits).sum()) for rows in driven)
