"""Request for a plan: mode, time or target, feeds, workspace, with validation.

Where feeds are not given, lines choose from those of the machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from truepath.errors import PlanningError
from truepath.estimation.problem.prior_model import PriorEffects, PriorModel
from truepath.kinematics.machine.machine import Machine, remove_rotary_axes
from truepath.motion.motion_times import Drive
from truepath.motion.nc_programs.programs import LARGEST_FEED_MM_MIN
from truepath.motion.paths.commanded_rows import check_feed
from truepath.motion.workspace import Workspace, inner_travel
from truepath.planning.design_state import DesignState, LineDesignState
from truepath.planning.forecast import Assumptions
from truepath.planning.next_configuration import PointDesignState
from truepath.planning.stations.station_selection import MOST_STATIONS

LINE_DWELL_S, POINT_DWELL_S = 0.4, 1.0
DEFAULT_MINUTES = {"otf": 3.0, "standstill": 4.0}
_FEEDS, _LOWER = 4, 0.63  # number of feeds, and the ratio of neighbours
_LEAST_FEED_MM_MIN = 10.0
# Only lines near the longest give two to six times the uncertainty.
_OF_LONGEST = 0.5


@dataclass(frozen=True, slots=True)
class PlanRequirements:
    """Request for a plan.

    mode : `otf` or `standstill`
    minutes : at most; target_um : volumetric uncertainty (k = 1) to reach
    feeds_mm_min : several to distinguish dynamic effects from static ones; empty for
        those with most information per second
    max_feed_mm_min : highest feed to choose; None for the machine's
    corner_path : the path of the 2023 paper instead, for comparison
    model : with effects to be distinguished from the error motions and each other
    turns : rotary axes turn on the lines as well
    stations : number of tracker stations, which share the minutes
    """

    mode: str = "otf"
    minutes: float | None = None
    target_um: float | None = None
    feeds_mm_min: tuple[float, ...] = ()
    dwell_s: float | None = None
    perpendicular_only: bool = False
    corner_path: bool = False
    workspace: Workspace = field(default_factory=Workspace)
    seed: int = 0
    model: PriorModel | None = None
    turns: bool = True
    stations: int = 1
    max_feed_mm_min: float | None = None

    @property
    def is_on_the_fly(self) -> bool:
        return self.mode == "otf"

    @property
    def budget_s(self) -> float:
        """Longest time of a plan without a target."""
        return 60.0 * (self.minutes or DEFAULT_MINUTES[self.mode])

    @property
    def design_kind(self) -> type[DesignState]:
        return LineDesignState if self.is_on_the_fly else PointDesignState

    def select_effects(self, machine: Machine) -> PriorEffects:
        model = self.model
        return PriorEffects() if model is None else model.select_effects(machine)

    def assume(self, machine: Machine) -> Assumptions:
        """Default noise and prior, with the model's effects."""
        return Assumptions(self.select_effects(machine), self.perpendicular_only)

    def moving(self, machine: Machine) -> Machine:
        """The machine without rotary axes that stay at rest."""
        is_at_rest = self.is_on_the_fly and (self.corner_path or not self.turns)
        return remove_rotary_axes(machine) if is_at_rest else machine

    def drive(self, machine: Machine) -> Drive:
        moving = self.moving(machine)
        if self.is_on_the_fly:
            return Drive.of_lines(moving, self.dwell_s or LINE_DWELL_S)
        return Drive.of_machine(moving, self.dwell_s or POINT_DWELL_S)

    def feeds(self, machine: Machine) -> tuple[float, ...]:
        """Requested feeds, else those that lines choose from.

        Highest first: that of the machine or the request, or less where only lines of
        more than half the volume's diagonal hold it. Between points it is the machine's
        highest.
        """
        asked = self.max_feed_mm_min or np.inf
        highest = min(machine.motion.max_feed_mm_min, LARGEST_FEED_MM_MIN, asked)
        if self.feeds_mm_min:
            return self.feeds_mm_min
        if not self.is_on_the_fly:
            return (highest,)
        low, high = inner_travel(remove_rotary_axes(machine))
        longest_mm = float(np.linalg.norm(high - low))
        drive = replace(self.drive(machine), least_mm=0.0)
        while highest > _LEAST_FEED_MM_MIN:
            if drive.shortest_mm(highest)[0] <= _OF_LONGEST * longest_mm:
                break
            highest *= _LOWER
        return tuple(_round_down(highest * _LOWER**k) for k in range(_FEEDS))

    def reject_nonsense(self, machine: Machine) -> None:
        """Raise PlanningError for numbers that no plan can follow."""
        if self.mode not in DEFAULT_MINUTES:
            raise PlanningError(f"mode is {self.mode!r}; it is otf or standstill")
        numbers = [("minutes", self.minutes), ("target_um", self.target_um)]
        numbers += [("dwell_s", self.dwell_s)]
        for name, value in numbers:
            if value is not None and not 0.0 < value < np.inf:
                raise PlanningError(f"{name} is {value:g}; it must be above 0")
        if self.max_feed_mm_min and (self.feeds_mm_min or not self.is_on_the_fly):
            raise PlanningError(
                "max_feed_mm_min limits feeds that are chosen, on the fly; leave it "
                "out where feeds are given or points are measured"
            )
        for feed_mm_min in self.feeds_mm_min:
            check_feed(machine, feed_mm_min)
        if self.max_feed_mm_min is not None:  # else the machine limits
            check_feed(
                machine, min(self.max_feed_mm_min, machine.motion.max_feed_mm_min)
            )
        if self.corner_path and (self.minutes or self.target_um):
            raise PlanningError(
                "a corner path is as long as it is; leave minutes and target out"
            )
        if self.corner_path and self.mode != "otf":
            raise PlanningError("a corner path is driven on the fly; use mode otf")
        if self.stations > 1:
            self._reject_stations()

    def _reject_stations(self) -> None:
        if self.workspace.stations is None:
            raise PlanningError(
                f"stations is {self.stations}, but the workspace states no areas for "
                "the tracker; add tracker.areas"
            )
        if self.target_um is not None or self.corner_path:
            raise PlanningError(
                "several stations share a time; leave target and corner path out"
            )
        if self.stations > MOST_STATIONS:
            raise PlanningError(
                f"stations is {self.stations}; at most {MOST_STATIONS} are planned"
            )


def _round_down(feed_mm_min: float) -> float:
    step = 10.0 ** (math.floor(math.log10(feed_mm_min)) - 2)
    return step * math.floor(feed_mm_min / step + 1e-9)
