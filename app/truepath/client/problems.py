"""Errors of a client: refusals of the service (RFC 9457), and missing answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from truepath.client.bodies import Job

Content = Mapping[str, Any]


class ClientError(Exception):
    """Base of all errors of a client."""


class Unreachable(ClientError):
    """No answer at the address, or a broken one.

    The request may have been executed; read before it is sent again.
    """


class Problem(ClientError):
    """The service refuses, or fails. The text is for the user.

    status : of the answer; code : for programs, such as `busy`
    detail, action : problem and remedy; request_id : as in the log
    content : every member of the problem; retry_after_s : None if not given
    """

    def __init__(
        self, status: int, content: Content, retry_after_s: float | None = None
    ) -> None:
        self.status, self.content, self.retry_after_s = status, content, retry_after_s
        self.code = str(content.get("code") or "")
        self.detail = str(content.get("detail") or content.get("title") or "")
        self.action = str(content.get("action") or "")
        self.request_id = str(content.get("request_id") or "")
        super().__init__(describe_problem(content) or f"status {status}")


class Refused(Problem):
    """The request cannot be executed as it is (4xx)."""


class NotLoggedIn(Refused):
    """No token, or one that is not valid any more (401)."""


class Forbidden(Refused):
    """The role does not permit it, or a person has to do it (403)."""


class NotFound(Refused):
    """Does not exist, or not yet (404)."""


class Conflict(Refused):
    """The state of a job, of the machine or of a device does not permit it (409)."""


class Busy(Conflict):
    """Another job holds the machine; `current_job` is its address."""

    @property
    def current_job(self) -> str:
        """Address of the job that holds the machine; empty if unknown."""
        return str(self.content.get("current_job") or "")


class StaleVersion(Refused):
    """The job has changed since it was read (412); `current_version` is the new one."""

    @property
    def current_version(self) -> int | None:
        """Present version of the job."""
        return self.content.get("current_version")


class BadInput(Refused):
    """The input is wrong (422): `file`, `row` and `column` locate it, where known.

    `errors` lists the deviations from the documented request.
    """

    @property
    def errors(self) -> list[Any]:
        """Each with `location`, `message` and `type`."""
        return list(self.content.get("errors") or ())

    @property
    def place(self) -> tuple[str, int | None, str]:
        """File, row and column."""
        content = self.content
        file, column = content.get("file") or "", content.get("column") or ""
        return str(file), content.get("row"), str(column)


class TooManyRequests(Refused):
    """Too many requests in a short time (429); wait `retry_after_s`."""


class ServiceProblem(Problem):
    """The service fails, or is not ready (5xx)."""


class DeviceProblem(ServiceProblem):
    """A device cannot be reached, fails, or is silent (502, 504)."""


class JobEnded(ClientError):
    """A job has ended in another state than expected; `job` gives the reason."""

    def __init__(self, job: Job) -> None:
        self.job = job
        reason = describe_problem(job["error"]) or "no reason was given"
        super().__init__(f"job {job['id']} is {job['state']}: {reason}")


class JobNotReached(ClientError):
    """A job has not reached a state in time; `job` is its present one."""

    def __init__(self, job: Job, wanted: str, timeout_s: float) -> None:
        self.job = job
        super().__init__(
            f"job {job['id']} is {job['state']}, not {wanted}, after {timeout_s:g} s"
        )


_BY_CODE: Mapping[str, type[Problem]] = {"busy": Busy}
_BY_STATUS: Mapping[int, type[Problem]] = {
    401: NotLoggedIn,
    403: Forbidden,
    404: NotFound,
    409: Conflict,
    412: StaleVersion,
    422: BadInput,
    429: TooManyRequests,
    502: DeviceProblem,
    504: DeviceProblem,
}


def make_problem(
    status: int, content: object, retry_after: str | None = None
) -> Problem:
    """The most specific exception for a refusal.

    content : JSON of the answer, or the content received in its place
    """
    members: Content = {}
    if isinstance(content, Mapping):
        members = cast(Content, content)
    family = _BY_CODE.get(str(members.get("code"))) or _BY_STATUS.get(status)
    if family is None:
        family = Refused if status < 500 else ServiceProblem
    wait = retry_after or ""
    return family(status, members, float(wait) if wait.isdecimal() else None)


def describe_problem(content: Content | None) -> str:
    """Detail and action of a problem; empty where it has neither."""
    content = content or {}
    said = (content.get("detail") or content.get("title"), content.get("action"))
    return "; ".join(str(part) for part in said if part)
