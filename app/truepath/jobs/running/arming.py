"""What a job will command once it is armed: the rows, their hash, a summary."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from truepath.catalogue.job import Job, JobKind
from truepath.errors import NotFound, OutOfTravel, PlanningError
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.jobs.running.resumption import Resumption
from truepath.jobs.running.station_resumption import select_left
from truepath.kinematics.machine.machine import Machine, Target, position_unit
from truepath.machines.conditions.conditions import Condition, Finding, Level
from truepath.machines.machine_cells import MachineCell
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.workspace.travel import check_travel
from truepath.motion.workspace.workspace import REPLAN, Workspace
from truepath_drivers.interfaces.records import Path


@dataclass(frozen=True, slots=True)
class AxisRange:
    """How far an axis goes, in mm or deg."""

    axis: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class MotionSummary:
    """What the machine will do, in short.

    targets : reflectors that are measured; envelope : swept box of all axes
    max_feed_mm_min : the largest of the plan; duration_s : dwells included
    grows : further rows are chosen on the way, anywhere in the travel: the envelope is
        the travel then, and rows and duration are those that are known
    """

    targets: tuple[Target, ...]
    envelope: tuple[AxisRange, ...]
    max_feed_mm_min: float
    duration_s: float
    rows: int
    grows: bool


@dataclass(frozen=True, slots=True)
class Arming:
    """What is shown to a person before the machine moves, and the token for it.

    valid_s : how long the token can be used
    """

    job: Job
    machine: MachineCell
    motion: MotionSummary
    conditions: tuple[Condition, ...]
    plan_sha256: str
    token: str
    valid_s: float


def judge_path(
    machine: Machine, parts: Sequence[Commanded], workspace: Workspace
) -> Finding:
    """Tell whether all parts stay in the travel and out of what is kept clear.

    So do the ways from one to the next. What the tracker sees was judged in planning.
    """
    clear = workspace.without_sight
    try:
        for part in parts:
            check_travel(machine, part)
            clear.refuse(machine, part)
        for number, (before, after) in enumerate(pairwise(parts), start=2):
            begin, end = before.position[-1], after.position[0]
            clear.refuse_way(
                machine, begin, end, f"the way on to part {number}", REPLAN
            )
    except OutOfTravel as error:
        return Finding(Level.FALSE, "out-of-travel", str(error))
    except PlanningError as error:
        return Finding(Level.FALSE, "keep-out", str(error))
    return Finding(Level.TRUE)


def judge_approach(
    machine: Machine,
    parts: Sequence[Commanded],
    workspace: Workspace,
    here: Mapping[str, float],
) -> Finding:
    """Tell whether the way to the first row is clear from where the machine stands.

    here : position by axis, mm or deg, as the controller shows it; empty if unknown
    """
    first = parts[0]
    if not workspace.keep_out:
        return Finding(Level.TRUE)
    if not set(first.axes) <= set(here):
        text = (
            "the controller has not told where the machine stands, so the way to the "
            "first row is not known to be clear; wait a moment, or connect again"
        )
        return Finding(Level.FALSE, "place-not-told", text)
    begin, way = (
        np.array([here[name] for name in first.axes]),
        "the way to the first row",
    )
    try:
        workspace.without_sight.refuse_way(
            machine,
            begin,
            first.position[0],
            way,
            "jog the machine to where it is clear",
        )
    except PlanningError as error:
        return Finding(Level.FALSE, "approach-blocked", str(error))
    return Finding(Level.TRUE)


def list_commanded(plan: Mapping[str, Any] | None) -> list[Commanded]:
    """Return all that a plan still has to command, in order. Raises NotFound.

    Of several stations those that are not measured, each after the known points; of a
    measurement that goes on the closure check and the rows that are left.
    """
    if plan is None:
        raise NotFound("the job has no plan yet")
    if "stations" in plan:
        points = decode_commanded_json(plan["known_points"])
        left = [one for one in plan["stations"] if not one.get("measured")]
        return [rows for one in left for rows in (points, select_left(one))]
    commanded, resumption = decode_commanded_json(plan), Resumption.read(plan)
    if resumption is None:
        return [commanded]
    return [resumption.select_closure(commanded), resumption.select_rest(commanded)]


def hash_commanded(parts: Sequence[Commanded]) -> str:
    """Return the SHA-256 of what is commanded: equal only for the same motion."""
    content = [encode_commanded_json(part) for part in parts]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def summarise_motion(
    machine: Machine,
    kind: JobKind,
    parts: Sequence[Commanded],
    here: Mapping[str, float] | None = None,
) -> MotionSummary:
    """Return what parts command, and where the machine goes in doing so.

    here : as `judge_approach` takes it; the way from there is in the envelope
    """
    grows = kind is JobKind.MEASURE_ADAPTIVE
    named = {name for part in parts for name in part.target}
    return MotionSummary(
        targets=tuple(t for t in machine.targets if not named or t.name in named),
        envelope=_list_travel(machine)
        if grows
        else _list_ranges(machine, parts, here or {}),
        max_feed_mm_min=max(_find_highest_feed(part) for part in parts),
        duration_s=sum(
            float(row_times_s(part, limits=machine.motion).sum()) for part in parts
        ),
        rows=sum(len(part) for part in parts),
        grows=grows,
    )


def _find_highest_feed(part: Commanded) -> float:
    if isinstance(part, Path):
        return float(part.feed_mm_min.max())
    return DEFAULT_FEED_MM_MIN


def _list_travel(machine: Machine) -> tuple[AxisRange, ...]:
    return tuple(
        AxisRange(axis.name, position_unit(axis), axis.low, axis.high)
        for axis in machine.axes
    )


def _list_ranges(
    machine: Machine, parts: Sequence[Commanded], here: Mapping[str, float]
) -> tuple[AxisRange, ...]:
    """Return the box of all rows and of here; lines between them never leave it."""
    position = np.concatenate([part.position for part in parts])
    axes, low, high = parts[0].axes, position.min(axis=0), position.max(axis=0)
    return tuple(
        AxisRange(
            name,
            position_unit(machine.axis(name)),
            float(min(least, here.get(name, least))),
            float(max(most, here.get(name, most))),
        )
        for name, least, most in zip(axes, low, high, strict=True)
    )
