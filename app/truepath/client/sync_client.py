# Written by docs/write_sync_client.py from async_client.py; change that.
"""The client for programs that wait for each answer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self, TypeVar

import httpx2

from truepath.client import requests
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
from truepath.client.requests import Answer, Filters, Request, make_tls_context
from truepath.client.steps import Pause, Steps, arm, ask, read_page, wait_for

T = TypeVar("T")


class Client:
    """Speaks to one service at `http://host:port`.

    token : of a session or an API key, where the service asks for a log-in
    verify : of HTTPS: a file of certificates to trust, beside those of the system
    transport : in place of the network, for tests

    Raises Problem where the service refuses, Unreachable where nobody answers.
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
        """Return the client itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the connections."""
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def log_in(self, name: str, password: str) -> Json:
        """Log in; the session's token goes with every request from now on."""
        session = self._run(ask(requests.log_in(name, password)))
        self._use_token(session["token"])
        return session

    def log_out(self) -> None:
        """End the session."""
        self._run(ask(requests.log_out()))
        self._use_token(None)

    def get_system(self) -> System:
        """Return what the service is and what holds the machine."""
        return self._run(ask(requests.get_system()))

    def connect(self, machine_id: str = "current") -> Json:
        """Open the ports of a machine and return who answers. Moves nothing."""
        return self._run(ask(requests.connect(machine_id)))

    def get_machine(self) -> Json:
        """Return the machine file and who has answered."""
        return self._run(ask(requests.get_machine()))

    def list_conditions(self, machine_id: str = "current") -> list[Condition]:
        """Return what has to be so before the machine moves, as it is now."""
        return self._run(ask(requests.list_conditions(machine_id)))

    def create_job(self, *, idempotency_key: str | None = None, **order: Any) -> Job:
        """Take on a job; `kind` and the rest are those of `POST /jobs`.

        One call makes one job, however often its request has to be sent; a key of
        your own makes one job of several calls.
        """
        return self._run(ask(requests.create_job(order, idempotency_key)))

    def get_job(self, job_id: str) -> Job:
        """Return a job."""
        return self._run(ask(requests.get_job(job_id)))

    def prepare_arming(self, job_id: str) -> Arming:
        """Return what a job will move, to be looked at, and the token to arm it."""
        return self._run(ask(requests.prepare_arming(job_id)))

    def arm(self, job: Job, token: str | None = None) -> Job:
        """Let a job move the machine, as it was read. Raises StaleVersion.

        token : of an arming that was looked at; without it one is asked for and used
        """
        return self._run(arm(job, token))

    def pause(self, job_id: str) -> Job:
        """Hold the feed."""
        return self._run(ask(requests.pause(job_id)))

    def resume(self, job: Job) -> Job:
        """Go on after a hold, as the job was read. Raises StaleVersion."""
        return self._run(ask(requests.resume(job)))

    def cancel(self, job_id: str) -> Job:
        """End a job in order; the line or point under way is finished."""
        return self._run(ask(requests.cancel(job_id)))

    def abort(self, job_id: str) -> Job:
        """End a job now."""
        return self._run(ask(requests.abort(job_id)))

    def acknowledge(self, job_id: str) -> Job:
        """Prepare a measurement that was cut short to go on. Moves nothing."""
        return self._run(ask(requests.acknowledge(job_id)))

    def take_control(self, job_id: str) -> Job:
        """Take over who may arm and resume a job. Moves nothing."""
        return self._run(ask(requests.take_control(job_id)))

    def rename_job(self, job_id: str, **naming: str) -> Job:
        """Change `name` or `note` of a job; its version stays."""
        return self._run(ask(requests.rename_job(job_id, naming)))

    def rename_run(self, run_id: str, **naming: str) -> Run:
        """Change `name` or `note` of a Run."""
        return self._run(ask(requests.rename_run(run_id, naming)))

    def delete_job(self, job_id: str) -> None:
        """Delete a job that has ended, with its answer."""
        self._run(ask(requests.delete_job(job_id)))

    def delete_run(self, run_id: str, *, with_results: bool = False) -> None:
        """Delete a Run, and where that is asked the results that depend on it."""
        self._run(ask(requests.delete_run(run_id, with_results=with_results)))

    def list_machines(self) -> list[Machine]:
        """Return all machines, those that the service drives first."""
        return self._run(ask(requests.list_machines()))

    def get_machine_record(self, machine_id: str) -> MachineRecord:
        """Return a machine of the registry, with its configuration and its versions."""
        return self._run(ask(requests.get_machine_record(machine_id)))

    def add_machine(self, machine_id: str, **content: Any) -> MachineRecord:
        """Add a machine; `machine_file`, `identity` are those of `POST /machines`."""
        return self._run(ask(requests.add_machine(machine_id, content)))

    def change_machine(self, machine_id: str, **change: Any) -> MachineRecord:
        """Change who a machine is, its tolerance or its reference; the rest stays."""
        return self._run(ask(requests.change_machine(machine_id, change)))

    def remove_machine(self, machine_id: str, version: int) -> None:
        """Drive a machine no more, as it was read; what was measured of it stays."""
        self._run(ask(requests.remove_machine(machine_id, version)))

    def set_machine_file(self, machine_id: str, machine_file: Json) -> MachineRecord:
        """Describe a machine anew by its machine file. Moves nothing."""
        return self._run(ask(requests.set_machine_file(machine_id, machine_file)))

    def set_machine_devices(self, machine_id: str, **devices: Any) -> MachineRecord:
        """Choose drivers and options of a machine. Moves nothing."""
        return self._run(ask(requests.set_machine_devices(machine_id, devices)))

    def get_machine_history(self, machine_id: str, **query: Any) -> Json:
        """Return a quantity over all calibrations; `quantity`, `position`."""
        return self._run(ask(requests.get_machine_history(machine_id, query)))

    def get_machine_changes(
        self, machine_id: str, since: str, until: str | None = None
    ) -> Json:
        """Return what has changed since the calibration of a job, and how surely.

        until : job of the later calibration; None for the newest usable one
        """
        query = {"since": since, "until": until}
        return self._run(ask(requests.get_machine_changes(machine_id, query)))

    def get_machine_temperature(self, machine_id: str, **query: Any) -> Json:
        """Return how its errors depend on temperature; `sensor`, `job`, …"""
        return self._run(ask(requests.get_machine_temperature(machine_id, query)))

    def get_machine_standing(self, machine_id: str) -> Json:
        """Return whether a machine is within its tolerance and as it was."""
        return self._run(ask(requests.get_machine_standing(machine_id)))

    def compare_machines(self, **query: Any) -> Json:
        """Compare machines by their newest calibrations; `machine`, `quantity`."""
        return self._run(ask(requests.compare_machines(query)))

    def get_verification(self, job_id: str) -> Json:
        """Return `verification.json`."""
        return self._run(ask(requests.get_document(job_id, "verification")))

    def issue_certificate(self, job_id: str, **order: Any) -> Json:
        """Issue a certificate of a result; `identity` and the rest as documented."""
        return self._run(ask(requests.issue_certificate(job_id, order)))

    def list_certificates(self, job_id: str) -> list[Json]:
        """Return the certificates of a result, the oldest first."""
        return self._run(ask(requests.list_certificates(job_id)))

    def stop(self) -> Json:
        """Stop all motion. It is no emergency stop."""
        return self._run(ask(requests.stop()))

    def get_job_plan(self, job_id: str) -> Json:
        """Return what a job commands."""
        return self._run(ask(requests.get_job_plan(job_id)))

    def get_estimate(self, job_id: str) -> Estimate | None:
        """Return the newest live estimate; None while there is none yet."""
        return self._run(ask(requests.get_estimate(job_id)))

    def get_result(self, job_id: str) -> Json:
        """Return `result.json`."""
        return self._run(ask(requests.get_document(job_id, "result")))

    def get_error_tables(self, job_id: str) -> ErrorTables:
        """Return the error tables with the verdict on them."""
        return self._run(ask(requests.get_error_tables(job_id)))

    def get_discovery(self, job_id: str) -> Json:
        """Return `discovery.json`."""
        return self._run(ask(requests.get_document(job_id, "discovery")))

    def get_trend(self, job_id: str) -> Json:
        """Return `trend.json`."""
        return self._run(ask(requests.get_document(job_id, "trend")))

    def get_reanalysis(self, job_id: str) -> Json:
        """Return what has become of every Run that was analysed again."""
        return self._run(ask(requests.get_document(job_id, "reanalysis")))

    def download(self, address: str) -> bytes:
        """Return a file by its address, as links of jobs and Runs state it."""
        return self._run(ask(requests.download(address)))

    def create_plan(self, *, idempotency_key: str | None = None, **order: Any) -> Plan:
        """Ask for a plan; a job of its identifier computes it."""
        return self._run(ask(requests.create_plan(order, idempotency_key)))

    def get_plan(self, plan_id: str) -> Plan:
        """Return a plan."""
        return self._run(ask(requests.get_plan(plan_id)))

    def upload_bundle(self, bundle: Path) -> Run:
        """Take in a zipped measurement bundle."""
        return self._run(ask(requests.upload_bundle(bundle)))

    def get_run(self, run_id: str) -> Run:
        """Return a Run."""
        return self._run(ask(requests.get_run(run_id)))

    def make_compensation(self, job_id: str, **order: Any) -> Json:
        """Make the files of a controller; `format` and the rest as documented."""
        return self._run(ask(requests.make_compensation(job_id, order)))

    def wait_for(
        self,
        job_id: str,
        *states: str,
        timeout_s: float | None = None,
        period_s: float = 0.5,
    ) -> Job:
        """Return the job once it is in one of the states, `succeeded` if none is named.

        Raises JobEnded in another final state, JobNotReached after `timeout_s`.
        """
        return self._run(wait_for(job_id, states, timeout_s, period_s))

    def list_jobs(self, **filters: Any) -> Iterator[Job]:
        """Yield jobs, the newest first; filters are those of `GET /jobs`."""
        yield from self._list(requests.list_jobs, filters)

    def list_runs(self, **filters: Any) -> Iterator[Run]:
        """Yield Runs, the newest first; filters are those of `GET /runs`."""
        yield from self._list(requests.list_runs, filters)

    def events(
        self, job_id: str | None = None, *, last_event_id: str = ""
    ) -> Iterator[Event]:
        """Yield what happens, of one job or of all, for as long as it is asked.

        A stream that breaks is opened again and goes on after the last kept event. The
        service ticks every second: one that is silent is taken for broken.

        Raises Problem where the stream is refused, Unreachable where it stays away.
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

    def _list(self, list_page: Any, filters: Filters) -> Iterator[Any]:
        after: str | None = None
        while True:
            page = self._run(read_page(list_page, filters, after))
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

    def _send(self, request: Request[Any]) -> Answer:
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
