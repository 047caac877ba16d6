"""What will move, looked at before it does."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime, timedelta

from fastapi import APIRouter

from truepath.app.api.models.arming import ArmingOut, ArmingTarget, AxisRangeOut
from truepath.app.api.models.base import JobId
from truepath.app.api.models.condition import ConditionOut
from truepath.app.api.problems import declare_problems
from truepath.app.api.service import ServiceDep
from truepath.app.api.session import ActorDep, owner_of
from truepath.app.jobs.arming import Arming
from truepath.app.jobs.job import format_utc

router = APIRouter(prefix="/jobs", tags=["jobs"])


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
