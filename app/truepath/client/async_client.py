"""The client for programs on asyncio."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator
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


class AsyncClient:
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
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        self.address = address.rstrip("/")
        self._http = httpx2.AsyncClient(
            base_url=self.address,
            timeout=timeout_s,
            verify=make_tls_context(verify),
            transport=transport,
        )
        self._use_token(token)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def log_in(self, name: str, password: str) -> Json:
        """Log in; the session's token is sent with every request from now on."""
        session = await self._ask(
            "POST",
            "/session",
            body={"name": name, "password": password},
            may_repeat=False,
        )
        self._use_token(session["token"])
        return session

    async def log_out(self) -> None:
        """End the session."""
        await self._ask("DELETE", "/session", read_nothing)
        self._use_token(None)

    async def get_system(self) -> System:
        """Version and state of the service, and the job that holds the machine."""
        return await self._ask("GET", "/system")

    async def connect(self, machine_id: str = "current") -> Json:
        """Open the ports of a machine and identify its devices. Moves nothing."""
        return await self._ask("POST", f"/machines/{machine_id}:connect")

    async def get_machine(self) -> Json:
        """Machine file, and identities of the connected devices."""
        return await self._ask("GET", "/machines/current")

    async def list_conditions(self, machine_id: str = "current") -> list[Condition]:
        """Conditions for a motion of the machine, with their present state."""
        return await self._ask("GET", f"/machines/{machine_id}/conditions", read_items)

    async def create_job(
        self, *, idempotency_key: str | None = None, **order: Any
    ) -> Job:
        """Create a job; `kind` and further keys are those of `POST /jobs`.

        One call makes one job, however often its request has to be sent; a key of the
        caller makes one job of several calls.
        """
        return await self._create("/jobs", order, idempotency_key)

    async def get_job(self, job_id: str) -> Job:
        """Present state of a job."""
        return await self._ask("GET", f"/jobs/{job_id}")

    async def prepare_arming(self, job_id: str) -> Arming:
        """Summary of the motion of a job, to be checked, and the token to arm it."""
        return await self._ask("POST", f"/jobs/{job_id}/arming")

    async def arm(self, job: Job, token: str | None = None) -> Job:
        """Let a job move the machine, in the version read. Raises StaleVersion.

        token : of an arming that was checked; None requests and uses a new one
        """
        return await self._run(arm(job, token))

    async def pause(self, job_id: str) -> Job:
        """Hold the feed."""
        return await self._ask("POST", f"/jobs/{job_id}/pause")

    async def resume(self, job: Job) -> Job:
        """Resume after a hold, in the version that was read. Raises StaleVersion."""
        return await self._run(ask(move(job, "resume")))

    async def cancel(self, job_id: str) -> Job:
        """End a job in order; its current line or point is finished."""
        return await self._ask("POST", f"/jobs/{job_id}/cancel")

    async def abort(self, job_id: str) -> Job:
        """End a job now."""
        return await self._ask("POST", f"/jobs/{job_id}/abort")

    async def acknowledge(self, job_id: str) -> Job:
        """Prepare an interrupted measurement to resume. Moves nothing."""
        return await self._ask("POST", f"/jobs/{job_id}/acknowledge")

    async def take_control(self, job_id: str) -> Job:
        """Take over the right to arm and resume a job. Moves nothing."""
        return await self._ask("POST", f"/jobs/{job_id}/take-control")

    async def rename_job(self, job_id: str, **naming: str) -> Job:
        """Change `name` or `note` of a job; its version stays."""
        return await self._ask("PATCH", f"/jobs/{job_id}", body=naming)

    async def rename_run(self, run_id: str, **naming: str) -> Run:
        """Change `name` or `note` of a Run."""
        return await self._ask("PATCH", f"/runs/{run_id}", body=naming)

    async def delete_job(self, job_id: str) -> None:
        """Delete a job that has ended, with its answer."""
        await self._ask("DELETE", f"/jobs/{job_id}", read_nothing, may_repeat=False)

    async def delete_run(self, run_id: str, *, with_results: bool = False) -> None:
        """Delete a Run, and with `with_results` the results that depend on it."""
        await self._ask(
            "DELETE",
            f"/runs/{run_id}",
            read_nothing,
            query={"with_results": with_results},
            may_repeat=False,
        )

    async def list_machines(self) -> list[Machine]:
        """All machines, those with devices of this service first."""
        return await self._ask("GET", "/machines", read_items)

    async def get_machine_record(self, machine_id: str) -> MachineRecord:
        """A machine of the registry, with its configuration and its versions."""
        return await self._ask("GET", f"/machines/{machine_id}")

    async def add_machine(self, machine_id: str, **content: Any) -> MachineRecord:
        """Add a machine; `machine_file`, `identity` are those of `POST /machines`."""
        return await self._ask(
            "POST", "/machines", body={"id": machine_id, **content}, may_repeat=False
        )

    async def change_machine(self, machine_id: str, **change: Any) -> MachineRecord:
        """Change identity, tolerance or reference of a machine; the rest stays."""
        return await self._ask("PATCH", f"/machines/{machine_id}", body=change)

    async def remove_machine(self, machine_id: str, version: int) -> None:
        """Remove a machine, in the version that was read; its measurements stay."""
        await self._ask(
            "DELETE",
            f"/machines/{machine_id}",
            read_nothing,
            headers={"If-Match": f'"{version}"'},
            may_repeat=False,
        )

    async def set_machine_file(
        self, machine_id: str, machine_file: Json
    ) -> MachineRecord:
        """Replace the machine file of a machine. Moves nothing."""
        return await self._ask(
            "PUT",
            f"/machines/{machine_id}/machine-file",
            body={"machine_file": machine_file},
        )

    async def set_machine_devices(
        self, machine_id: str, **devices: Any
    ) -> MachineRecord:
        """Choose drivers and options of a machine. Moves nothing."""
        return await self._ask("PUT", f"/machines/{machine_id}/devices", body=devices)

    async def get_machine_history(self, machine_id: str, **query: Any) -> Json:
        """A quantity over all calibrations; `quantity`, `position`."""
        return await self._ask("GET", f"/machines/{machine_id}/history", query=query)

    async def get_machine_changes(
        self, machine_id: str, since: str, until: str | None = None
    ) -> Json:
        """Changes since the calibration of a job, with their significance.

        until : job of the later calibration; None for the newest usable one
        """
        query = {"since": since, "until": until}
        return await self._ask("GET", f"/machines/{machine_id}/changes", query=query)

    async def get_machine_temperature(self, machine_id: str, **query: Any) -> Json:
        """Dependence of its errors on temperature; `sensor`, `job`, …."""
        return await self._ask(
            "GET", f"/machines/{machine_id}/temperature", query=query
        )

    async def get_machine_standing(self, machine_id: str) -> Json:
        """Whether a machine is within its tolerance and unchanged."""
        return await self._ask("GET", f"/machines/{machine_id}/standing")

    async def compare_machines(self, **query: Any) -> Json:
        """Compare machines by their newest calibrations; `machine`, `quantity`."""
        return await self._ask("GET", "/machines:compare", query=query)

    async def get_verification(self, job_id: str) -> Json:
        """Content of `verification.json`."""
        return await self._ask("GET", f"/jobs/{job_id}/verification")

    async def issue_certificate(self, job_id: str, **order: Any) -> Json:
        """Issue a certificate of a result; `identity` and the rest as documented."""
        return await self._ask(
            "POST", f"/jobs/{job_id}/certificates", body=order, may_repeat=False
        )

    async def preview_certificate(self, job_id: str, **order: Any) -> Json:
        """What `issue_certificate` would make, as `html`; keeps nothing."""
        return await self._ask(
            "POST", f"/jobs/{job_id}/certificates/preview", body=order
        )

    async def list_certificates(self, job_id: str) -> list[Json]:
        """Certificates of a result, the oldest first."""
        return await self._ask("GET", f"/jobs/{job_id}/certificates", read_items)

    async def stop(self) -> Json:
        """Stop all motion. It is no emergency stop."""
        return await self._ask("POST", "/stop")

    async def get_job_plan(self, job_id: str) -> Json:
        """Rows that a job commands."""
        return await self._ask("GET", f"/jobs/{job_id}/plan")

    async def get_estimate(self, job_id: str) -> Estimate | None:
        """The newest live estimate; None before the first."""
        return await self._ask("GET", f"/jobs/{job_id}/estimate")

    async def get_result(self, job_id: str) -> Json:
        """Content of `result.json`."""
        return await self._ask("GET", f"/jobs/{job_id}/result")

    async def get_error_tables(self, job_id: str) -> ErrorTables:
        """Error tables with their verdict."""
        return await self._ask("GET", f"/jobs/{job_id}/result/error-tables.json")

    async def get_discovery(self, job_id: str) -> Json:
        """Content of `discovery.json`."""
        return await self._ask("GET", f"/jobs/{job_id}/discovery")

    async def get_trend(self, job_id: str) -> Json:
        """Content of `trend.json`."""
        return await self._ask("GET", f"/jobs/{job_id}/trend")

    async def get_reanalysis(self, job_id: str) -> Json:
        """Outcome of every Run that was analysed again."""
        return await self._ask("GET", f"/jobs/{job_id}/reanalysis")

    async def download(self, address: str) -> bytes:
        """Content of a file by its address, as in links of jobs and Runs."""
        return await self._run(ask(Request("GET", address, read_bytes)))

    async def create_plan(
        self, *, idempotency_key: str | None = None, **order: Any
    ) -> Plan:
        """Request a plan; a job with its identifier computes it."""
        return await self._create("/plans", order, idempotency_key)

    async def get_plan(self, plan_id: str) -> Plan:
        """Present state of a plan."""
        return await self._ask("GET", f"/plans/{plan_id}")

    async def upload_bundle(self, bundle: Path) -> Run:
        """Upload a zipped measurement bundle."""
        return await self._ask("POST", "/runs", upload=bundle, may_repeat=False)

    async def get_run(self, run_id: str) -> Run:
        """Record of a Run."""
        return await self._ask("GET", f"/runs/{run_id}")

    async def make_compensation(self, job_id: str, **order: Any) -> Json:
        """Make the files of a controller; `format` and the rest as documented."""
        return await self._ask("POST", f"/jobs/{job_id}/compensations", body=order)

    async def wait_for(
        self,
        job_id: str,
        *states: str,
        timeout_s: float | None = None,
        period_s: float = 0.5,
    ) -> Job:
        """The job once it is in one of the states; `succeeded` if none is named.

        Raises JobEnded in another final state, JobNotReached after `timeout_s`.
        """
        return await self._run(wait_for(job_id, states, timeout_s, period_s))

    async def list_jobs(self, **filters: Any) -> AsyncIterator[Job]:
        """Yield jobs, the newest first; filters are those of `GET /jobs`."""
        async for item in self._list("/jobs", filters):
            yield item

    async def list_runs(self, **filters: Any) -> AsyncIterator[Run]:
        """Yield Runs, the newest first; filters are those of `GET /runs`."""
        async for item in self._list("/runs", filters):
            yield item

    async def events(
        self, job_id: str | None = None, *, last_event_id: str = ""
    ) -> AsyncIterator[Event]:
        """Yield events of one job or of all, without end.

        A broken stream is reopened and continues after the last stored event. The
        service sends a tick every second: a silent stream counts as broken. Raises
        Problem where the stream is refused, Unreachable where it stays away.
        """
        stream = EventStream(job_id, last_event_id)
        while True:
            pause_s = 0.0
            try:
                async with self._http.sse(
                    stream.path, headers=stream.headers, timeout=SILENCE_S
                ) as source:
                    response = source.response
                    if response.status_code >= 400:
                        await response.aread()
                        stream.refuse(_read_answer(response))
                    async for sent in source:
                        yield stream.receive(sent.event, sent.data, sent.id)
                pause_s = stream.count_break("it has ended")
            except httpx2.TransportError as error:
                pause_s = stream.count_break(str(error))
            await asyncio.sleep(pause_s)

    async def _ask(
        self,
        method: str,
        path: str,
        read: Reader = read_json,
        **content: Any,
    ) -> Any:
        """Answer of a request below the prefix, of which the rest is as in Request."""
        request = Request(method, f"{PREFIX}{path}", read, **content)
        return await self._run(ask(request))

    async def _create(self, path: str, order: Json, key: str | None) -> Any:
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        return await self._ask("POST", path, body=order, headers=headers)

    async def _list(self, path: str, filters: Query) -> AsyncIterator[Any]:
        after: str | None = None
        while True:
            page = await self._ask("GET", path, query={**filters, "after": after})
            for item in page["items"]:
                yield item
            after = page["next"]
            if after is None:
                return

    async def _run(self, steps: Steps[T]) -> T:
        try:
            step = next(steps)
            while True:
                match step:
                    case Pause(duration_s):
                        await asyncio.sleep(duration_s)
                        step = next(steps)
                    case Request() as request:
                        try:
                            answer = await self._send(request)
                        except Unreachable as error:
                            step = steps.throw(error)
                        else:
                            step = steps.send(answer)
        except StopIteration as end:
            return end.value

    async def _send(self, request: Request) -> Answer:
        try:
            with ExitStack() as files:
                upload = request.open_upload(files)
                response = await self._http.request(
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
