"""Request of a new job."""

from __future__ import annotations

import secrets
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from truepath.catalogue.job import JobKind, OnNotice
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.motion.paths.commanded_rows import MAX_ROWS
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.service.api.models.base import (
    JOB_ID,
    OTHER_ID,
    CompensationName,
    Degrees,
    Feed,
    Hours,
    HoursAhead,
    Identifier,
    MachineId,
    RequestBody,
    TargetUm,
    Time,
    examples,
)
from truepath.service.api.models.plan import KeepOut, PlanRequest, Point, Waypoint

MAX_RUNS, MAX_REANALYSED = 50, 10_000
ADAPTIVE_MINUTES = 10.0
_DRIVEN = {"machine", "control_compensation"}
_MEASURED = {
    *_DRIVEN,
    "plan_id",
    "plan_rows",
    "target_um",
    "model_id",
    "continues",
    "on_notice",
}
_OF_TREND = {"at_h", "limit_um", "horizon_h", "later_h", "temperature_degC"}
_USUAL_POINTS = ("diagonals", "random-points")
_OF_VERIFICATION = {"result_id", "what", "seed", "tolerance_um", "compensation_id"}
_KEEP_OUT = {"keep_out", "keep_out_replaces"}
_OF_VERIFICATION |= _KEEP_OUT
_ALLOWED = {
    "measure-otf": {"path", "feed_mm_min", *_MEASURED},
    "measure-standstill": {"points", *_MEASURED},
    "measure-adaptive": {*_DRIVEN, "planning", "target_um", "model_id", "on_notice"},
    "measure-extra": {*_DRIVEN, "discovery_id", *_KEEP_OUT},
    "analyse": {"run_id", "run_ids", "monte_carlo", "model_id"},
    "discover": {"run_id", "run_ids", "model_id"},
    "trend": {"run_ids", *_OF_TREND},
    "reanalyse": {"run_ids", "machine", "since"},
    "verify": {*_DRIVEN, *_OF_VERIFICATION},
}


class MonteCarlo(RequestBody):
    """Trials of JCGM 101 (GUM Supplement 1): the same seed gives the same answer."""

    seed: int = Field(1, ge=0, le=2**53 - 1)
    interval: Literal["symmetric", "shortest"] = Field(
        "symmetric", description="Form of the 95 % coverage intervals."
    )


class JobRequest(RequestBody):
    """What is to be done."""

    model_config = examples(
        {"kind": "measure-otf"},
        {"kind": "measure-otf", "plan_id": OTHER_ID},
        {"kind": "measure-adaptive", "target_um": 1.5},
        {"kind": "analyse", "run_id": JOB_ID, "perpendicular_only": False},
        {"kind": "analyse", "run_id": JOB_ID, "monte_carlo": {"seed": 1}},
        {"kind": "analyse", "run_ids": [JOB_ID, OTHER_ID]},
        {"kind": "analyse", "run_id": JOB_ID, "model_id": OTHER_ID},
        {"kind": "discover", "run_id": JOB_ID},
        {
            "kind": "trend",
            "run_ids": [JOB_ID, OTHER_ID],
            "at_h": [8, 9.5],
            "limit_um": 5,
        },
        {"kind": "measure-extra", "discovery_id": JOB_ID},
        {"kind": "reanalyse", "run_ids": [JOB_ID, OTHER_ID]},
        {
            "kind": "reanalyse",
            "machine": "mill-3",
            "since": "2026-01-31T08:00:00Z",
        },
        {
            "kind": "verify",
            "result_id": JOB_ID,
            "what": ["diagonals", "random-points"],
            "tolerance_um": 5,
        },
        {
            "kind": "measure-otf",
            "feed_mm_min": 2500,
            "path": [
                {"x_mm": 0, "y_mm": 0, "z_mm": 0, "dwell_s": 1},
                {"x_mm": 400, "y_mm": 300, "z_mm": 200, "dwell_s": 1},
                {"x_mm": 100, "y_mm": 350, "z_mm": 50, "dwell_s": 1},
            ],
        },
    )

    kind: Literal[
        "measure-otf",
        "measure-standstill",
        "measure-adaptive",
        "measure-extra",
        "analyse",
        "discover",
        "trend",
        "reanalyse",
        "verify",
    ]
    machine: MachineId | None = Field(
        None,
        description="The machine to measure, or whose Runs to analyse again. May be "
        "left out where the service drives only one, or where a plan, a job or a "
        "discovery is named.",
    )
    run_id: Identifier | None = Field(
        None, description="The Run to analyse, or to discover in."
    )
    run_ids: list[Identifier] | None = Field(
        None,
        min_length=1,
        max_length=MAX_REANALYSED,
        description="Runs of one machine, of either mode, to analyse together; in "
        "place of run_id: 50 at most. Of a trend two or more, in the order of time. Of "
        "a reanalysis up to 10 000 of any machine, each analysed for itself.",
    )
    since: Time | None = Field(
        None,
        description="Of a reanalysis, in place of run_ids: Runs created not before; "
        "with `machine` those of one.",
    )
    at_h: list[Hours] | None = Field(
        None,
        max_length=MAX_RUNS,
        description="Of a trend: the middle of each Run, in hours from any begin. "
        "Without it by the clocks, if they tell.",
    )
    limit_um: TargetUm | None = Field(
        None,
        description="Of a trend: what the machine may be off the tables of its last "
        "Run by, root mean square over the travel.",
    )
    horizon_h: HoursAhead | None = Field(
        None, description="Of a trend: hours to look ahead after the last Run; 24."
    )
    later_h: list[HoursAhead] | None = Field(
        None,
        max_length=MAX_RUNS,
        description="Of a trend: hours after the last Run at which tables are asked.",
    )
    temperature_degC: dict[str, Degrees] | None = Field(  # noqa: N815
        None,
        max_length=MAX_RUNS,
        description="Of a trend: temperatures that stay from the last Run on, of "
        "sensors that every Run has.",
    )
    path: list[Waypoint] | None = Field(
        None,
        min_length=2,
        max_length=MAX_ROWS,
        description="On the fly: lines in order; without it the default path.",
    )
    points: list[Point] | None = Field(
        None,
        min_length=1,
        max_length=MAX_ROWS,
        description="Standstill: points in order; without it the default points.",
    )
    model_id: Identifier | None = Field(
        None,
        description="Job whose model, or result, tells what is known of the machine: a "
        "discovery holds its Runs against it, without it against the rigid-body model "
        "fitted to them; an analysis, and a measurement, has its effects beside the "
        "error motions.",
    )
    discovery_id: Identifier | None = Field(
        None,
        description="Job whose discovery asks for extra lines: they are driven, then "
        "discovery goes on in its Runs and the new one.",
    )
    result_id: Identifier | None = Field(
        None, description="Of a verification: the job whose result is to be proved."
    )
    what: list[VerificationKind] | None = Field(
        None,
        min_length=1,
        max_length=len(VerificationKind),
        description="Of a verification: the points to drive. Diagonals and random "
        "points without it; each kind once. Circles in motion are a path, and asked "
        "for by themselves.",
    )
    seed: int | None = Field(
        None,
        ge=0,
        le=2**53 - 1,
        description="Of a verification: from which points are drawn; another each "
        "time without it. It stands in the answer.",
    )
    tolerance_um: TargetUm | None = Field(
        None,
        description="Of a verification: the largest volumetric error that a place may "
        "have, decided by ISO 14253-1.",
    )
    compensation_id: CompensationName | None = Field(
        None,
        description="Of a verification: the kept files that the controller applies.",
        examples=["heidenhain-0.1-hold"],
    )
    keep_out: KeepOut | None = Field(
        None,
        description="Of extra lines and of a verification: boxes of axis positions X, "
        "Y, Z that no motion may touch, beside those that the measurements behind the "
        "discovery or the result had to keep clear of.",
    )
    keep_out_replaces: bool | None = Field(
        None,
        description="Whether the boxes of `keep_out` hold in place of those of the "
        "measurements behind, which are gone by now; with [] there is none.",
    )
    control_compensation: Literal["on", "off"] | None = Field(
        None,
        description="Whether the control has to correct its axes by error tables of "
        "its own: `off` for tables that are to replace them (as found, without), `on` "
        "for what the machine does with them (as left). Arming is refused while the "
        "control says otherwise. Without it `on` for a verification that names a "
        "`compensation_id`; else either will do.",
    )
    plan_id: Identifier | None = Field(
        None,
        description="A plan whose rows are driven, in place of rows sent in; one of "
        "several stations asks for the tracker to be moved between them.",
    )
    plan_rows: int | None = Field(
        None,
        ge=1,
        le=10 * MAX_ROWS,
        description="A beginning of the plan alone: so many rows, as the points of its "
        "curve count them. Without it all.",
    )
    continues: Identifier | None = Field(
        None,
        description="Job that has ended before all its stations were measured: the "
        "rest is measured, and all analysed together.",
    )
    planning: PlanRequest | None = Field(
        None,
        description="Of an adaptive measurement: within what its parts are planned; "
        "`minutes` are those of the whole. Without it lines, for 10 minutes at most.",
    )
    feed_mm_min: Feed | None = Field(
        None, description="Feed of the default path, and of rows that state none."
    )
    perpendicular_only: bool = Field(
        False, description="Leave out what is seen along each line."
    )
    on_notice: OnNotice | None = Field(
        None,
        description="What is done where the live estimate notices a change: `note` "
        "it and go on, `pause` until somebody decides, `check` by measuring again from "
        "the line before it on, `replan` by measuring again what came since. Of an "
        "adaptive measurement the first two: it plans lost lines anew by itself.",
    )
    monte_carlo: MonteCarlo | None = Field(
        None,
        description="Hold the uncertainty against Monte Carlo trials; {} for defaults.",
    )
    target_um: TargetUm | None = Field(
        None,
        description="End early, in order, at this `volumetric_uncertainty_um`, a "
        "standard uncertainty (k = 1); the expanded one (k = 2) is twice it.",
    )

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        allowed = _ALLOWED[self.kind]
        for name in sorted(set[str]().union(*_ALLOWED.values())):
            if getattr(self, name) is not None and name not in allowed:
                raise ValueError(f"{name} is not for a job of kind {self.kind}")
        runs = [self.run_id, *(self.run_ids or ())]
        if self.kind in ("analyse", "discover") and runs == [None]:
            raise ValueError(f"a job of kind {self.kind} needs a run_id, or run_ids")
        if self.kind == "trend" and len(self.run_ids or ()) < 2:
            raise ValueError("a job of kind trend needs run_ids, two or more")
        if self.kind == "reanalyse":
            self._require_runs_to_reanalyse()
        elif len(self.run_ids or ()) > MAX_RUNS:
            raise ValueError(f"run_ids names more than {MAX_RUNS} Runs")
        if self.kind == "measure-extra" and self.discovery_id is None:
            raise ValueError("a job of kind measure-extra needs a discovery_id")
        if self.kind == "verify" and self.result_id is None:
            raise ValueError("a job of kind verify needs a result_id")
        if self.keep_out_replaces and self.keep_out is None:
            raise ValueError(
                "keep_out_replaces needs the boxes that hold now as keep_out; [] for "
                "none"
            )
        if len(set(self.what or ())) < len(self.what or ()):
            raise ValueError("what names a kind of points twice; give each once")
        again = self.on_notice in (OnNotice.CHECK, OnNotice.REPLAN)
        if again and self.kind == "measure-adaptive":
            raise ValueError("an adaptive measurement plans lost lines anew by itself")
        if self.run_id is not None and self.run_ids is not None:
            raise ValueError("run_id stands beside run_ids; give one of the two")
        planning = self.planning
        if planning and (planning.corner_path or planning.target_um is not None):
            raise ValueError("planning has no target and no corner path; see target_um")
        if planning and planning.stations is not None:
            raise ValueError("an adaptive measurement has one station")
        if planning and (planning.model_id or planning.machine):
            raise ValueError(
                "planning has no model_id and no machine; they stand beside planning"
            )
        beside = [self.path, self.points, self.feed_mm_min]
        if self.continues is not None and any(
            x is not None
            for x in (*beside, self.plan_id, self.target_um, self.on_notice)
        ):
            raise ValueError("continues stands beside a plan; the job has its own")
        if self.plan_id is not None and any(x is not None for x in beside):
            raise ValueError("plan_id stands beside rows or a feed; the plan has them")
        if self.plan_rows is not None and self.plan_id is None:
            raise ValueError("plan_rows needs a plan_id")
        if len(set(runs)) < len(runs):
            raise ValueError("run_ids names a Run twice; give each once")
        return self

    def _require_runs_to_reanalyse(self) -> None:
        chosen = self.machine is not None or self.since is not None
        if chosen == (self.run_ids is not None):
            raise ValueError(
                "a job of kind reanalyse needs run_ids, or in their place a machine, "
                "since when, or both"
            )

    def to_requested_job(self) -> RequestedJob:
        """The request in the form of the dispatcher."""
        rows, trials = self.path or self.points, self.monte_carlo
        order: dict[str, Any] | None = None
        if self.kind == "measure-adaptive":  # what is asked of its parts
            asked = self.planning.order() if self.planning else {"mode": "otf"}
            order = {"minutes": ADAPTIVE_MINUTES, **asked}
            order["perpendicular_only"] = self.perpendicular_only
        if self.kind == "measure-extra":
            order = self.model_dump(include=_KEEP_OUT)
        if self.kind == "trend":
            order = self.model_dump(include=_OF_TREND)
        if self.kind == "reanalyse":
            order = {"since": self.since}
        if self.kind == "verify":
            order = self.model_dump(include=_OF_VERIFICATION, mode="json")
            order["what"] = order["what"] or list(_USUAL_POINTS)
            if self.seed is None:
                order["seed"] = secrets.randbelow(2**31)
        same = ("feed_mm_min", "perpendicular_only", "target_um")
        same += ("plan_id", "model_id", "discovery_id", "continues", "machine")
        same += ("control_compensation", "plan_rows")
        return RequestedJob(
            kind=JobKind(self.kind),
            run_ids=self.run_ids or [i for i in (self.run_id,) if i],
            rows=[r.model_dump(exclude_none=True) for r in rows] if rows else None,
            monte_carlo=TrialPlan(**trials.model_dump()) if trials else None,
            plan_request=order,
            on_notice=self.on_notice or OnNotice.NOTE,
            **{name: getattr(self, name) for name in same},
        )
