"""A calibration through the REST interface of a service, shown in the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from truepath.cli.terminal import NotedProgress, print_stages, say
from truepath.client import FINAL_STATES, Client, ClientError, Job, JobEnded
from truepath.errors import MeasurementFailed
from truepath.files.earlier.verdict import TITLES
from truepath_drivers import host_clock

READY_TIMEOUT_S = 60.0


def follow(client: Client, job_id: str, *, period_s: float = 0.5) -> Iterator[Job]:
    """Yield the job every `period_s`, the last time in a final state."""
    while True:
        job = client.get_job(job_id)
        yield job
        if job["state"] in FINAL_STATES:
            return
        host_clock.sleep_s(period_s)


def calibrate(address: str) -> None:
    """Calibrate over REST and print the progress; a failure is one line."""
    try:
        with Client(address) as client:
            job_id = measure_on_the_fly(client)
            say(f"calibrating on the fly: watch it at {address}/")
            progress = print_stages(
                lambda share, stage, note: f"  {stage} {100 * share:3.0f} %, {note}",
                steps=10,
            )
            job = follow_to_the_end(client, job_id, progress)
    except (ClientError, MeasurementFailed) as error:
        say(f"the main job ended early: {error}")
        return
    title = next((t for state, t in TITLES.items() if state == job["verdict"]), "")
    if title and job["verdict"] != "usable":
        say(f"warning: the result is {title.lower()}")
    result = f"{address}/api/v1/jobs/{job_id}/result"
    say(f"error tables with uncertainties stand at {address}/")
    say(f"  table   {result}/error-tables.csv")
    say(f"  report  {result}/report.html")
    say("Ctrl-C ends the service.")


def measure_on_the_fly(client: Client) -> str:
    """Connect, plan and arm a measurement on the fly; gives the job's identifier.

    Of the only or first machine of the service. Arming is the last step: from here on
    the machine moves.
    """
    client.connect()
    first = client.list_machines()[0]["id"]
    job_id = client.create_job(kind="measure-otf", machine=first)["id"]
    try:
        ready = client.wait_for(
            job_id, "ready", timeout_s=READY_TIMEOUT_S, period_s=0.1
        )
    except JobEnded as error:
        raise MeasurementFailed(str(error)) from error
    client.arm(ready)
    return job_id


def follow_to_the_end(client: Client, job_id: str, on_progress: NotedProgress) -> Job:
    """Report progress until the job has ended; raise MeasurementFailed if it failed."""
    for job in follow(client, job_id):
        progress, health = job["progress"], job["health"]
        total = progress["total"]
        share = min(progress["done"] / total, 1.0) if total else 0.0
        note = f"{health['samples']} samples, {health['lost_samples']} lost"
        on_progress(share, job["stage"], note)
        if job["state"] == "succeeded":
            return job
        if job["state"] in FINAL_STATES:
            raise MeasurementFailed(str(JobEnded(job)))
    raise AssertionError("a job that is followed ends")
