"""Description of a job for clients."""

from __future__ import annotations

from dataclasses import asdict, replace

from truepath.catalogue.job import Job
from truepath.catalogue.transitions import Verb
from truepath.jobs.running.resumption import find_way_to_result, may_be_acknowledged
from truepath.service.api.models.base import PREFIX, Problem, address
from truepath.service.api.models.jobs.job import (
    DiscoveryLinks,
    JobLinks,
    JobOut,
    ReanalysisLinks,
    ResultLinks,
    TrendLinks,
    VerificationLinks,
)
from truepath.service.api.problems import describe_failure
from truepath.service.api.security.route_roles import LEAST_ROLES

_ROUTED = frozenset(
    verb for verb in Verb if f"POST {PREFIX}/jobs/{{job_id}}/{verb}" in LEAST_ROLES
)
_ANSWER_LINKS = {
    "result": ResultLinks,
    "discovery": DiscoveryLinks,
    "trend": TrendLinks,
    "reanalysis": ReanalysisLinks,
    "verification": VerificationLinks,
}


def describe_job(job: Job) -> JobOut:
    """A job with links, failure as a problem, and permitted verbs."""
    content, failure = asdict(job), job.failure
    at = address(f"/jobs/{job.id}")
    links = JobLinks.of(id=job.id, run_id=job.run_id)
    links.verbs = {v: f"{at}/{v}" for v in job.allowed_verbs if v in _ROUTED}
    if not may_be_acknowledged(job):
        links.verbs.pop(Verb.ACKNOWLEDGE, None)
    if failure and (way := find_way_to_result(job)):
        failure = replace(failure, action=way)
    content["progress"]["stage"] = job.stage
    if job.early_end:
        content["early_end"]["reason"] = "target-reached"
    content |= {
        answer: links_of.of(id=job.id) if answer == job.answer else None
        for answer, links_of in _ANSWER_LINKS.items()
    }
    return JobOut(
        **content,
        run_ids=list(job.run_ids),
        error=Problem(**describe_failure(failure)) if failure else None,
        links=links,
    )
