"""Plans measurements: within a time and workspace, from where the machine is.

A planner is a value. After some of its legs are measured, `update` gives one with their
information; after a change of noise, prior or model, `replace` its design; then plan
again from the present position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import Legs, Stops
from truepath.motion.workspace.travel import DECIMALS, check_travel, inner_travel
from truepath.motion.workspace.workspace import Workspace
from truepath.planning.design_state import DesignState
from truepath.planning.lines.leg_choice import LegChoice, SearchEffort, SearchRegion
from truepath_drivers.interfaces.records import Path

_STARTS = 400  # positions tried where no corner is allowed


@dataclass(frozen=True)
class Planner:
    """Inputs of a plan.

    design : of lines or of standstills; its machine may lack the rotary axes of
        `machine`, which then stay at 0, or at the near end of their travel
    feeds_mm_min : several to distinguish dynamic effects from static ones, used in
        turn; or those to choose from for each line, where the choice is free
    """

    machine: Machine
    design: DesignState
    workspace: Workspace
    feeds_mm_min: tuple[float, ...]
    is_free: bool = False

    def plan(
        self,
        budget_s: float = np.inf,
        *,
        legs: int | None = None,
        start: Float64[np.ndarray, " a"] | None = None,
        seed: int = 0,
        effort: SearchEffort | None = None,
    ) -> Commanded:
        """The plan with most information that takes no longer than the budget.

        A path for a design of lines, points for one of standstills. It starts and ends
        at different points. The same seed gives the same plan.

        legs : at most
        start : positions of the design's axes; None for a corner
        Raises PlanningError if no motion fits in, or none is allowed.
        """
        rng = np.random.default_rng(seed)
        region = self.region()
        if not self._is_apart(np.stack([region.low, region.high])):
            raise PlanningError(self._hindrance())
        begin = self._first_stop(region, rng) if start is None else start
        choice = LegChoice(
            self.design,
            region,
            self.feeds_mm_min,
            rng,
            effort or SearchEffort(),
            self.is_free,
        )
        budget_s -= self.design.drive.dwell_s
        stops = choice.stops(begin, budget_s, legs)
        while len(stops) > 2 and not self._is_apart(stops.position[[0, -1]]):
            stops = stops.select(slice(len(stops) - 1))  # it came back to its beginning
        plan = self.design.command(self.machine, stops)
        self.check(plan)
        return plan

    def update(self, done: Commanded) -> Planner:
        """Adds the information of measured legs.

        done : rows of a plan that follow each other, from where the first leg began
        """
        return replace(self, design=self.design.add(self.inform(done)))

    def inform(self, done: Commanded) -> Float64[np.ndarray, "p p"]:
        """Information of legs, as for `update`."""
        return self.design.information(self._find_legs(done))

    def expect(self, precision: float | Float64[np.ndarray, "p p"]) -> Planner:
        """Adds information from elsewhere, as `inform` gives it."""
        known = self.design.precision + precision
        return replace(self, design=replace(self.design, precision=known))

    def duration_s(self, done: Commanded) -> float:
        """Time of legs with their dwells."""
        return float(self.design.drive.times_s(self._find_legs(done)).sum())

    def _find_legs(self, done: Commanded) -> Legs:
        feed = np.full(len(done), self.feeds_mm_min[0])
        if isinstance(done, Path):
            feed = done.feed_mm_min
        columns = len(self.design.model.machine.axes)
        return Stops(done.position[:, :columns], feed).legs

    def check(self, plan: Commanded) -> None:
        """Raise PlanningError if a plan leaves the travel or the workspace."""
        check_travel(self.machine, plan)
        self.workspace.require_allowed(self.machine, plan)

    def _is_apart(self, ends: Float64[np.ndarray, "2 a"]) -> bool:
        feed = max(self.feeds_mm_min)
        anyhow = replace(self.design.drive, least_mm=0.0)
        design = replace(self.design, drive=anyhow)
        return bool(design.fits(Stops(ends, np.full(2, feed)).legs)[0])

    def _hindrance(self) -> str:
        if self.design.model.machine.rotary_axes:
            return (
                f"target {self.design.target.name} hardly moves where the tracker "
                "stands; place it farther from the axes that turn it"
            )
        return (
            f"the travel of {self.machine.name} is too short for a steady feed of "
            f"{max(self.feeds_mm_min):g} mm/min; lower the feed"
        )

    def region(self) -> SearchRegion:
        """Allowed stops, and allowed lines between them."""
        machine = self.design.model.machine
        low, high = inner_travel(machine)

        def allows(legs: Legs) -> Bool[np.ndarray, " n"]:
            free = self.workspace.allows(machine, legs.begin, legs.end)
            return self.design.fits(legs) & free

        return SearchRegion(low, high, allows)

    def _first_stop(
        self, region: SearchRegion, rng: np.random.Generator
    ) -> Float64[np.ndarray, " a"]:
        low, high = region.low, region.high
        corners = np.array(list(product(*zip(low, high, strict=True))))
        anywhere = np.round(rng.uniform(low, high, (_STARTS, len(low))), DECIMALS)
        places = np.vstack([corners, anywhere])
        free = self.workspace.allows(self.design.model.machine, places, places)
        if not free.any():
            raise PlanningError(
                "no place in the travel is free of keep-out boxes and in range and in "
                "sight of the tracker; correct the workspace"
            )
        return places[int(np.argmax(free))]


def inform(
    planners: Sequence[Planner], blocks: Sequence[Commanded]
) -> Float64[np.ndarray, "p p"]:
    """Total information of blocks, each with its planner's target."""
    pairs = zip(planners, blocks, strict=True)
    return np.sum([planner.inform(block) for planner, block in pairs], axis=0)


def assess_feeds(
    planners: Sequence[Planner], blocks: Sequence[Path]
) -> dict[float, float]:
    """Information per second at each feed, relative to the paths' own feeds.

    All lines are at that feed, as far as it is reached.

    planners : of one model; blocks : the plan of each
    """

    def worth(driven: Sequence[Path]) -> float:
        known = planners[0].design.add(inform(planners, driven))
        pairs = zip(planners, driven, strict=True)
        time_s = sum(planner.duration_s(path) for planner, path in pairs)
        return 1.0 / (known.integrated_variance * time_s)

    def drive_at(feed_mm_min: float) -> list[Path]:
        return [
            replace(path, feed_mm_min=np.full(len(path), feed_mm_min))
            for path in blocks
        ]

    own = worth(blocks)
    return {f: worth(drive_at(f)) / own for f in planners[0].feeds_mm_min}
