"""What arming permits: checks, hash and summary of the rows, and single-use tokens.

A token is bound to job, version, user, machine and rows. Only its hash is kept, in
memory: a restart of the service disarms.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from truepath.catalogue.errors import ArmTokenExpired, ArmTokenOther, ArmTokenUsed
from truepath.catalogue.job import Job, JobKind
from truepath.errors import NotFound, OutOfTravel, PlanningError
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.jobs.running.resumption import Resumption, select_remaining
from truepath.kinematics.machine.machine import Machine, Target, position_unit
from truepath.machines.conditions import Condition, Finding, Level
from truepath.machines.machine_cells import MachineCell
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.motion.workspace import REPLAN, Workspace, check_travel
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path


@dataclass(frozen=True, slots=True)
class AxisRange:
    """Extent of an axis, mm or deg."""

    axis: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class MotionSummary:
    """Summary of the motion to be armed.

    targets : reflectors that are measured; envelope : swept box of all axes
    max_feed_mm_min : the largest of the plan; duration_s : dwells included
    grows : further rows are chosen during the measurement, anywhere in the travel: the
        envelope is then the travel, and rows and duration are those known so far
    """

    targets: tuple[Target, ...]
    envelope: tuple[AxisRange, ...]
    max_feed_mm_min: float
    duration_s: float
    rows: int
    grows: bool


@dataclass(frozen=True, slots=True)
class Arming:
    """Summary shown to a user before the machine moves, and the token for it.

    valid_s : lifetime of the token
    """

    job: Job
    machine: MachineCell
    motion: MotionSummary
    conditions: tuple[Condition, ...]
    plan_sha256: str
    token: str
    valid_s: float


def assess_path(
    machine: Machine, parts: Sequence[Commanded], workspace: Workspace
) -> Finding:
    """Whether all parts stay in the travel and out of keep-out boxes.

    The motions from one part to the next are included. Visibility from the tracker was
    checked in planning.
    """
    clear = workspace.without_sight
    try:
        for part in parts:
            check_travel(machine, part)
            clear.require_allowed(machine, part)
        for number, (before, after) in enumerate(pairwise(parts), start=2):
            begin, end = before.position[-1], after.position[0]
            clear.reject_way(
                machine, begin, end, f"the way on to part {number}", REPLAN
            )
    except OutOfTravel as error:
        return Finding(Level.FALSE, "out-of-travel", str(error))
    except PlanningError as error:
        return Finding(Level.FALSE, "keep-out", str(error))
    return Finding(Level.TRUE)


def assess_approach(
    machine: Machine,
    parts: Sequence[Commanded],
    workspace: Workspace,
    here: Mapping[str, float],
) -> Finding:
    """Whether the motion from the present position to the first row is clear.

    here : position by axis, mm or deg, from the controller; empty if unknown
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
        workspace.without_sight.reject_way(
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
    """Remaining rows of a plan, in order. Raises NotFound.

    Of several stations the unmeasured ones, each after the known points; of a resumed
    measurement the closure check and the remaining rows.
    """
    if plan is None:
        raise NotFound("the job has no plan yet")
    if "stations" in plan:
        points = decode_commanded_json(plan["known_points"])
        left = [one for one in plan["stations"] if not one.get("measured")]
        return [rows for one in left for rows in (points, select_remaining(one))]
    commanded, resumption = decode_commanded_json(plan), Resumption.read(plan)
    if resumption is None:
        return [commanded]
    return [resumption.select_closure(commanded), resumption.select_rest(commanded)]


def hash_commanded(parts: Sequence[Commanded]) -> str:
    """SHA-256 of the rows: equal only for the same motion."""
    content = [encode_commanded_json(part) for part in parts]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def summarise_motion(
    machine: Machine,
    kind: JobKind,
    parts: Sequence[Commanded],
    here: Mapping[str, float] | None = None,
) -> MotionSummary:
    """Extent, feeds and duration of the parts.

    here : as in `assess_approach`; the motion from there is in the envelope
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
    """The motion between two rows never leaves their box."""
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


VALID_S = 60.0
MAX_TOKENS = 1024  # of all jobs; the oldest are dropped
_BYTES = 24


@dataclass(frozen=True, slots=True)
class ArmingPurpose:
    """Binding of an arm token.

    version : of the job; machine_version : of the machine's configuration
    user : name of the requesting user; None without login
    plan_sha256 : of the rows that are commanded
    """

    job_id: str
    version: int
    user: str | None
    machine_id: str
    machine_version: int
    plan_sha256: str


@dataclass(slots=True)
class _Issued:
    sha256: bytes
    purpose: ArmingPurpose
    expires_s: float
    is_used: bool = False


class ArmTokens:
    """Issued tokens; thread-safe.

    valid_s : lifetime of a token
    """

    def __init__(self, valid_s: float = VALID_S) -> None:
        self.valid_s = valid_s
        self._lock = threading.Lock()
        self._issued: list[_Issued] = []

    def issue(self, purpose: ArmingPurpose) -> str:
        """URL-safe random text, shown once: only its hash is stored."""
        token = secrets.token_urlsafe(_BYTES)
        issued = _Issued(_hash(token), purpose, host_clock.now_s() + self.valid_s)
        with self._lock:
            self._issued = [*self._issued[1 - MAX_TOKENS :], issued]
        return token

    def use(self, token: str, purpose: ArmingPurpose) -> None:
        """Invalidate a token after a match.

        Raises ArmTokenOther, ArmTokenUsed, ArmTokenExpired; the token is then kept.
        """
        with self._lock:
            issued = self._find(token)
            if issued is None:
                raise ArmTokenOther("the service knows no such token")
            if different := _name_difference(issued.purpose, purpose):
                raise ArmTokenOther(f"the token was given for another {different}")
            if issued.is_used:
                raise ArmTokenUsed("the token has let the machine move already")
            if host_clock.now_s() >= issued.expires_s:
                raise ArmTokenExpired(
                    f"the token was good for {self.valid_s:g} s, which have passed"
                )
            issued.is_used = True

    def _find(self, token: str) -> _Issued | None:
        """Compares with every record, in constant time."""
        wanted = _hash(token)
        found = None
        for issued in self._issued:
            if hmac.compare_digest(issued.sha256, wanted):
                found = issued
        return found


def _hash(token: str) -> bytes:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest()


def _name_difference(given: ArmingPurpose, wanted: ArmingPurpose) -> str:
    pairs = (
        ("user", given.user == wanted.user),
        ("machine", given.machine_id == wanted.machine_id),
        ("job", given.job_id == wanted.job_id),
        (
            "configuration of the machine",
            given.machine_version == wanted.machine_version,
        ),
        ("plan", given.plan_sha256 == wanted.plan_sha256),
        ("state of the job", given.version == wanted.version),
    )
    return next((name for name, is_same in pairs if not is_same), "")
