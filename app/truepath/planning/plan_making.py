"""Plans within a time or for a target, from one place of the tracker or from several.

The plan is what tells most in the time it takes; the forecast says what it will leave
unknown, by the model, prior and noise that the estimate will be made with.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truepath.kinematics.machine.machine import Machine
from truepath.planning.initial_design import choose_station
from truepath.planning.plan import Plan, PlanAttempt
from truepath.planning.plan_order import PlanOrder
from truepath.planning.stations.station_choice import StationChoice
from truepath.progress import Progress, ignore_progress

_LONGEST_S = 3600.0
_FIRST_TRY_S = 60.0
_TRIES = 5
_CLOSE = 0.93  # a plan that would be shorter by less is not tried


def make_plan(
    machine: Machine, order: PlanOrder, *, on_progress: Progress = ignore_progress
) -> Plan:
    """Return the plan that was asked for.

    With a target it is the shortest plan found that reaches it; where none does within
    the minutes (an hour without), the plan of that length, which says how far it comes.

    Raises PlanningError if nothing can be planned; it names the reason. BundleError if
    the model is of another machine.
    """
    order.refuse_nonsense(machine)
    on_progress(0.0, "planning")
    station_mm = choose_station(machine, order.workspace)
    attempt = PlanAttempt(machine, order, order.assume(machine), station_mm)
    if order.workspace.stations is None:
        return _plan_as_ordered(attempt, on_progress)
    choice = attempt.choose_place(order.workspace.stations)
    if order.stations > 1:
        plan = _plan_stations(attempt, choice, on_progress)
    else:
        first = attempt.place_tracker(choice.first.place_mm)
        plan = _plan_as_ordered(first, on_progress)
    time_s = sum(one.duration_s for one in plan.at_stations)
    sigma_mm = plan.outcome.volumetric_sigma_mm
    scale = choice.compare(order.stations, time_s, sigma_mm)
    return replace(plan, stations=choice.advise(time_s, scale))


def _plan_stations(
    attempt: PlanAttempt, choice: StationChoice, on_progress: Progress
) -> Plan:
    """Return the plan from the first place, with those from further places."""
    order, plans = attempt.order, list[Plan]()
    share_s = order.budget_s / order.stations
    for number, station in enumerate(choice.choose_stations(order.stations)):
        on_progress(number / order.stations, f"station {number + 1}")
        attempt = attempt.place_tracker(station.place_mm)
        plan = attempt.plan_within(share_s)
        attempt = attempt.tell(plan)
        plans.append(plan)
    return replace(plans[0], further=tuple(plans[1:]))


def _plan_as_ordered(attempt: PlanAttempt, on_progress: Progress) -> Plan:
    """Return the plan from where the tracker stands."""
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
    """Return the shortest plan found that reaches the target, or the longest."""
    budget_s, short_s, found = min(_FIRST_TRY_S, longest_s), 0.0, None
    planned = attempt.plan_within(budget_s)
    for number in range(1, _TRIES):
        reached_um = planned.uncertainty_um
        on_progress(
            number / _TRIES, f"{budget_s:.0f} s reach {reached_um:.2f} µm (k = 1)"
        )
        # Uncertainty falls with the square root of time, slower where much is known.
        wanted = float(np.clip((reached_um / target_um) ** 2, 0.3, 6.0))
        if planned.reached:
            found = planned
        elif budget_s >= longest_s:
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
