"""Verbs that need several requests: generators that never send or wait.

A client sends each Request that is yielded and sends its Answer back in, throws
Unreachable in where there is none, and waits where a Pause is yielded.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from truepath.client import requests
from truepath.client.bodies import FINAL_STATES, Job, Json
from truepath.client.problems import JobEnded, JobNotReached, Unreachable
from truepath.client.requests import Answer, Filters, Request

T = TypeVar("T")
REPEATS_S = (0.2, 1.0, 3.0)
"""Pauses before a request whose answer was lost is sent again."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Wait this time."""

    duration_s: float


Step = Request[Any] | Pause
Steps = Generator[Step, Answer, T]


def ask(request: Request[T]) -> Steps[T]:
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


def arm(job: Job, token: str | None) -> Steps[Job]:
    """Arm a job, with the token of an arming that was checked, or of a new one."""
    if token is None:
        arming = yield from ask(requests.prepare_arming(job["id"]))
        token = arming["token"]
    return (yield from ask(requests.arm(job, token)))


def wait_for(
    job_id: str, wanted: tuple[str, ...], timeout_s: float | None, period_s: float
) -> Steps[Job]:
    """Read a job until it is in one of the states.

    wanted : empty for `succeeded`

    Raises JobEnded in another final state, JobNotReached after `timeout_s`.
    """
    states = wanted or ("succeeded",)
    end = None if timeout_s is None else time.monotonic() + timeout_s
    while True:
        job = yield from ask(requests.get_job(job_id))
        if job["state"] in states:
            return job
        if job["state"] in FINAL_STATES:
            raise JobEnded(job)
        if end is not None and time.monotonic() > end:
            raise JobNotReached(job, " or ".join(states), timeout_s or 0.0)
        yield Pause(period_s)


def read_page(list_page: Any, filters: Filters, after: str | None) -> Steps[Json]:
    """One page of a list, after this cursor."""
    return ask(list_page({**filters, "after": after}))
