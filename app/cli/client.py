"""The service as its REST clients see it, and a calibration through it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPException
from typing import Any
from urllib.parse import urlsplit

from truepath.app.cli.terminal import NotedProgress, print_stages, say
from truepath.app.errors import JobError, MeasurementFailed, TruepathError
from truepath.app.files.verdict import TITLES
from truepath.app.jobs.transitions import FINAL

READY_TIMEOUT_S = 60.0
_TIMEOUT_S = 30.0

Json = dict[str, Any]


class Client:
    """Speaks to one service at `http://host:port`.

    token : an API key, where the service asks for a log-in

    Raises JobError: in the words of the service's problem where it refuses, naming the
    address where nobody answers.
    """

    def __init__(self, address: str, token: str = "") -> None:
        self.address, self._token = address.rstrip("/"), token
        self._host = urlsplit(self.address).netloc

    def get(self, path: str) -> Json:
        """Return what is at a path below `/api/v1`."""
        return self._request("GET", f"/api/v1{path}", None, None)

    def post(
        self, path: str, body: Json | None = None, *, version: int | None = None
    ) -> Json:
        """Ask for something; `version` is the one the job must still have."""
        return self._request("POST", f"/api/v1{path}", body, version)

    def follow(self, job_id: str, *, period_s: float = 0.5) -> Iterator[Json]:
        """Yield the job again and again, the last time in a final state."""
        while True:
            job = self.get(f"/jobs/{job_id}")
            yield job
            if job["state"] in FINAL:
                return
            time.sleep(period_s)

    def wait_for(
        self, job_id: str, reached: Callable[[Json], bool], timeout_s: float
    ) -> Json:
        """Return the job once it is as asked or final; JobError after `timeout_s`."""
        end = time.monotonic() + timeout_s
        for job in self.follow(job_id, period_s=0.1):
            if reached(job) or job["state"] in FINAL:
                return job
            if time.monotonic() > end:
                break
        raise JobError(f"job {job_id} did not get ready in {timeout_s:.0f} s")

    def _request(
        self, method: str, path: str, body: Json | None, version: int | None
    ) -> Json:
        headers = {"Content-Type": "application/json"}
        if self._token:
            headers["Authorization"] = f"Bearer {self._token}"
        if version is not None:
            headers["If-Match"] = f'"{version}"'
        connection = HTTPConnection(self._host, timeout=_TIMEOUT_S)
        try:
            connection.request(method, path, json.dumps(body or {}), headers)
            response = connection.getresponse()
            content = _parse_content(response.read())
        except (OSError, HTTPException) as error:
            raise JobError(f"{self.address} does not answer: {error}") from error
        finally:
            connection.close()
        if response.status >= 400:
            raise JobError(_describe_problem(content) or f"{response.status} at {path}")
        return content


def calibrate(address: str) -> None:
    """Do the main job over REST and say how it goes; a failure is a line."""
    client = Client(address)
    try:
        job_id = measure_on_the_fly(client)
        say(f"calibrating on the fly: watch it at {address}/")
        progress = print_stages(_describe_tenth, steps=10)
        job = follow_to_the_end(client, job_id, progress)
    except TruepathError as error:
        say(f"the main job ended early: {error}")
        return
    if job["verdict"] not in (None, "usable"):
        say(f"warning: the result is {TITLES[job['verdict']].lower()}")
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
    reason = _describe_problem(job["error"]) or "no reason was given"
    return f"job {job['id']} is {job['state']}: {reason}"


def _describe_tenth(share: float, stage: str, note: str) -> str:
    return f"  {stage} {100 * share:3.0f} %, {note}"


def _describe_problem(problem: Json | None) -> str:
    """Return detail and action of an RFC 9457 problem; empty where it has neither."""
    problem = problem or {}
    said = [problem.get("detail") or problem.get("title"), problem.get("action")]
    return "; ".join(filter(None, said))


def _parse_content(body: bytes) -> Json:
    try:
        content = json.loads(body)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {"items": content}
