"""Requests to each address of the interface, with the decoding of the answers."""

from __future__ import annotations

import json
import ssl
import uuid
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Generic, TypeVar, cast

from truepath.client.bodies import (
    Arming,
    Condition,
    ErrorTables,
    Estimate,
    Job,
    Json,
    Machine,
    MachineRecord,
    Plan,
    Run,
    System,
)
from truepath.client.problems import make_problem

PREFIX = "/api/v1"
T = TypeVar("T")
Filters = Mapping[str, "str | int | bool | list[str] | list[float] | None"]


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of the service."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True, slots=True)
class Request(Generic[T]):
    """A request, and the decoding of its answer.

    may_repeat : a repeat does no harm, so the request is sent again after a lost answer
    upload : file that is sent as `bundle`
    """

    method: str
    path: str
    read: Callable[[Answer], T]
    body: Json | None = None
    query: Filters = field(default_factory=dict[str, Any])
    headers: Mapping[str, str] = field(default_factory=dict[str, str])
    may_repeat: bool = True
    upload: Path | None = None

    def decode(self, answer: Answer) -> T:
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


def _bytes(answer: Answer) -> bytes:
    return answer.body


def read_nothing(answer: Answer) -> None:
    """For an answer without a body."""
    return None


def get(path: str, read: Callable[[Answer], T], **query: Any) -> Request[T]:
    """Request of an address below the prefix."""
    return Request("GET", f"{PREFIX}{path}", read, query=query)


def _verb(
    job_id: str, verb: str, version: int | None = None, body: Json | None = None
) -> Request[Job]:
    """Verbs that move the machine are never repeated."""
    headers = {} if version is None else {"If-Match": f'"{version}"'}
    path, again = f"{PREFIX}/jobs/{job_id}/{verb}", version is None
    return Request(
        "POST", path, read_json, body=body, headers=headers, may_repeat=again
    )


def _create(path: str, body: Json, key: str | None) -> Request[Any]:
    headers = {"Idempotency-Key": key or str(uuid.uuid4())}
    return Request("POST", f"{PREFIX}{path}", read_json, body=body, headers=headers)


def get_system() -> Request[System]:
    """State of the service, and the job that holds the machine."""
    return cast(Request[System], get("/system", read_json))


def create_job(body: Json, key: str | None = None) -> Request[Job]:
    """`POST /jobs`."""
    return _create("/jobs", body, key)


def get_job(job_id: str) -> Request[Job]:
    """`GET /jobs/{id}`."""
    return get(f"/jobs/{job_id}", read_json)


def list_jobs(filters: Filters) -> Request[Json]:
    """One page of jobs."""
    return Request("GET", f"{PREFIX}/jobs", read_json, query=filters)


def prepare_arming(job_id: str) -> Request[Arming]:
    """Summary of a job's motion, with the token to arm it."""
    return Request("POST", f"{PREFIX}/jobs/{job_id}/arming", read_json)


def arm(job: Job, token: str) -> Request[Job]:
    """Let a job move the machine, in its version and as the token's arming showed."""
    return _verb(job["id"], "arm", job["version"], {"token": token})


def resume(job: Job) -> Request[Job]:
    """Resume after a hold, in the job's version."""
    return _verb(job["id"], "resume", job["version"])


def pause(job_id: str) -> Request[Job]:
    """Hold the feed."""
    return _verb(job_id, "pause")


def cancel(job_id: str) -> Request[Job]:
    """End a job in order."""
    return _verb(job_id, "cancel")


def abort(job_id: str) -> Request[Job]:
    """End a job now."""
    return _verb(job_id, "abort")


def acknowledge(job_id: str) -> Request[Job]:
    """Prepare an interrupted measurement to resume."""
    return _verb(job_id, "acknowledge")


def take_control(job_id: str) -> Request[Job]:
    """Take over the right to arm and resume a job."""
    return _verb(job_id, "take-control")


def rename_job(job_id: str, naming: Json) -> Request[Job]:
    """Change name and note of a job."""
    return Request("PATCH", f"{PREFIX}/jobs/{job_id}", read_json, body=naming)


def rename_run(run_id: str, naming: Json) -> Request[Run]:
    """Change name and note of a Run."""
    return Request("PATCH", f"{PREFIX}/runs/{run_id}", read_json, body=naming)


def delete_job(job_id: str) -> Request[None]:
    """Delete a job that has ended. If the answer is lost, check whether it exists."""
    return Request("DELETE", f"{PREFIX}/jobs/{job_id}", read_nothing, may_repeat=False)


def delete_run(run_id: str, *, with_results: bool) -> Request[None]:
    """Delete a Run. If the answer is lost, check whether it exists."""
    path, query = f"{PREFIX}/runs/{run_id}", {"with_results": with_results}
    return Request("DELETE", path, read_nothing, query=query, may_repeat=False)


def issue_certificate(job_id: str, body: Json) -> Request[Json]:
    """Not repeated: twice would issue two."""
    path = f"{PREFIX}/jobs/{job_id}/certificates"
    return Request("POST", path, read_json, body=body, may_repeat=False)


def preview_certificate(job_id: str, body: Json) -> Request[Json]:
    """Keeps nothing."""
    path = f"{PREFIX}/jobs/{job_id}/certificates/preview"
    return Request("POST", path, read_json, body=body)


def list_certificates(job_id: str) -> Request[list[Json]]:
    """Certificates of a result, the oldest first."""
    return cast(Request[list[Json]], get(f"/jobs/{job_id}/certificates", read_items))


def stop() -> Request[Json]:
    """Stop all motion."""
    return Request("POST", f"{PREFIX}/stop", read_json)


def get_job_plan(job_id: str) -> Request[Json]:
    """Rows that a job commands."""
    return get(f"/jobs/{job_id}/plan", read_json)


def get_estimate(job_id: str) -> Request[Estimate | None]:
    """Newest estimate of an active measurement."""
    return cast(Request["Estimate | None"], get(f"/jobs/{job_id}/estimate", read_json))


def get_document(job_id: str, name: str) -> Request[Json]:
    """`result`, `discovery`, `verification`, `reanalysis` or `trend` of a job."""
    return get(f"/jobs/{job_id}/{name}", read_json)


def get_error_tables(job_id: str) -> Request[ErrorTables]:
    """Error tables of a job, with their verdict."""
    path = f"/jobs/{job_id}/result/error-tables.json"
    return cast(Request[ErrorTables], get(path, read_json))


def download(path: str) -> Request[bytes]:
    """Content of a file by its address, as in `links` of the interface."""
    return Request("GET", path, _bytes)


def create_plan(body: Json, key: str | None = None) -> Request[Plan]:
    """`POST /plans`."""
    return _create("/plans", body, key)


def get_plan(plan_id: str) -> Request[Plan]:
    """`GET /plans/{id}`."""
    return get(f"/plans/{plan_id}", read_json)


def upload_bundle(bundle: Path) -> Request[Run]:
    """Upload a zipped bundle. Not repeated: twice would make two Runs."""
    path = f"{PREFIX}/runs"
    return Request("POST", path, read_json, upload=bundle, may_repeat=False)


def get_run(run_id: str) -> Request[Run]:
    """`GET /runs/{id}`."""
    return get(f"/runs/{run_id}", read_json)


def list_runs(filters: Filters) -> Request[Json]:
    """One page of Runs."""
    return Request("GET", f"{PREFIX}/runs", read_json, query=filters)


def make_compensation(job_id: str, body: Json) -> Request[Json]:
    """Files of a controller; the same request makes the same ones."""
    return Request(
        "POST", f"{PREFIX}/jobs/{job_id}/compensations", read_json, body=body
    )


def log_in(name: str, password: str) -> Request[Json]:
    """Token of a new session."""
    body = {"name": name, "password": password}
    return Request("POST", f"{PREFIX}/session", read_json, body=body, may_repeat=False)


def log_out() -> Request[None]:
    """End the session."""
    return Request("DELETE", f"{PREFIX}/session", read_nothing)


def connect(machine_id: str) -> Request[Json]:
    """Open the ports; moves nothing."""
    return Request("POST", f"{PREFIX}/machines/{machine_id}:connect", read_json)


def get_machine() -> Request[Json]:
    """Machine file, and identities of the connected devices."""
    return get("/machines/current", read_json)


def list_conditions(machine_id: str) -> Request[list[Condition]]:
    """Conditions for a motion of the machine."""
    return cast(
        Request[list[Condition]], get(f"/machines/{machine_id}/conditions", read_items)
    )


def list_machines() -> Request[list[Machine]]:
    """All machines."""
    return cast(Request[list[Machine]], get("/machines", read_items))


def get_machine_record(machine_id: str) -> Request[MachineRecord]:
    """A machine of the registry, with its configuration."""
    return cast(Request[MachineRecord], get(f"/machines/{machine_id}", read_json))


def add_machine(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Add a machine to the registry. Not repeated: it would exist by then."""
    content = {"id": machine_id, **body}
    return Request(
        "POST", f"{PREFIX}/machines", read_json, body=content, may_repeat=False
    )


def change_machine(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Change identity, tolerance or reference of a machine."""
    return Request("PATCH", f"{PREFIX}/machines/{machine_id}", read_json, body=body)


def remove_machine(machine_id: str, version: int) -> Request[None]:
    """Remove a machine, in its version. If the answer is lost, list the machines."""
    return Request(
        "DELETE",
        f"{PREFIX}/machines/{machine_id}",
        read_nothing,
        headers={"If-Match": f'"{version}"'},
        may_repeat=False,
    )


def set_machine_file(machine_id: str, machine_file: Json) -> Request[MachineRecord]:
    """Replace the machine file."""
    path, body = f"/machines/{machine_id}/machine-file", {"machine_file": machine_file}
    return Request("PUT", f"{PREFIX}{path}", read_json, body=body)


def set_machine_devices(machine_id: str, body: Json) -> Request[MachineRecord]:
    """Choose drivers and options of a machine."""
    path = f"{PREFIX}/machines/{machine_id}/devices"
    return Request("PUT", path, read_json, body=body)


def get_machine_history(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """A quantity over all calibrations of a machine."""
    return get(f"/machines/{machine_id}/history", read_json, **query)


def get_machine_changes(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """Changes between two calibrations of a machine."""
    return get(f"/machines/{machine_id}/changes", read_json, **query)


def get_machine_temperature(machine_id: str, query: dict[str, Any]) -> Request[Json]:
    """Dependence of the errors of a machine on its temperature."""
    return get(f"/machines/{machine_id}/temperature", read_json, **query)


def get_machine_standing(machine_id: str) -> Request[Json]:
    """Status of a machine by its newest usable calibration."""
    return get(f"/machines/{machine_id}/standing", read_json)


def compare_machines(query: dict[str, Any]) -> Request[Json]:
    """One quantity of several machines."""
    return get("/machines:compare", read_json, **query)
