"""Requests and the decoding of their answers; verbs that need several requests.

Such verbs are generators that never send or wait: a client sends each Request that is
yielded and sends its Answer back in, throws Unreachable in where there is none, and
waits where a Pause is yielded.
"""

from __future__ import annotations

import json
import ssl
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, TypeVar

from truepath.client.bodies import FINAL_STATES, Job, Json
from truepath.client.problems import JobEnded, JobNotReached, Unreachable, make_problem

PREFIX = "/api/v1"
REPEATS_S = (0.2, 1.0, 3.0)
"""Pauses before a request whose answer was lost is sent again."""
T = TypeVar("T")
Query = Mapping[str, "str | int | bool | list[str] | list[float] | None"]


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of the service."""

    status: int
    headers: Mapping[str, str]
    body: bytes


Reader = Callable[[Answer], Any]


@dataclass(frozen=True, slots=True)
class Request:
    """A request, and the decoding of its answer.

    may_repeat : a repeat does no harm, so the request is sent again after a lost answer
    upload : file that is sent as `bundle`
    """

    method: str
    path: str
    read: Reader
    body: Json | None = None
    query: Query = field(default_factory=dict[str, Any])
    headers: Mapping[str, str] = field(default_factory=dict[str, str])
    may_repeat: bool = True
    upload: Path | None = None

    def decode(self, answer: Answer) -> Any:
        """The decoded answer. Raises a Problem for a refusal."""
        if answer.status >= 400:
            after = answer.headers.get("retry-after")
            raise make_problem(answer.status, parse_json(answer.body), after)
        return self.read(answer)

    def open_upload(self, files: ExitStack) -> dict[str, IO[bytes]] | None:
        """Open the file to be sent, to be closed with the others."""
        if self.upload is None:
            return None
        return {"bundle": files.enter_context(self.upload.open("rb"))}

    @property
    def parameters(self) -> dict[str, Any]:
        """The query, without None."""
        return {name: v for name, v in self.query.items() if v is not None}


def make_tls_context(certificates: Path | None) -> ssl.SSLContext | bool:
    """Verification of HTTPS: by the system, and by certificates of a file."""
    if certificates is None:
        return True
    context = ssl.create_default_context()
    context.load_verify_locations(certificates)
    return context


def parse_json(body: bytes) -> Any:
    """None where the body is no JSON."""
    try:
        return json.loads(body)
    except ValueError:
        return None


def read_json(answer: Answer) -> Any:
    """Body of an answer."""
    return parse_json(answer.body)


def read_items(answer: Answer) -> Any:
    """Items of a list."""
    return parse_json(answer.body)["items"]


def read_bytes(answer: Answer) -> bytes:
    """Content of a file."""
    return answer.body


def read_nothing(answer: Answer) -> None:
    """For an answer without a body."""
    return None


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait this time."""

    duration_s: float


Step = Request | Pause
Steps = Generator[Step, Answer, T]


def ask(request: Request) -> Steps[Any]:
    """Send a request; repeat it after a lost answer if permitted.

    Raises Problem, Unreachable.
    """
    for pause_s in REPEATS_S if request.may_repeat else ():
        try:
            answer = yield request
        except Unreachable:
            yield Pause(pause_s)
        else:
            return request.decode(answer)
    answer = yield request
    return request.decode(answer)


def move(job: Job, verb: str, body: Json | None = None) -> Request:
    """A verb that moves the machine: in the job's version, and never repeated."""
    path = f"{PREFIX}/jobs/{job['id']}/{verb}"
    headers = {"If-Match": f'"{job["version"]}"'}
    return Request("POST", path, read_json, body, headers=headers, may_repeat=False)


def arm(job: Job, token: str | None) -> Steps[Job]:
    """Arm a job, with the token of an arming that was checked, or of a new one."""
    if token is None:
        path = f"{PREFIX}/jobs/{job['id']}/arming"
        arming = yield from ask(Request("POST", path, read_json))
        token = arming["token"]
    return (yield from ask(move(job, "arm", {"token": token})))


def wait_for(
    job_id: str, wanted: tuple[str, ...], timeout_s: float | None, period_s: float
) -> Steps[Job]:
    """Read a job until it is in one of the states.

    wanted : empty for `succeeded`

    Raises JobEnded in another final state, JobNotReached after `timeout_s`.
    """
    states = wanted or ("succeeded",)
    end = None if timeout_s is None else time.monotonic() + timeout_s
    request = Request("GET", f"{PREFIX}/jobs/{job_id}", read_json)
    while True:
        job = yield from ask(request)
        if job["state"] in states:
            return job
        if job["state"] in FINAL_STATES:
            raise JobEnded(job)
        if end is not None and time.monotonic() > end:
            raise JobNotReached(job, " or ".join(states), timeout_s or 0.0)
        yield Pause(period_s)
