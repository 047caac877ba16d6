"""Plans within a time or for a target, from one station of the tracker or several.

The plan has most information for its time; the forecast gives the uncertainty after it,
by the model, prior and noise of the later estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.workspace.workspace import MOVE_S
from truepath.planning.initial_design import choose_station
from truepath.planning.line_suggestions import find_set_up_remedies
from truepath.planning.plan import Plan, PlanAttempt
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.simulated_cells import assume_stations_mm
from truepath.planning.stations.station_selection import APART_MM, StationChoice
from truepath.progress import Progress, ignore_progress

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
    remedies = find_set_up_remedies(
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
