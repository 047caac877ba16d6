"""A plan for one station, evaluated by the estimator's model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine, remove_rotary_axes
from truepath.motion.configurations import Commanded, join_rows, split_by_target
from truepath.motion.motion_times import row_times_s
from truepath.motion.paths.default_points import corner_path
from truepath.motion.workspace import (
    MOVE_S,
    StationAreas,
    moves_relative_to_tracker,
    moving_targets,
)
from truepath.planning.design_state import DesignState
from truepath.planning.forecast import Assumptions, Forecast, forecast
from truepath.planning.initial_design import (
    add_station,
    choose_station,
    predict_lag_sigmas_s,
    start_design,
)
from truepath.planning.line_suggestions import SetUpRemedy, list_set_up_remedies
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.planner import Planner, SearchEffort, assess_feeds, inform
from truepath.planning.simulated_cells import assume_stations_mm
from truepath.planning.stations.station_information import StationEvaluator, Survey
from truepath.planning.stations.station_selection import (
    APART_MM,
    StationAdvice,
    StationChoice,
    choose_best_station,
)
from truepath.planning.target_blocks import (
    CHANGE_S,
    PlanShare,
    plan_in_turn,
    share_among_targets,
    wait_for_tracker,
)
from truepath.progress import Progress, ignore_progress
from truepath_drivers.interfaces.records import Path

_SURVEY_LINES, _SURVEY_POINTS = 40, 80  # for the evaluation of stations
_SURVEY_EFFORT = SearchEffort(candidates=40, rounds=0)
# If stops were moved, all axes would move on every line.
_TURNING_EFFORT = SearchEffort(candidates=40, rounds=0)


@dataclass(frozen=True)
class Plan:
    """A plan and its predicted uncertainty.

    station_mm : of the tracker; time_s : (rows,) at which each row is done
    lag_sigma_s : of each axis behind the others, where there are several feeds
    stations : advice on the tracker's station, where areas for it are known
    feeds_worth : information per second, relative to the plan's, with all lines at one
        feed; empty where the feeds were given
    further : plans from further stations, in their order; each includes the information
        of those before it, and so does its forecast
    """

    machine: Machine
    order: PlanRequirements
    commanded: Commanded
    station_mm: NDArray[np.float64]
    time_s: NDArray[np.float64]
    forecast: Forecast
    lag_sigma_s: dict[str, float]
    stations: StationAdvice | None = None
    feeds_worth: dict[float, float] = field(default_factory=dict[float, float])
    further: tuple[Plan, ...] = ()
    remedies: tuple[SetUpRemedy, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first row on, dwells included, at one station."""
        return float(self.time_s[-1])

    @property
    def at_stations(self) -> tuple[Plan, ...]:
        return (replace(self, further=()), *self.further)

    @property
    def outcome(self) -> Forecast:
        return self.at_stations[-1].forecast

    @property
    def uncertainty_um(self) -> float:
        """Predicted volumetric uncertainty, k = 1."""
        return 1e3 * self.outcome.volumetric_sigma_mm

    @property
    def reached(self) -> bool | None:
        """None without a target uncertainty."""
        target_um = self.order.target_um
        return None if target_um is None else self.uncertainty_um <= target_um


@dataclass(frozen=True)
class PlanAttempt:
    """Planning from one station.

    before : forecast after the stations before it; design : the planner's state then
    """

    machine: Machine
    order: PlanRequirements
    assumed: Assumptions
    station_mm: NDArray[np.float64]
    before: Forecast | None = None
    design: DesignState | None = None

    def plan_within(self, budget_s: float) -> Plan:
        return self._evaluate(self._choose(budget_s))

    def plan_corners(self) -> Plan:
        """The plan along the corner path.

        Raises PlanningError outside the workspace.
        """
        path = self._corners()
        self.order.workspace.require_allowed(self.machine, path)
        return self._evaluate(path)

    def place_tracker(self, place_mm: NDArray[np.float64]) -> PlanAttempt:
        workspace = self.order.workspace.place_tracker(place_mm)
        order = replace(self.order, workspace=workspace)
        return replace(self, order=order, station_mm=place_mm)

    def add_plan_information(self, plan: Plan) -> PlanAttempt:
        """Includes the information of a plan from here, for the next station."""
        known = self._planners[0].design.add(inform(*self._share(plan.commanded)))
        return replace(self, before=plan.forecast, design=known)

    def choose_best_station(self, areas: StationAreas) -> StationChoice:
        """Evaluate stations by a survey that ignores what each of them sees."""
        order, workspace = self.order, self.order.workspace
        free = replace(order, workspace=replace(workspace, tracker_mm=None))
        survey = Survey(
            self.machine,
            order.moving(self.machine),
            replace(self, order=free).survey(),
            workspace,
            order.feeds(self.machine)[0],
        )
        evaluator = StationEvaluator.of(
            survey, self.assumed, areas.find_specification(self.machine)
        )
        stated_mm = None if workspace.tracker_mm is None else self.station_mm
        return choose_best_station(evaluator, areas, order.budget_s, stated_mm)

    def survey(self) -> Commanded:
        """A few lines or points of the whole travel, chosen without a search."""
        if self.order.corner_path:
            return self._corners()
        count = _SURVEY_LINES if self.order.is_on_the_fly else _SURVEY_POINTS
        legs = -(-count // len(self._planners))
        shares = [PlanShare(planner, legs=legs) for planner in self._planners]
        return self._plan_in_turn(shares, _SURVEY_EFFORT)

    def _corners(self) -> Path:
        dwell_s = self.order.drive(self.machine).dwell_s
        return corner_path(self.machine, self.order.feeds(self.machine)[0], dwell_s)

    def _choose(self, budget_s: float) -> Commanded:
        change_s = CHANGE_S if self.order.is_on_the_fly else 0.0
        shares = share_among_targets(
            self._planners, budget_s, change_s, self.order.seed
        )
        effort = _TURNING_EFFORT if self._turns else None
        return self._plan_in_turn(shares, effort)

    @property
    def _turns(self) -> bool:
        order = self.order
        return order.is_on_the_fly and bool(order.moving(self.machine).rotary_axes)

    def _plan_in_turn(
        self, shares: Sequence[PlanShare], effort: SearchEffort | None = None
    ) -> Commanded:
        blocks = plan_in_turn(shares, seed=self.order.seed, effort=effort)
        if self.order.is_on_the_fly:
            wait_for_tracker(blocks)
        return join_rows(blocks)

    @property
    def _determines_lags(self) -> bool:
        known = self.assumed.known.effects
        return len(self.order.feeds_mm_min) > 1 or any(e.lag_axis for e in known)

    @cached_property
    def _planners(self) -> tuple[Planner, ...]:
        machine, order = self.machine, self.order
        if order.is_on_the_fly and not self._turns:
            return (self._make_planner(None),)
        first, *others = moving_targets(machine)
        planner = self._make_planner(first.name)
        return (
            planner,
            *(
                replace(planner, design=replace(planner.design, target=target))
                for target in others
            ),
        )

    def _make_planner(self, target: str | None) -> Planner:
        """Target None: the first, with the rotary axes at rest."""
        order, machine = self.order, self.machine
        if target is None and not moves_relative_to_tracker(
            remove_rotary_axes(machine), machine.target()
        ):
            raise PlanningError(
                f"the first target of {machine.name} does not move while the "
                "rotary axes stand; state one on the tool first, or use mode standstill"
            )
        feeds = order.feeds(machine)
        design = start_design(
            order.design_kind,
            machine,
            self.station_mm,
            order.drive(machine),
            self.assumed,
            target=target,
            dynamic=order.is_on_the_fly and self._determines_lags,
        )
        if self.design is not None:
            design = add_station(design, self.design)
        is_free = order.is_on_the_fly and not order.feeds_mm_min
        feeds = feeds if order.is_on_the_fly else feeds[:1]
        return Planner(machine, design, order.workspace, feeds, is_free)

    def _share(self, commanded: Commanded) -> tuple[list[Planner], list[Commanded]]:
        known = {one.design.target.name: one for one in self._planners}
        blocks = split_by_target(commanded)
        first = self._planners[0]
        return [known[b.target[0]] if b.target else first for b in blocks], blocks

    def _evaluate(self, commanded: Commanded) -> Plan:
        order = self.order
        prediction = forecast(
            order.moving(self.machine),
            commanded,
            self.station_mm,
            self.assumed,
            self.before,
        )
        limits = self.machine.motion
        time_s = np.cumsum(row_times_s(commanded, order.feeds(self.machine)[0], limits))
        lags: dict[str, float] = {}
        worth: dict[float, float] = {}
        if isinstance(commanded, Path):
            each, blocks = self._share(commanded)
            parts = [block for block in blocks if isinstance(block, Path)]
            if self._determines_lags:
                lags = predict_lag_sigmas_s(each[0].design.add(inform(each, parts)))
            if not (order.feeds_mm_min or order.corner_path):
                worth = assess_feeds(each, parts)
        return Plan(
            self.machine,
            order,
            commanded,
            self.station_mm,
            time_s,
            prediction,
            lags,
            feeds_worth=worth,
        )


_LONGEST_S = 3600.0
_FIRST_TRY_S = 60.0
_TRIES = 5
_CLOSE = 0.93  # a plan that would be shorter by less is not tried
_LITTLE = 0.1  # of a variance: without it the uncertainty is less by a twentieth


def make_plan(
    machine: Machine,
    order: PlanRequirements,
    *,
    on_progress: Progress = ignore_progress,
) -> Plan:
    """The requested plan.

    With a target it is the shortest plan found that reaches it; where none does within
    the minutes (an hour without), the plan of that length, which reports how far it
    comes, or a shorter one after which time would change hardly anything.

    Raises PlanningError if nothing can be planned; it names the reason. BundleError if
    the model is of another machine.
    """
    order.reject_nonsense(machine)
    on_progress(0.0, "planning")
    station_mm = choose_station(machine, order.workspace)
    attempt = PlanAttempt(machine, order, order.assume(machine), station_mm)
    areas = order.workspace.stations
    if areas is None:
        plan = _plan_as_ordered(attempt, on_progress)
        return _add_remedies(attempt, plan, _list_typical_points(plan), MOVE_S)
    choice = attempt.choose_best_station(areas)
    if order.stations > 1:
        plan = _plan_stations(attempt, choice, on_progress)
    else:
        first = attempt.place_tracker(choice.first.place_mm)
        plan = _plan_as_ordered(first, on_progress)
    time_s = sum(one.duration_s for one in plan.at_stations)
    scale = choice.compare(order.stations, time_s, plan.outcome.random_mm)
    advice = choice.advise(time_s, scale)
    plan = replace(plan, stations=advice)
    further = [option.place_mm[-1] for option in advice.options[order.stations :]]
    return _add_remedies(attempt, plan, further[:1], areas.move_s)


def _add_remedies(
    attempt: PlanAttempt,
    plan: Plan,
    elsewhere_mm: Sequence[NDArray[np.float64]],
    move_s: float,
) -> Plan:
    last = plan.at_stations[-1]
    remedies = list_set_up_remedies(
        attempt.order.moving(attempt.machine),
        last.commanded,
        plan.outcome,
        attempt.assumed,
        here_mm=last.station_mm,
        elsewhere_mm=elsewhere_mm,
        takes_s=last.duration_s,
        move_s=move_s,
    )
    return replace(plan, remedies=remedies)


def _list_typical_points(plan: Plan) -> list[NDArray[np.float64]]:
    found: list[NDArray[np.float64]] = []
    for place in assume_stations_mm(plan.machine):
        if np.linalg.norm(place - plan.station_mm) >= APART_MM:
            with suppress(PlanningError):
                workspace = plan.order.workspace.place_tracker(place)
                workspace.require_allowed(plan.machine, plan.commanded)
                found.append(place)
    return found


def _plan_stations(
    attempt: PlanAttempt, choice: StationChoice, on_progress: Progress
) -> Plan:
    order, plans = attempt.order, list[Plan]()
    share_s = order.budget_s / order.stations
    for number, station in enumerate(choice.choose_stations(order.stations)):
        on_progress(number / order.stations, f"station {number + 1}")
        attempt = attempt.place_tracker(station.place_mm)
        plan = attempt.plan_within(share_s)
        attempt = attempt.add_plan_information(plan)
        plans.append(plan)
    return replace(plans[0], further=tuple(plans[1:]))


def _plan_as_ordered(attempt: PlanAttempt, on_progress: Progress) -> Plan:
    order = attempt.order
    if order.corner_path:
        return attempt.plan_corners()
    if order.target_um is None:
        return attempt.plan_within(order.budget_s)
    longest_s = 60.0 * order.minutes if order.minutes else _LONGEST_S
    return _plan_for_target(attempt, order.target_um, longest_s, on_progress)


def _plan_for_target(
    attempt: PlanAttempt, target_um: float, longest_s: float, on_progress: Progress
) -> Plan:
    budget_s, short_s, found = min(_FIRST_TRY_S, longest_s), 0.0, None
    planned = attempt.plan_within(budget_s)
    for number in range(1, _TRIES):
        reached_um = planned.uncertainty_um
        on_progress(
            number / _TRIES,
            f"{budget_s:.0f} s reach {2.0 * reached_um:.2f} µm (k = 2)",
        )
        # What is random falls with the square root of time, slower where much is known.
        random_um2 = (1e3 * planned.outcome.random_mm) ** 2
        room_um2 = target_um**2 - reached_um**2 + random_um2
        wanted = float(np.clip(random_um2 / max(room_um2, 1e-9), 0.3, 6.0))
        if planned.reached:
            found = planned
        elif budget_s >= longest_s or (
            room_um2 <= 0.0 and random_um2 < _LITTLE * reached_um**2
        ):
            break
        else:
            short_s = budget_s
        if found is not None and short_s > _CLOSE * found.duration_s:
            break
        budget_s = min(budget_s * max(wanted, 1.0) * 1.05, longest_s)
        if found is not None:
            budget_s = max(found.duration_s * min(wanted, _CLOSE), 1.05 * short_s)
            budget_s = min(
                budget_s, 0.5 * (short_s + found.duration_s) if short_s else budget_s
            )
        planned = attempt.plan_within(budget_s)
    return found or planned
