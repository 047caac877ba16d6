"""Who may let a job move the machine, when, and with what token."""

from __future__ import annotations

from collections.abc import Sequence

from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.arm_tokens import ArmingPurpose, ArmTokens
from truepath.app.jobs.arming import (
    Arming,
    hash_commanded,
    list_commanded,
    summarise_motion,
)
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.errors import NotInControl, NotInOrder
from truepath.app.jobs.job import Job
from truepath.app.jobs.transitions import Verb, apply_verb
from truepath.app.motion.configurations import Commanded


def prepare_arming(
    job_id: str, context: JobContext, tokens: ArmTokens, by: str | None
) -> Arming:
    """Return what a job that waits to be armed will do, and a token to arm it.

    by : name of the user who asks; None where nobody logs in

    Raises IllegalTransition.
    """
    job = context.store.get(job_id)
    apply_verb(Verb.ARM, job.state)
    driven = context.machines.choose(job.machine)
    parts = list_commanded(context.store.read_plan(job_id))
    board, read = driven.conditions, driven.cell.controller
    here = {} if read is None else read.position_by_axis
    purpose = make_purpose(job, parts, context, by)
    return Arming(
        job,
        driven,
        summarise_motion(driven.machine, job.kind, parts, here),
        () if board is None else tuple(board.read()),
        purpose.plan_sha256,
        tokens.issue(purpose),
        tokens.valid_s,
    )


def make_purpose(
    job: Job, parts: Sequence[Commanded], context: JobContext, by: str | None
) -> ArmingPurpose:
    """Return what a token to arm a job is good for."""
    driven = context.machines.choose(job.machine)
    plan_sha256 = hash_commanded(parts)
    return ArmingPurpose(
        job.id, job.version, by, driven.id, driven.version, plan_sha256
    )


def require_order(job: Job, context: JobContext) -> None:
    """Raise NotInOrder if a condition of the machine of a job forbids motion."""
    board = context.machines.choose(job.machine).conditions
    obstacles = [] if board is None else board.list_obstacles()
    if obstacles:
        raise NotInOrder(obstacles)


def require_control(active: ActiveJob, by: str | None) -> None:
    """Raise NotInControl if another user has the job under control."""
    if by is not None and active.controller not in (None, by):
        raise NotInControl(active.controller or "")
