"""A client of the service for Python programs: `Client`, and `AsyncClient` alike.

    with Client("http://127.0.0.1:8411") as client:
        job = client.create_job(kind="measure-otf")
        job = client.wait_for(job["id"], "ready", timeout_s=60)
        client.arm(job)

`async_client` has the request of each verb, and `sync_client` is written from it;
`requests` decodes the answers, and has the verbs that need several requests as
generators that neither send nor wait. Answers are the JSON of the interface, typed in
`bodies`; keys that are unknown to this version are kept. Refusals are raised as
`problems`. Nothing here imports the service.
"""

from truepath.client.async_client import AsyncClient
from truepath.client.bodies import FINAL_STATES, Job
from truepath.client.problems import (
    Busy,
    ClientError,
    DeviceProblem,
    Forbidden,
    JobEnded,
    JobNotReached,
    NotLoggedIn,
    Problem,
    Refused,
    StaleVersion,
    Unreachable,
)
from truepath.client.sync_client import Client

__all__ = [
    "FINAL_STATES",
    "AsyncClient",
    "Busy",
    "Client",
    "ClientError",
    "DeviceProblem",
    "Forbidden",
    "Job",
    "JobEnded",
    "JobNotReached",
    "NotLoggedIn",
    "Problem",
    "Refused",
    "StaleVersion",
    "Unreachable",
]
