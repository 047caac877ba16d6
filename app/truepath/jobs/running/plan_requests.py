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

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

from truepath.answers.history.model_history import DISCOVERY, find_model_file
from truepath.catalogue.job import JobKind, Json
from truepath.errors import AlignmentError, BundleError, PlanningError, Unidentifiable
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, select_rows
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.paths.commanded_rows import MAX_ROWS, Row, command_rows
from truepath.motion.paths.feeds import check_feed
from truepath.motion.workspace.travel import check_travel
from truepath.motion.workspace.workspace import Workspace, moves_relative_to_tracker
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
_POINTS = JobKind.MEASURE_STANDSTILL


def plan_measurement(
    machine: Machine, order: Json, *, on_progress: Progress
) -> dict[str, Any]:
    """JSON of a plan's rows, with its `document` unless it is the default.

    The document is the content of `plan.json` and the grade of the set-up. Raises
    PlanningError.
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.answers.plan.plan_document import plan_document
    from truepath.planning.plan_builder import make_plan
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
    from truepath.planning.known_points import choose_known_points

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
    from truepath.planning.lines.default_path import default_path

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


def reject_several_targets(machine: Machine, order: Json) -> None:
    """Raise PlanningError for points of several targets that had to alternate."""
    moving = [t for t in machine.targets if moves_relative_to_tracker(machine, t)]
    if order.get("mode") == "standstill" and len(moving) > 1:
        raise PlanningError(
            f"{machine.name} has {len(moving)} targets that move; adaptive standstills "
            "are for one; plan them, then measure at standstill"
        )


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


def check_plan_to_drive(
    machine: Machine, kind: JobKind, plan: Json, count: int | None = None
) -> dict[str, Any]:
    """Rows of a plan, checked again for the job that executes them.

    count : only its first rows, those of several stations one after another

    Raises PlanningError if it is of the other mode, was made for another state of the
    machine file, or leaves the travel.
    """
    commanded = decode_commanded_json(plan)
    if isinstance(commanded, Path) != (kind is JobKind.MEASURE_OTF):
        wanted = JobKind.MEASURE_OTF if isinstance(commanded, Path) else _POINTS
        raise PlanningError(f"the plan is one for {wanted}, not for {kind}")
    now = json.loads(json.dumps(machine_to_json(machine)))  # as the catalogue keeps it
    if plan["document"]["machine"] != now:
        raise PlanningError(
            "the machine file has changed since this plan was made; plan again"
        )
    if count is not None:
        plan = _select_beginning(machine, plan, count)
        commanded = decode_commanded_json(plan)
    for rows in (commanded, *list_station_rows(plan)):
        check_travel(machine, rows)
    kept = {"predicted_um", *STATION_KEYS} & set(plan)
    document = plan["document"]
    place = {key: document.get(key) for key in ("tracker", "stations", "at_stations")}
    return {
        **encode_commanded_json(commanded),
        **{key: plan[key] for key in sorted(kept)},
        "tracker_mm": document.get("tracker", {}).get("position_mm"),
        **({"place": place} if place["stations"] else {}),
    }


def _select_beginning(machine: Machine, plan: Json, count: int) -> Json:
    document, left = dict(plan["document"]), count
    whole = plan.get("stations") or [plan]
    kept = list[dict[str, Any]]()
    for part in whole:
        rows = select_rows(decode_commanded_json(part), slice(max(left, 0)))
        if len(rows):
            require_measurable(machine, rows)
            kept.append({**part, **encode_commanded_json(rows)})
        left -= len(part["position"])
    if left > 0:
        raise PlanningError(
            f"the plan has {count - left} rows, not {count}; give fewer"
        )
    driven = [point for point in document["curve"] if point["row"] <= count]
    last = driven[-1] if driven else {}
    predicted_um = last.get("volumetric_uncertainty_um")
    plan = {**plan, **kept[0], "document": document, "predicted_um": predicted_um}
    if len(whole) == 1:
        return plan
    before_s = sum(part["duration_s"] for part in kept[:-1])
    took_s = round(last.get("time_s", before_s) - before_s, 3)
    kept[-1]["duration_s"] = took_s
    *shares, share = document["at_stations"][: len(kept)]
    now = {"duration_s": took_s, "rows": len(kept[-1]["position"])}
    share = {key: last.get(key, value) for key, value in share.items()} | now
    document["at_stations"] = [*shares, share]
    if len(kept) > 1:
        return {**plan, "stations": kept}
    return {key: plan[key] for key in plan.keys() - set(STATION_KEYS)}


def list_station_rows(plan: Json) -> list[Commanded]:
    """Rows of each station of a plan, in order; empty for a single station."""
    return [decode_commanded_json(station) for station in plan.get("stations", ())]


def plan_extra_lines(machine: Machine, folder: FilePath, job_id: str) -> dict[str, Any]:
    """Rows of the extra lines that a discovery proposes, with `discovery_id`.

    In the form of `encode_commanded_json`.

    folder, job_id : of the discovery

    Raises PlanningError if the discovery proposes none, if its Runs are of another
    machine, or if the lines leave the travel; NotFound if its model is gone.
    """
    ask = json.loads((folder / DISCOVERY).read_text(encoding="utf-8")).get("ask")
    if ask is None:
        raise PlanningError(
            f"discovery {job_id} asks for no extra lines: no names compete, and no "
            "evidence is thin"
        )
    model = find_model_file(folder.parent, job_id).read_text(encoding="utf-8")
    name = f"model {job_id}"
    try:
        measured = machine_from_json(json.loads(model)["machine"], file=name)
        one_machine([measured, machine], [name, "this service"])
    except BundleError as error:
        raise PlanningError(
            f"the extra lines are for another machine: {error}"
        ) from error
    path = command_rows(machine, ask["rows"], is_path=True)
    return {**encode_commanded_json(path), "discovery_id": job_id}
