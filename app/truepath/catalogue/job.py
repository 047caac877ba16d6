"""The Job record and the records it is made of. Frozen; the store replaces them."""

from __future__ import annotations

import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from truepath.catalogue.transitions import FINAL, VERB_TRANSITIONS, State, Verb
from truepath.files.earlier.verdict import State as VerdictState
from truepath.numerics.adaptive_trials import TrialPlan
from truepath_drivers import host_clock


class OnNotice(StrEnum):
    """What is done where the live estimate notices a change, besides telling it."""

    NOTE = "note"  # nothing
    PAUSE = "pause"  # hold the feed; a person decides
    CHECK = "check"  # measure again from the line before the change on
    REPLAN = "replan"  # measure again what was measured since the change


@dataclass(frozen=True, slots=True)
class LiveNotice:
    """A change during the measurement, noticed by the live estimate.

    number : 1, 2, … of the job; kind : of the change, `something-changed` without a
        name; axis : of which, if of one; grade : `certain`, `likely` or `possible`
    since_row : first line or point that it shows on; noticed_row : the newest one when
        it was noticed; noticed_s : then, since the stream began
    size_um, uncertainty_um : displacement of the measured points (k = 1)
    is_over : the newest lines no longer show it
    action : the reaction
    """

    number: int
    kind: str
    grade: str
    since_row: int
    noticed_row: int
    noticed_s: float
    size_um: float
    uncertainty_um: float
    axis: str = ""
    is_over: bool = False
    action: OnNotice = OnNotice.NOTE

    @property
    def heading(self) -> tuple[str, str, str, bool]:
        """Kind, axis, grade and end: a change of these is published again."""
        return self.kind, self.axis, self.grade, self.is_over


_NOTICE = TypeAdapter(LiveNotice)


def decode_notice(content: Mapping[str, Any]) -> LiveNotice:
    """From the JSON of the live estimate. Raises ValidationError."""
    return _NOTICE.validate_python(content)


Json = Mapping[str, Any]


class JobKind(StrEnum):
    """What a job does.

    `PLAN` chooses what a measuring job may drive. `MEASURE_EXTRA` drives the lines that
    a discovery asks for and ends with a discovery in all their Runs. `TREND` follows a
    machine over Runs. `REANALYSE` analyses many Runs again, each for itself. `VERIFY`
    drives points that a result was not made from, and holds it against them.
    """

    MEASURE_OTF = "measure-otf"
    MEASURE_STANDSTILL = "measure-standstill"
    MEASURE_ADAPTIVE = "measure-adaptive"
    MEASURE_EXTRA = "measure-extra"
    ANALYSE = "analyse"
    DISCOVER = "discover"
    TREND = "trend"
    REANALYSE = "reanalyse"
    VERIFY = "verify"
    PLAN = "plan"

    @property
    def measures(self) -> bool:
        """Whether the job moves the machine."""
        return self.value.startswith("measure-") or self is JobKind.VERIFY

    @property
    def answer(self) -> str:
        """What its jobs end with; empty for a plan. A result has error tables."""
        if self in (JobKind.DISCOVER, JobKind.MEASURE_EXTRA):
            return "discovery"
        others = {
            JobKind.TREND: "trend",
            JobKind.REANALYSE: "reanalysis",
            JobKind.VERIFY: "verification",
            JobKind.PLAN: "",
        }
        return others.get(self, "result")

    @property
    def analyses(self) -> bool:
        """Whether the job ends with error tables."""
        return self.answer == "result"

    @property
    def discovers(self) -> bool:
        """Whether the job ends with a discovery, in place of error tables."""
        return self.answer == "discovery"


class Stage(StrEnum):
    """Where in the pipeline a job works; progress, not a second state."""

    WAITING = "waiting"
    PLANNING = "planning"
    MEASURING = "measuring"
    ALIGNING = "aligning"
    ESTIMATING = "estimating"
    VALIDATING = "validating"
    DISCOVERING = "discovering"
    FOLLOWING = "following"
    REPORTING = "reporting"


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the stage. `eta_s` is None where unknown."""

    done: float = 0.0
    total: float = 0.0
    unit: str = ""
    eta_s: float | None = None
    elapsed_s: float = 0.0
    position: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Health:
    """State of the tracker's link during the measurement.

    gaps : places where samples are missing; repeats : times that lines were measured
        again, because their stream was damaged
    """

    samples: int = 0
    lost_samples: int = 0
    crc_errors: int = 0
    gaps: int = 0
    repeats: int = 0


@dataclass(frozen=True, slots=True)
class StationCheck:
    """Agreement of a station with the one before, by the known points.

    problem : `not-seen`, `not-moved` or `residual` where it does not agree, `moved`
        where the tracker was moved after the check; else empty
    text : that in words
    """

    station: int
    place_mm: tuple[float, ...] | None = None
    moved_mm: float | None = None
    residual_um: float | None = None
    allowed_um: float | None = None
    problem: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class StationProgress:
    """Station of the tracker, present or next, of several.

    number : of the station, from 1; position_mm : its place
    checks : of the stations so far, the newest of each
    """

    number: int
    total: int
    position_mm: tuple[float, ...]
    checks: tuple[StationCheck, ...] = ()

    def add_check(self, check: StationCheck) -> StationProgress:
        """Replaces an earlier check of the same station."""
        others = [one for one in self.checks if one.station != check.station]
        return replace(self, checks=(*others, check))


@dataclass(frozen=True, slots=True)
class EarlyEnd:
    """The target uncertainty was reached and the rest of the plan left out.

    reached_um : volumetric uncertainty (k = 1) at that moment
    done, total : finished lines or points behind it, and those of the plan
    """

    reached_um: float
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a job did not succeed.

    family : name of the error's class, from which the interface derives the problem
    code, action : as the machine named them; empty to use those of the family
    """

    family: str
    detail: str
    code: str = ""
    action: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """One job. `seq` orders jobs; wall-clock times are for people.

    seq, id, desired_state, created : given by the store
    run_id : the Run that it made, or the first that it analyses
    further_run_ids : those that are analysed together with it: of other stations, or
        named; of extra lines, those of the discovery that asks for them
    target_um : volumetric uncertainty (k = 1) at which the measurement may end early
    monte_carlo : the trials that an analysis tests its uncertainty against
    verdict : state of its result, discovery or trend, once that exists
    station : of a measurement from several stations of the tracker
    on_notice : reaction to a change that its live estimate notices
    notices : changes that it has noticed
    machine, machine_version : the machine that it moves, plans for or is about, and
        which configuration of it
    owner : name of the user who requested it; None where there is no login
    attempts : how often it was started, restarts of the service included
    name, note : label and remark of the users
    """

    kind: JobKind
    seq: int = 0
    id: str = ""
    state: State = State.QUEUED
    desired_state: str = ""
    version: int = 1
    stage: Stage = Stage.WAITING
    created: str = ""
    started: str | None = None
    ended: str | None = None
    run_id: str | None = None
    further_run_ids: tuple[str, ...] = ()
    perpendicular_only: bool = False
    monte_carlo: TrialPlan | None = None
    target_um: float | None = None
    early_end: EarlyEnd | None = None
    verdict: VerdictState | None = None
    station: StationProgress | None = None
    on_notice: OnNotice = OnNotice.NOTE
    notices: tuple[LiveNotice, ...] = ()
    progress: Progress = field(default_factory=Progress)
    health: Health = field(default_factory=Health)
    failure: Failure | None = None
    owner: str | None = None
    attempts: int = 0
    machine: str | None = None
    machine_version: int | None = None
    name: str = ""
    note: str = ""

    @property
    def run_ids(self) -> tuple[str, ...]:
        """All its Runs, in the order in which they were measured or named."""
        own = (self.run_id,) if self.run_id else ()
        if self.kind is JobKind.MEASURE_EXTRA:
            return (*self.further_run_ids, *own)
        return (*own, *self.further_run_ids)

    def add_run(self, run_id: str) -> Job:
        """The job with a Run that it has made: its first one, or a further.

        Of extra lines the newest is `run_id`, after all others.
        """
        if self.run_id in (None, run_id):
            return replace(self, run_id=run_id)
        newest = self.kind is JobKind.MEASURE_EXTRA
        first, added = (run_id, self.run_id) if newest else (self.run_id, run_id)
        further = tuple(dict.fromkeys((*self.further_run_ids, added)))
        return replace(self, run_id=first, further_run_ids=further)

    @property
    def wants_pause(self) -> bool:
        """Whether a pause is the last request of a user."""
        return self.desired_state == State.PAUSED

    @property
    def is_final(self) -> bool:
        """Whether the job has ended."""
        return self.state in FINAL

    @property
    def allowed_verbs(self) -> tuple[Verb, ...]:
        """Permitted in this state, without those already in effect."""
        verbs = {v for v, states in VERB_TRANSITIONS.items() if self.state in states}
        if not self.kind.measures:  # nothing to hold, or to let move
            verbs &= {Verb.CANCEL, Verb.ABORT}
        if self.state is State.RUNNING and self.stage is not Stage.MEASURING:
            verbs.discard(Verb.PAUSE)  # nothing moves any more
        return tuple(verb for verb in Verb if verb in verbs)

    @property
    def answer(self) -> str:
        """What it has ended with, as its kind names it; else empty."""
        return self.kind.answer if self.state is State.SUCCEEDED else ""


@dataclass(frozen=True, slots=True)
class JobEvent:
    """One event of a job.

    type : `job` is stored in the catalogue and has its `id`, so that a client can catch
        up; `progress`, `live`, `estimate`, `plan`, `notice` not
    """

    type: str
    job_id: str | None
    body: Json
    id: int | None = None


_JOB = TypeAdapter(Job)


def encode_job(job: Job) -> dict[str, Any]:
    """The record as rows and events store it."""
    return _JOB.dump_python(job, mode="json")


def decode_job(content: Json) -> Job:
    """Inverse of `encode_job`; absent or null keys have their defaults."""
    return _JOB.validate_python({k: v for k, v in content.items() if v is not None})


def make_id() -> str:
    """An identifier that sorts by time: a UUID of version 7."""
    stamp = (host_clock.wall_ns() // 1_000_000) << 80
    noise = int.from_bytes(os.urandom(10)) & ~(0xF << 76) & ~(0x3 << 62)
    return str(uuid.UUID(int=stamp | 0x7 << 76 | 0x2 << 62 | noise))


def format_utc_now() -> str:
    """ISO 8601 with `Z`, to the millisecond."""
    return format_utc(datetime.now(UTC))


def format_utc(at: datetime) -> str:
    """ISO 8601 with `Z`, to the millisecond; needs a time with a zone."""
    text = at.astimezone(UTC).isoformat(timespec="milliseconds")
    return text.replace("+00:00", "Z")


def format_file_time(file: Path) -> str:
    """When a file was last written, as `format_utc`."""
    return format_utc(datetime.fromtimestamp(file.stat().st_mtime, UTC))
