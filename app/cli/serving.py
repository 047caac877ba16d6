"""The service in this process; with `--measure`, its own first user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.cli.client import Client, Json, problem_text
from app.cli.terminal import NotedProgress, say
from app.errors import BadInput, MeasurementFailed, TruepathError
from app.main import serve
from app.settings import load_settings

READY_TIMEOUT_S = 60.0


def serve_until_stopped(config: Path | None, *, measure: bool, **given: Any) -> None:
    """Serve until SIGTERM or Ctrl-C.

    measure : begin the main job as soon as the service answers; simulated devices only,
        since nobody has looked at the machine
    given : settings of the command line; None where one was not given
    """
    settings = load_settings(config, **given)
    if measure and not settings.simulated:
        raise BadInput("--measure moves the machine at once; it needs --simulated")
    if given.get("simulated_hidden") and not settings.simulated:
        raise BadInput("--hide is for simulated devices; it needs --simulated")
    serve(settings, listening=calibrate if measure else None)


def calibrate(address: str) -> None:
    """Do the main job over REST and say how it goes; a failure is a line."""
    client = Client(address)
    try:
        job_id = measure_on_the_fly(client)
        say(f"calibrating on the fly: watch it at {address}/")
        follow_to_the_end(client, job_id, _make_line_printer())
    except TruepathError as error:
        say(f"the main job ended early: {error}")
        return
    result = f"{address}/api/v1/jobs/{job_id}/result"
    say(f"error tables with uncertainties stand at {address}/")
    say(f"  table   {result}/error-tables.csv")
    say(f"  report  {result}/report.html")
    say("Ctrl-C ends the service.")


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
        progress, health = job["progress"] or {}, job["health"] or {}
        total = progress.get("total") or 0
        share = min(progress.get("done", 0) / total, 1.0) if total else 0.0
        samples, lost = health.get("samples", 0), health.get("lost_samples", 0)
        note = f"{samples} samples, {lost} lost"
        on_progress(share, job["stage"] or job["state"], note)
    if job["state"] != "succeeded":
        raise MeasurementFailed(_describe_failure(job))
    return job


def _describe_failure(job: Json) -> str:
    reason = problem_text(job["error"]) or "no reason was given"
    return f"job {job['id']} is {job['state']}: {reason}"


def _make_line_printer() -> NotedProgress:
    """Report by lines, one a stage and one every tenth: the log shares the screen."""
    last = ("", -1)

    def on_progress(share: float, stage: str, note: str = "") -> None:
        nonlocal last
        now = (stage, int(10 * share))
        if now != last:
            say(f"  {stage} {100 * share:3.0f} %, {note}")
            last = now

    return on_progress
