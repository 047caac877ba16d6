"""Summary of the motion of a job before it is armed, and its arm token."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Literal

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from truepath.catalogue.job import format_utc
from truepath.jobs.running.arming import Arming
from truepath.machines.conditions import ConditionType
from truepath.service.api.models.base import JOB_ID, JobId, RequestBody
from truepath.service.api.problems import declare_problems
from truepath.service.api.routes.machine import ConditionOut
from truepath.service.api.security.session import ActorDep, owner_of
from truepath.service.api.service import ServiceDep

router = APIRouter(prefix="/jobs", tags=["jobs"])


_TOKEN = "Zq3c9xF0mB7sJt2kWvR8yLdPnHe5aUgo"  # noqa: S105 (an example)


class ArmingTarget(BaseModel):
    """A reflector that is measured."""

    name: str = Field(examples=[""], description="Empty for the only one.")
    on: Literal["tool", "workpiece"]
    offset_mm: list[float] = Field(
        examples=[[0.0, 0.0, -120.0]], description="Of the reflector from there."
    )


class AxisRangeOut(BaseModel):
    """How far an axis goes."""

    axis: str = Field(examples=["X"])
    unit: Literal["mm", "deg"]
    low: float = Field(examples=[20.0])
    high: float = Field(examples=[480.0])


class ArmingOut(BaseModel):
    """What the machine will do, and the token to let it: good once, for this only."""

    job: str = Field(examples=[JOB_ID])
    version: int = Field(
        examples=[3], description="Of the job; send it as If-Match when arming."
    )
    machine: str = Field(examples=["default"])
    machine_name: str = Field(examples=["demo mill"])
    machine_version: int = Field(examples=[1])
    targets: list[ArmingTarget]
    envelope: list[AxisRangeOut] = Field(
        description="Swept box of all axes: of the rows, and of the straight way from "
        "where the machine stands to the first of them. Axes that are not named stay "
        "where they are."
    )
    max_feed_mm_min: float = Field(
        examples=[6000.0], description="The largest of the plan."
    )
    duration_s: float = Field(description="As planned, dwells included.")
    rows: int = Field(examples=[23])
    grows: bool = Field(
        description="Further rows are chosen on the way; the envelope is then the "
        "travel of all axes, rows and duration are those known so far."
    )
    conditions: list[ConditionOut]
    obstacles: list[ConditionType] = Field(
        description="Conditions that stand in the way; arming is refused while one does"
    )
    plan_sha256: str = Field(description="Of the rows that the token is for.")
    token: str = Field(examples=[_TOKEN], description="To POST with the arming.")
    expires: str = Field(
        examples=["2026-05-04T09:31:00.000Z"], description="When it can no longer arm."
    )
    expires_in_s: float = Field(examples=[60.0])


class ArmRequest(RequestBody):
    """The token that `arming` has answered with."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"token": _TOKEN}]}
    )

    token: str = Field(min_length=1, max_length=200, examples=[_TOKEN])


@router.post("/{job_id}/arming", responses=declare_problems(404, 409))
def prepare_arming(job_id: JobId, service: ServiceDep, actor: ActorDep) -> ArmingOut:
    """Return what an armed job will move, and the token to arm it. Moves nothing.

    The token is good once, for a short time, for this user and exactly these rows.
    """
    return _describe(service.dispatcher.prepare_arming(job_id, by=owner_of(actor)))


def _describe(arming: Arming) -> ArmingOut:
    driven, motion = arming.machine, arming.motion
    expires = datetime.now(UTC) + timedelta(seconds=arming.valid_s)
    return ArmingOut(
        job=arming.job.id,
        version=arming.job.version,
        machine=driven.id,
        machine_name=driven.machine.name,
        machine_version=driven.version,
        targets=[ArmingTarget.model_validate(asdict(one)) for one in motion.targets],
        envelope=[AxisRangeOut.model_validate(asdict(one)) for one in motion.envelope],
        max_feed_mm_min=motion.max_feed_mm_min,
        duration_s=round(motion.duration_s, 3),
        rows=motion.rows,
        grows=motion.grows,
        conditions=[ConditionOut(**asdict(one)) for one in arming.conditions],
        obstacles=[one.type for one in arming.conditions if one.is_obstacle],
        plan_sha256=arming.plan_sha256,
        token=arming.token,
        expires=format_utc(expires),
        expires_in_s=arming.valid_s,
    )
