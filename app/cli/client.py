"""The service as its REST clients see it: the few calls the command line needs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPException
from typing import Any
from urllib.parse import urlsplit

from app.errors import JobError

FINAL_STATES = frozenset({"aborted", "succeeded", "failed", "faulted", "interrupted"})
_TIMEOUT_S = 30.0

Json = dict[str, Any]


class Client:
    """Speaks to one service at `http://host:port`.

    Raises JobError: in the words of the service's problem where it refuses, naming the
    address where nobody answers.
    """

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        self._host = urlsplit(self.address).netloc

    def get(self, path: str) -> Json:
        """Return what is at a path below `/api/v1`."""
        return self._request("GET", f"/api/v1{path}")

    def post(
        self, path: str, body: Json | None = None, *, version: int | None = None
    ) -> Json:
        """Ask for something; `version` is the one the job must still have."""
        return self._request("POST", f"/api/v1{path}", body, version)

    def job(self, job_id: str) -> Json:
        """Return a job."""
        return self.get(f"/jobs/{job_id}")

    def follow(self, job_id: str, *, period_s: float = 0.5) -> Iterator[Json]:
        """Yield the job again and again, the last time in a final state."""
        while True:
            job = self.job(job_id)
            yield job
            if job["state"] in FINAL_STATES:
                return
            time.sleep(period_s)

    def wait_for(
        self, job_id: str, reached: Callable[[Json], bool], timeout_s: float
    ) -> Json:
        """Return the job once it is as asked or final; JobError after `timeout_s`."""
        end = time.monotonic() + timeout_s
        for job in self.follow(job_id, period_s=0.1):
            if reached(job) or job["state"] in FINAL_STATES:
                return job
            if time.monotonic() > end:
                break
        raise JobError(f"job {job_id} did not get ready in {timeout_s:.0f} s")

    def _request(
        self,
        method: str,
        path: str,
        body: Json | None = None,
        version: int | None = None,
    ) -> Json:
        headers = {"Content-Type": "application/json"}
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
            raise JobError(problem_text(content) or f"{response.status} at {path}")
        return content


def problem_text(problem: Json | None) -> str:
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
