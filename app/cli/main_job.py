"""The main job over REST, as an operator at a shop-floor panel would do it."""

from __future__ import annotations

from app.cli.client import Client, Json, problem_text
from app.cli.terminal import NotedProgress
from app.errors import MeasurementFailed

READY_TIMEOUT_S = 60.0


def measure_on_the_fly(client: Client) -> str:
    """Connect, plan and arm a measurement on the fly; return the job's identifier.

    Arming is the last step: from here on the machine moves.
    """
    client.post("/machines/current:connect")
    job_id = client.post("/jobs", {"kind": "measure-otf"})["id"]
    job = client.wait_for(job_id, lambda j: j["state"] == "ready", READY_TIMEOUT_S)
    if job["state"] != "ready":
        raise MeasurementFailed(_describe_failure(job))
    client.post(f"/jobs/{job_id}/arm", version=job["version"])
    return job_id


def follow_to_the_end(client: Client, job_id: str, on_progress: NotedProgress) -> Json:
    """Report progress until the job has ended; raise MeasurementFailed if it failed."""
    job: Json = {}
    for job in client.follow(job_id):
        on_progress(
            _read_share(job), job["stage"] or job["state"], _describe_health(job)
        )
    if job["state"] != "succeeded":
        raise MeasurementFailed(_describe_failure(job))
    return job


def _read_share(job: Json) -> float:
    progress = job["progress"] or {}
    total = progress.get("total") or 0
    return min(progress.get("done", 0) / total, 1.0) if total else 0.0


def _describe_health(job: Json) -> str:
    health = job["health"] or {}
    samples, lost = health.get("samples", 0), health.get("lost_samples", 0)
    return f"{samples} samples, {lost} lost"


def _describe_failure(job: Json) -> str:
    reason = problem_text(job["error"]) or "no reason was given"
    return f"job {job['id']} is {job['state']}: {reason}"
