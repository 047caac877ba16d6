"""The open channel that takes a stop, and streams that a guard stands before."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from dataclasses import replace

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from described_answers import read_document
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.machines.cell_status import NOT_READ
from truepath.users.roles import Role

API = "/api/v1"
ELSEWHERE = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}


def socket_of(client, path):
    """The address of a WebSocket of the service that a client asks."""
    return str(client.base_url).replace("http", "ws", 1).rstrip("/") + API + path


@pytest.mark.fault_row(46)
@pytest.mark.fault_row(47)
@pytest.mark.parametrize(
    ("headers", "word"),
    [
        ({}, "stop"),
        (ELSEWHERE, ""),
        (ELSEWHERE, b"\x00"),
        ({"Host": "evil.example"}, "checks"),
    ],
)
def test_every_message_of_the_open_channel_is_a_stop(live, service, headers, word):
    running = service.store.create(Job(JobKind.ANALYSE))[0]
    with connect(socket_of(live, "/stop"), additional_headers=headers) as channel:
        channel.send("check")
        assert json.loads(channel.recv(timeout=10)) == {
            "jobs": [],
            "machines": [
                {"machine": "default", "stopped": "unknown", "says": NOT_READ}
            ],
        }
        assert service.store.get(running.id).state == "queued"
        channel.send(word)
        stopped = json.loads(channel.recv(timeout=10))
    assert [one["machine"] for one in stopped["machines"]] == ["default"]
    service.access.close()
    told = [row.entry.what for row in service.access.audit_log.read()]
    assert told == [f"POST {API}/stop"]


def test_a_channel_too_many_takes_the_place_of_the_oldest(live, monkeypatch):
    monkeypatch.setattr("truepath.service.api.routes.stopping.MOST_CHANNELS", 1)
    with connect(socket_of(live, "/stop")) as old:
        old.send("check")
        old.recv(timeout=10)
        with connect(socket_of(live, "/stop/")) as new:
            new.send("check")
            assert "machines" in new.recv(timeout=10)
            with pytest.raises(ConnectionClosed, match="1013"):
                old.recv(timeout=10)


def test_a_page_of_another_site_is_told_of_nothing_that_happens(
    live, service, is_problem
):
    job = service.store.create(Job(JobKind.ANALYSE))[0]
    streams = {f"{API}/events", f"{API}/jobs/{{job_id}}/events"}
    assert streams == {
        path
        for path, operations in read_document()["paths"].items()
        for answer in operations.get("get", {}).get("responses", {}).values()
        if "text/event-stream" in answer.get("content", {})
    }
    for headers in (
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
    ):
        for path in streams:
            address = path.replace("{job_id}", job.id)
            with live.stream("GET", address, headers=headers) as answer:
                answer.read()
                is_problem(answer, 403, "cross-site")
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(socket_of(live, "/events"), additional_headers=headers),
        ):
            pass


def test_events_come_over_a_web_socket_as_in_a_stream(live, service):
    def read(query):
        with connect(socket_of(live, f"/events{query}")) as socket:
            while True:
                event = json.loads(socket.recv(timeout=10))
                yield event
                if event["event"] == "tick":
                    return

    job = service.store.create(Job(JobKind.ANALYSE))[0]
    now, tick = read("")
    assert (now["event"], now["data"]["id"], now["id"]) == ("job", job.id, "1")
    service.store.change(job.id, lambda known: replace(known, state=State.RUNNING))
    missed, _ = read(f"?last_event_id={tick['data']['last_event_id']}")
    assert (missed["id"], missed["data"]["state"]) == ("2", "running")
    for refused in ("?topics=nonsense", "?topics=job:nobody"):
        with pytest.raises(InvalidStatus, match="422"):
            next(read(refused))


@pytest.fixture
def with_users(service, live, access, monkeypatch):
    """A viewer who has logged in; returns the headers that tell so."""
    access.accounts.add("ada", Role.ADMINISTRATOR, "a long sentence is easy")
    access.accounts.add("vera", Role.VIEWER, "a long sentence is easy")
    monkeypatch.setattr(service.access, "rules", access.rules)
    return {"Authorization": f"Bearer {access.tokens.open_session('vera')}"}


def test_the_stream_of_a_removed_user_ends_within_a_second(live, service, with_users):
    with live.stream("GET", f"{API}/events", headers=with_users) as answer:
        lines = answer.iter_lines()
        for _ in range(2):  # the session was asked for just now
            next(line for line in lines if line == "event: tick")
        service.access.accounts.remove("vera")
        begun_s = time.monotonic()
        for _ in lines:
            pass
        assert time.monotonic() - begun_s < 0.9


@pytest.mark.parametrize("path", ["/events", "/machines/current/live"])
def test_a_socket_of_a_removed_user_ends_within_a_second(
    live, service, with_users, path
):
    with connect(socket_of(live, path), additional_headers=with_users) as socket:
        time.sleep(0.2)
        service.access.accounts.remove("vera")
        begun_s = time.monotonic()
        with suppress(ConnectionClosed):
            while time.monotonic() - begun_s < 5:
                socket.recv(timeout=5)
    assert time.monotonic() - begun_s < 0.9
