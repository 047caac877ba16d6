"""A client of the service for Python programs: `Client`, and `AsyncClient` alike.

    with Client("http://127.0.0.1:8411") as client:
        job = client.create_job(kind="measure-otf")
        job = client.wait_for(job["id"], "ready", timeout_s=60)
        client.arm(job)

`requests` has the request of each verb and decodes its answer; `steps` the verbs that
need several requests, as generators that neither send nor wait. `sync_client` and
`async_client` run these. Answers are the JSON of the interface, typed in `bodies`; keys
that are unknown to this version are kept. Refusals are raised as `problems`. Nothing
here imports the service.
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
