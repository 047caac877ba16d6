# Written by docs/write_sync_client.py from async_client.py; change that.
"""The client for programs that wait for each answer."""

from __future__ import annotations

import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx2

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
from truepath.client.events import SILENCE_S, Event, EventStream
from truepath.client.problems import Unreachable
from truepath.client.requests import (
    PREFIX,
    Answer,
    Pause,
    Query,
    Reader,
    Request,
    Steps,
    arm,
    ask,
    make_tls_context,
    move,
    read_bytes,
    read_items,
    read_json,
    read_nothing,
    wait_for,
)

T = TypeVar("T")


class Client:
    """Client of one service at `http://host:port`.

    token : of a session or an API key, where the service requires a login
    verify : of HTTPS: a file of trusted certificates, in addition to the system's
    transport : in place of the network, for tests

    Raises Problem where the service refuses, Unreachable without an answer.
    """

    def __init__(
        self,
        address: str,
        *,
        token: str | None = None,
        timeout_s: float = 30.0,
        verify: Path | None = None,
        transport: httpx2.BaseTransport | None = None,
    ) -> None:
        self.address = address.rstrip("/")
        self._http = httpx2.Client(
            base_url=self.address,
            timeout=timeout_s,
            verify=make_tls_context(verify),
            transport=transport,
        )
        self._use_token(token)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def log_in(self, name: str, password: str) -> Json:
        """Log in; the session's token is sent with every request from now on."""
        session = self._ask(
            "POST",
            "/session",
            body={"name": name, "password": password},
            may_repeat=False,
        )
        self._use_token(session["token"])
        return session

    def log_out(self) -> None:
        """End the session."""
        self._ask("DELETE", "/session", read_nothing)
        self._use_token(None)

    def get_system(self) -> System:
        """Version and state of the service, and the job that holds the machine."""
        return self._ask("GET", "/system")

    def connect(self, machine_id: str = "current") -> Json:
        """Open the ports of a machine and identify its devices. Moves nothing."""
        return self._ask("POST", f"/machines/{machine_id}:connect")

    def get_machine(self) -> Json:
        """Machine file, and identities of the connected devices."""
        return self._ask("GET", "/machines/current")

    def list_conditions(self, machine_id: str = "current") -> list[Condition]:
        """Conditions for a motion of the machine, with their present state."""
        return self._ask("GET", f"/machines/{machine_id}/conditions", read_items)

    def create_job(self, *, idempotency_key: str | None = None, **order: Any) -> Job:
        """Create a job; `kind` and further keys are those of `POST /jobs`.

        One call makes one job, however often its request has to be sent; a key of the
        caller makes one job of several calls.
        """
        return self._create("/jobs", order, idempotency_key)

    def get_job(self, job_id: str) -> Job:
        """Present state of a job."""
        return self._ask("GET", f"/jobs/{job_id}")

    def prepare_arming(self, job_id: str) -> Arming:
        """Summary of the motion of a job, to be checked, and the token to arm it."""
        return self._ask("POST", f"/jobs/{job_id}/arming")

    def arm(self, job: Job, token: str | None = None) -> Job:
        """Let a job move the machine, in the version read. Raises StaleVersion.

        token : of an arming that was checked; None requests and uses a new one
        """
        return self._run(arm(job, token))

    def pause(self, job_id: str) -> Job:
        """Hold the feed."""
        return self._ask("POST", f"/jobs/{job_id}/pause")

    def resume(self, job: Job) -> Job:
        """Resume after a hold, in the version that was read. Raises StaleVersion."""
        return self._run(ask(move(job, "resume")))

    def cancel(self, job_id: str) -> Job:
        """End a job in order; its current line or point is finished."""
        return self._ask("POST", f"/jobs/{job_id}/cancel")

    def abort(self, job_id: str) -> Job:
        """End a job now."""
        return self._ask("POST", f"/jobs/{job_id}/abort")

    def acknowledge(self, job_id: str) -> Job:
        """Prepare an interrupted measurement to resume. Moves nothing."""
        return self._ask("POST", f"/jobs/{job_id}/acknowledge")

    def take_control(self, job_id: str) -> Job:
        """Take over the right to arm and resume a job. Moves nothing."""
        return self._ask("POST", f"/jobs/{job_id}/take-control")

    def rename_job(self, job_id: str, **naming: str) -> Job:
        """Change `name` or `note` of a job; its version stays."""
        return self._ask("PATCH", f"/jobs/{job_id}", body=naming)

    def rename_run(self, run_id: str, **naming: str) -> Run:
        """Change `name` or `note` of a Run."""
        return self._ask("PATCH", f"/runs/{run_id}", body=naming)

    def delete_job(self, job_id: str) -> None:
        """Delete a job that has ended, with its answer."""
        self._ask("DELETE", f"/jobs/{job_id}", read_nothing, may_repeat=False)

    def delete_run(self, run_id: str, *, with_results: bool = False) -> None:
        """Delete a Run, and with `with_results` the results that depend on it."""
        self._ask(
            "DELETE",
            f"/runs/{run_id}",
            read_nothing,
            query={"with_results": with_results},
            may_repeat=False,
        )

    def list_machines(self) -> list[Machine]:
        """All machines, those with devices of this service first."""
        return self._ask("GET", "/machines", read_items)

    def get_machine_record(self, machine_id: str) -> MachineRecord:
        """A machine of the registry, with its configuration and its versions."""
        return self._ask("GET", f"/machines/{machine_id}")

    def add_machine(self, machine_id: str, **content: Any) -> MachineRecord:
        """Add a machine; `machine_file`, `identity` are those of `POST /machines`."""
        return self._ask(
            "POST", "/machines", body={"id": machine_id, **content}, may_repeat=False
        )

    def change_machine(self, machine_id: str, **change: Any) -> MachineRecord:
        """Change identity, tolerance or reference of a machine; the rest stays."""
        return self._ask("PATCH", f"/machines/{machine_id}", body=change)

    def remove_machine(self, machine_id: str, version: int) -> None:
        """Remove a machine, in the version that was read; its measurements stay."""
        self._ask(
            "DELETE",
            f"/machines/{machine_id}",
            read_nothing,
            headers={"If-Match": f'"{version}"'},
            may_repeat=False,
        )

    def set_machine_file(self, machine_id: str, machine_file: Json) -> MachineRecord:
        """Replace the machine file of a machine. Moves nothing."""
        return self._ask(
            "PUT",
            f"/machines/{machine_id}/machine-file",
            body={"machine_file": machine_file},
        )

    def set_machine_devices(self, machine_id: str, **devices: Any) -> MachineRecord:
        """Choose drivers and options of a machine. Moves nothing."""
        return self._ask("PUT", f"/machines/{machine_id}/devices", body=devices)

    def get_machine_history(self, machine_id: str, **query: Any) -> Json:
        """A quantity over all calibrations; `quantity`, `position`."""
        return self._ask("GET", f"/machines/{machine_id}/history", query=query)

    def get_machine_changes(
        self, machine_id: str, since: str, until: str | None = None
    ) -> Json:
        """Changes since the calibration of a job, with their significance.

        until : job of the later calibration; None for the newest usable one
        """
        query = {"since": since, "until": until}
        return self._ask("GET", f"/machines/{machine_id}/changes", query=query)

    def get_machine_temperature(self, machine_id: str, **query: Any) -> Json:
        """Dependence of its errors on temperature; `sensor`, `job`, …."""
        return self._ask("GET", f"/machines/{machine_id}/temperature", query=query)

    def get_machine_standing(self, machine_id: str) -> Json:
        """Whether a machine is within its tolerance and unchanged."""
        return self._ask("GET", f"/machines/{machine_id}/standing")

    def compare_machines(self, **query: Any) -> Json:
        """Compare machines by their newest calibrations; `machine`, `quantity`."""
        return self._ask("GET", "/machines:compare", query=query)

    def get_verification(self, job_id: str) -> Json:
        """Content of `verification.json`."""
        return self._ask("GET", f"/jobs/{job_id}/verification")

    def issue_certificate(self, job_id: str, **order: Any) -> Json:
        """Issue a certificate of a result; `identity` and the rest as documented."""
        return self._ask(
            "POST", f"/jobs/{job_id}/certificates", body=order, may_repeat=False
        )

    def preview_certificate(self, job_id: str, **order: Any) -> Json:
        """What `issue_certificate` would make, as `html`; keeps nothing."""
        return self._ask("POST", f"/jobs/{job_id}/certificates/preview", body=order)

    def list_certificates(self, job_id: str) -> list[Json]:
        """Certificates of a result, the oldest first."""
        return self._ask("GET", f"/jobs/{job_id}/certificates", read_items)

    def stop(self) -> Json:
        """Stop all motion. It is no emergency stop."""
        return self._ask("POST", "/stop")

    def get_job_plan(self, job_id: str) -> Json:
        """Rows that a job commands."""
        return self._ask("GET", f"/jobs/{job_id}/plan")

    def get_estimate(self, job_id: str) -> Estimate | None:
        """The newest live estimate; None before the first."""
        return self._ask("GET", f"/jobs/{job_id}/estimate")

    def get_result(self, job_id: str) -> Json:
        """Content of `result.json`."""
        return self._ask("GET", f"/jobs/{job_id}/result")

    def get_error_tables(self, job_id: str) -> ErrorTables:
        """Error tables with their verdict."""
        return self._ask("GET", f"/jobs/{job_id}/result/error-tables.json")

    def get_discovery(self, job_id: str) -> Json:
        """Content of `discovery.json`."""
        return self._ask("GET", f"/jobs/{job_id}/discovery")

    def get_trend(self, job_id: str) -> Json:
        """Content of `trend.json`."""
        return self._ask("GET", f"/jobs/{job_id}/trend")

    def get_reanalysis(self, job_id: str) -> Json:
        """Outcome of every Run that was analysed again."""
        return self._ask("GET", f"/jobs/{job_id}/reanalysis")

    def download(self, address: str) -> bytes:
        """Content of a file by its address, as in links of jobs and Runs."""
        return self._run(ask(Request("GET", address, read_bytes)))

    def create_plan(self, *, idempotency_key: str | None = None, **order: Any) -> Plan:
        """Request a plan; a job with its identifier computes it."""
        return self._create("/plans", order, idempotency_key)

    def get_plan(self, plan_id: str) -> Plan:
        """Present state of a plan."""
        return self._ask("GET", f"/plans/{plan_id}")

    def upload_bundle(self, bundle: Path) -> Run:
        """Upload a zipped measurement bundle."""
        return self._ask("POST", "/runs", upload=bundle, may_repeat=False)

    def get_run(self, run_id: str) -> Run:
        """Record of a Run."""
        return self._ask("GET", f"/runs/{run_id}")

    def make_compensation(self, job_id: str, **order: Any) -> Json:
        """Make the files of a controller; `format` and the rest as documented."""
        return self._ask("POST", f"/jobs/{job_id}/compensations", body=order)

    def wait_for(
        self,
        job_id: str,
        *states: str,
        timeout_s: float | None = None,
        period_s: float = 0.5,
    ) -> Job:
        """The job once it is in one of the states; `succeeded` if none is named.

        Raises JobEnded in another final state, JobNotReached after `timeout_s`.
        """
        return self._run(wait_for(job_id, states, timeout_s, period_s))

    def list_jobs(self, **filters: Any) -> Iterator[Job]:
        """Yield jobs, the newest first; filters are those of `GET /jobs`."""
        yield from self._list("/jobs", filters)

    def list_runs(self, **filters: Any) -> Iterator[Run]:
        """Yield Runs, the newest first; filters are those of `GET /runs`."""
        yield from self._list("/runs", filters)

    def events(
        self, job_id: str | None = None, *, last_event_id: str = ""
    ) -> Iterator[Event]:
        """Yield events of one job or of all, without end.

        A broken stream is reopened and continues after the last stored event. The
        service sends a tick every second: a silent stream counts as broken. Raises
        Problem where the stream is refused, Unreachable where it stays away.
        """
        stream = EventStream(job_id, last_event_id)
        while True:
            pause_s = 0.0
            try:
                with self._http.sse(
                    stream.path, headers=stream.headers, timeout=SILENCE_S
                ) as source:
                    response = source.response
                    if response.status_code >= 400:
                        response.read()
                        stream.refuse(_read_answer(response))
                    for sent in source:
                        yield stream.receive(sent.event, sent.data, sent.id)
                pause_s = stream.count_break("it has ended")
            except httpx2.TransportError as error:
                pause_s = stream.count_break(str(error))
            time.sleep(pause_s)

    def _ask(
        self,
        method: str,
        path: str,
        read: Reader = read_json,
        **content: Any,
    ) -> Any:
        """Answer of a request below the prefix, of which the rest is as in Request."""
        request = Request(method, f"{PREFIX}{path}", read, **content)
        return self._run(ask(request))

    def _create(self, path: str, order: Json, key: str | None) -> Any:
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        return self._ask("POST", path, body=order, headers=headers)

    def _list(self, path: str, filters: Query) -> Iterator[Any]:
        after: str | None = None
        while True:
            page = self._ask("GET", path, query={**filters, "after": after})
            yield from page["items"]
            after = page["next"]
            if after is None:
                return

    def _run(self, steps: Steps[T]) -> T:
        try:
            step = next(steps)
            while True:
                match step:
                    case Pause(duration_s):
                        time.sleep(duration_s)
                        step = next(steps)
                    case Request() as request:
                        try:
                            answer = self._send(request)
                        except Unreachable as error:
                            step = steps.throw(error)
                        else:
                            step = steps.send(answer)
        except StopIteration as end:
            return end.value

    def _send(self, request: Request) -> Answer:
        try:
            with ExitStack() as files:
                upload = request.open_upload(files)
                response = self._http.request(
                    request.method,
                    request.path,
                    params=request.parameters,
                    json=request.body,
                    headers=dict(request.headers),
                    files=upload,
                )
        except httpx2.TransportError as error:
            raise Unreachable(f"{self.address} does not answer: {error}") from error
        return _read_answer(response)

    def _use_token(self, token: str | None) -> None:
        self._http.headers.pop("Authorization", None)
        if token:
            self._http.headers["Authorization"] = f"Bearer {token}"


def _read_answer(response: httpx2.Response) -> Answer:
    return Answer(response.status_code, response.headers, response.content)
