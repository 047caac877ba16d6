"""Request of a plan, as JSON: kept with its job, computed by an executor.

{"mode": "otf", "minutes": 5, "target_um": 1.0, "feeds_mm_min": [6000],
"max_feed_mm_min": 6000, "dwell_s": 0.4, "perpendicular_only": false,
"corner_path": false, "seed": 0, "stations": 1, "workspace": {…},
"model_id": "…", "model_file": "…"}

Without `mode` it is the default path at the first of the feeds; with it all other keys
are optional. `target_um` is a standard uncertainty (k = 1), as everywhere in the
interface; `workspace` is the content of a workspace file; `model_file` is that of the
job `model_id`, put in when the plan is computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from truepath.catalogue.job import Json
from truepath.errors import AlignmentError, PlanningError, Unidentifiable
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.paths.commanded_rows import MAX_ROWS, Row, check_feed, command_rows
from truepath.motion.workspace import Workspace
from truepath.progress import Progress
from truepath_drivers.interfaces.records import Path

if TYPE_CHECKING:
    from truepath.planning.plan import Plan
    from truepath.planning.plan_request import PlanRequirements

_FEWEST = 3  # points that determine the tracker's pose


def command_measurable_rows(
    machine: Machine,
    rows: Sequence[Row],
    feed_mm_min: float | None,
    *,
    is_path: bool,
) -> Commanded:
    """Rows in the form that a measurement commands. Raises PlanningError.

    feed_mm_min : of rows without their own
    """
    check_feed(machine, feed_mm_min)
    commanded = command_rows(machine, rows, feed_mm_min, is_path=is_path)
    require_measurable(machine, commanded)
    return commanded


def require_measurable(machine: Machine, commanded: Commanded) -> None:
    """Raise PlanningError where rows do not determine the pose of the tracker.

    The target has to be at three points that are not on one straight line.
    """
    # Imported where it is needed: the service itself carries no science.
    from truepath.alignment.stream.nominal_path import (
        compute_nominal_path,
        require_spread,
    )

    place_mm = compute_nominal_path(machine, commanded).place_mm
    what = "the path" if isinstance(commanded, Path) else "the list of points"
    if len(place_mm) < _FEWEST:
        raise PlanningError(
            f"{what} has the target stand at {len(place_mm)} "
            f"{'place' if len(place_mm) == 1 else 'places'}; where the tracker stands "
            "is told by three at least that are not on one straight line: add rows, or "
            "give a plan more minutes"
        )
    try:
        require_spread(place_mm, what)
    except AlignmentError as error:
        raise PlanningError(str(error)) from error


def name_what_stays_open(
    machine: Machine, commanded: Commanded, workspace: Workspace
) -> str:
    """Parameters that these rows alone would not determine, as text; else empty.

    Such rows are measured all the same: Runs are analysed together as well, and another
    one may determine them.
    """
    # Imported where it is needed: the service itself carries no science.
    from truepath.planning.forecast import predict_undetermined
    from truepath.planning.initial_design import choose_station

    station_mm = choose_station(machine, workspace)
    try:
        return predict_undetermined(machine, commanded, station_mm)
    except (PlanningError, Unidentifiable) as error:
        return str(error)


_PLAIN = ("mode", "minutes", "target_um", "max_feed_mm_min", "dwell_s")
_PLAIN += ("perpendicular_only", "corner_path", "seed", "turns", "stations")
STATION_KEYS = ("stations", "known_points", "specification")
_FIRST_LINES, _FIRST_POINTS = 5, 4  # of the longest: two or three times as many
_STANDS_S = 1.0  # at the end of each


def plan_measurement(
    machine: Machine, order: Json, *, on_progress: Progress
) -> dict[str, Any]:
    """JSON of a plan's rows, with its `document` unless it is the default.

    The document is the content of `plan.json` and the grade of the set-up. Raises
    PlanningError.
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.answers.plan_report import plan_document
    from truepath.planning.plan import make_plan
    from truepath.results.grade_json import grade_set_up

    if "mode" not in order:
        feed_mm_min, *_ = order.get("feeds_mm_min") or [None]
        return encode_commanded_json(_default_path(machine, feed_mm_min))
    planned = make_plan(machine, read_plan_requirements(order), on_progress=on_progress)
    rows = max(len(plan.commanded) for plan in planned.at_stations)
    if rows > MAX_ROWS:
        raise PlanningError(
            f"the plan has {rows} rows; a controller takes {MAX_ROWS}; give less time"
        )
    for one in planned.at_stations:
        require_measurable(machine, one.commanded)
    grade = grade_set_up(
        machine,
        planned.commanded,
        tracker_mm=planned.station_mm.tolist(),
        perpendicular_only=planned.order.perpendicular_only,
    )
    return {
        **encode_commanded_json(planned.commanded),
        "predicted_um": planned.uncertainty_um,
        "document": plan_document(planned) | {"grade": grade},
        **_encode_stations(planned),
    }


def _encode_stations(planned: Plan) -> dict[str, Any]:
    workspace = planned.order.workspace
    if not planned.further or workspace.stations is None:
        return {}
    from truepath.planning.stations.station_selection import choose_known_points

    plans = planned.at_stations
    places_mm = [plan.station_mm for plan in plans]
    lines = [plan.commanded for plan in plans]
    points = choose_known_points(planned.machine, workspace, places_mm, lines)
    return {
        "stations": [
            {
                "position_mm": plan.station_mm.round(1).tolist(),
                "duration_s": round(plan.duration_s, 3),
                **encode_commanded_json(plan.commanded),
            }
            for plan in plans
        ],
        "known_points": encode_commanded_json(points),
        "specification": asdict(workspace.stations.find_specification(planned.machine)),
    }


@lru_cache(maxsize=4)
def _default_path(machine: Machine, feed_mm_min: float | None) -> Path:
    from truepath.planning.default_path import default_path

    return default_path(machine, feed_mm_min)


def read_plan_requirements(order: Json) -> PlanRequirements:
    """The request in JSON as a PlanOrder."""
    from truepath.estimation.problem.prior_model import read_prior_model
    from truepath.planning.plan_request import PlanRequirements

    given = {name: order[name] for name in _PLAIN if order.get(name) is not None}
    if order.get("feeds_mm_min"):
        given["feeds_mm_min"] = tuple(order["feeds_mm_min"])
    file, model_id = order.get("model_file"), order.get("model_id") or ""
    return PlanRequirements(
        **given,
        model=None if file is None else read_prior_model(file, model_id),
        workspace=workspace_from_json(order.get("workspace") or {}),
    )


def request_first_part(machine: Machine, order: Json) -> dict[str, Any]:
    """Request for the first part of an adaptive measurement.

    Enough lines or points to estimate pose and noise; rotary axes are at rest on lines.
    """
    highest = order.get("max_feed_mm_min") or machine.motion.max_feed_mm_min
    usual = min(DEFAULT_FEED_MM_MIN, machine.motion.max_feed_mm_min, highest)
    feed_mm_s = min(order.get("feeds_mm_min") or [usual]) / 60.0
    length_mm = math.dist(*zip(*((a.low, a.high) for a in machine.axes), strict=True))
    leg_s = length_mm / feed_mm_s + _STANDS_S
    count = _FIRST_LINES if order.get("mode") != "standstill" else _FIRST_POINTS
    minutes = count * leg_s / 60.0
    minutes = min(minutes, order.get("minutes") or minutes)
    return {**order, "minutes": minutes, "turns": False}


@dataclass(frozen=True, slots=True)
class CheckedRows:
    """Result of a check of rows.

    duration_s : from the first row on, dwells included
    stays_open : what an estimate of them alone leaves undetermined, empty if nothing
    """

    rows: int
    duration_s: float
    stays_open: str


def check_rows(
    machine: Machine,
    rows: Sequence[Row],
    feed_mm_min: float | None,
    workspace: Json,
    *,
    is_path: bool,
) -> CheckedRows:
    """Check rows as the order of a measurement does. Raises PlanningError."""
    commanded = command_measurable_rows(machine, rows, feed_mm_min, is_path=is_path)
    within = workspace_from_json(workspace)
    within.require_allowed(machine, commanded)
    row_s = row_times_s(commanded, feed_mm_min or DEFAULT_FEED_MM_MIN, machine.motion)
    stays_open = name_what_stays_open(machine, commanded, within)
    return CheckedRows(len(commanded), float(row_s.sum()), stays_open)


def list_station_rows(plan: Json) -> list[Commanded]:
    """Rows of each station of a plan, in order; empty for a single station."""
    return [decode_commanded_json(station) for station in plan.get("stations", ())]
