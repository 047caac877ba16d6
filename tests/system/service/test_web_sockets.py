"""WebSockets of the service: the stop, events, every sample; and who may hear them."""

import json
import struct
import time
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from api_builders import FOREIGN
from described_answers import read_document
from scripted_cell import wait_until
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.machines.cell_status import NOT_READ
from truepath.machines.sample_feed import CHUNK, CHUNKS, SampleFeed
from truepath.measurement.messages import BlockRecorded
from truepath.users.roles import Role
from truepath_drivers.interfaces.records import TrackerSamples

API = "/api/v1"
SAMPLES = "/machines/current/live"
ELSEWHERE = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}


@pytest.fixture
def open_socket(live):
    base = str(live.base_url).replace("http", "ws", 1).rstrip("/") + API

    def opened(path, headers=None):
        return connect(base + path, additional_headers=headers)

    return opened


@pytest.mark.fault_row(46)
@pytest.mark.fault_row(47)
@pytest.mark.parametrize(
    ("headers", "word"),
    [({}, "stop"), (ELSEWHERE, ""), (ELSEWHERE, b"\x00"), ({"Host": "a.b"}, "checks")],
)
def test_every_message_of_the_channel_is_a_stop(open_socket, service, headers, word):
    running = service.store.create(Job(JobKind.ANALYSE))[0]
    with open_socket("/stop", headers) as channel:
        channel.send("check")
        machine = {"machine": "default", "stopped": "unknown", "says": NOT_READ}
        told = {"jobs": [], "machines": [machine]}
        assert json.loads(channel.recv(timeout=10)) == told
        assert service.store.get(running.id).state == "queued"
        channel.send(word)
        stopped = json.loads(channel.recv(timeout=10))
    assert [one["machine"] for one in stopped["machines"]] == ["default"]
    service.access.close()
    told = [row.entry.what for row in service.access.audit_log.read()]
    assert told == [f"POST {API}/stop"]


def test_a_channel_too_many_takes_the_place_of_the_oldest(open_socket, monkeypatch):
    monkeypatch.setattr("truepath.service.api.routes.stopping.MOST_CHANNELS", 1)
    with open_socket("/stop") as old:
        old.send("check")
        old.recv(timeout=10)
        with open_socket("/stop/") as new:
            new.send("check")
            assert "machines" in new.recv(timeout=10)
            with pytest.raises(ConnectionClosed, match="1013"):
                old.recv(timeout=10)


def test_a_page_of_another_site_hears_nothing(live, open_socket, service, is_problem):
    job = service.store.create(Job(JobKind.ANALYSE))[0]
    streams = {f"{API}/events", f"{API}/jobs/{{job_id}}/events"}
    assert streams == {
        path
        for path, operations in read_document()["paths"].items()
        for answer in operations.get("get", {}).get("responses", {}).values()
        if "text/event-stream" in answer.get("content", {})
    }
    for headers in FOREIGN:
        for path in streams:
            address = path.replace("{job_id}", job.id)
            with live.stream("GET", address, headers=headers) as answer:
                answer.read()
                is_problem(answer, 403, "cross-site")
        for path in ("/events", SAMPLES):
            with pytest.raises(InvalidStatus, match="403"):
                open_socket(path, headers)
    with pytest.raises(InvalidStatus, match="403"):
        open_socket("/machines/nobody/live")
    assert not service.machines.first.cell.samples._queues


def test_events_come_over_a_web_socket_as_in_a_stream(open_socket, service):
    def read(query):
        with open_socket(f"/events{query}") as socket:
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


@pytest.mark.parametrize("path", ["/events", SAMPLES, "/machines/default/live"])
def test_a_socket_ends_with_a_session(open_socket, service, access, monkeypatch, path):
    for name, role in (("ada", Role.ADMINISTRATOR), ("vera", Role.VIEWER)):
        access.accounts.add(name, role, "a long sentence is easy")
    monkeypatch.setattr(service.access, "rules", access.rules)
    for known in ({}, {"Authorization": "Bearer wrong"}):
        with pytest.raises(InvalidStatus):
            open_socket(path, known)
    logged_in = {"Authorization": f"Bearer {access.tokens.open_session('vera')}"}
    with open_socket(path, logged_in) as socket:
        time.sleep(0.2)
        service.access.accounts.remove("vera")
        begun_s = time.monotonic()
        with suppress(ConnectionClosed):
            while time.monotonic() - begun_s < 5:
                socket.recv(timeout=5)
    assert time.monotonic() - begun_s < 0.9


def make_samples(first, count):
    number = np.arange(first, first + count)
    position_mm = number[:, None] * np.array([1.0, 0.5, -2.0])
    status = np.where(number % 10 == 9, 300, 0)
    return TrackerSamples(number, number / 500.0, position_mm, status)


def decode(frame):
    """Read a frame as the document describes it, without code of the service."""
    magic, version, count, dropped = struct.unpack_from("<4sHHI", frame)
    assert (magic, version, len(frame)) == (b"TPLV", 1, 12 + 33 * count)
    assert dropped == 0
    return list(struct.iter_unpack("<4dB", frame[12:]))


def test_every_recorded_sample_comes_in_small_frames(open_socket, service, make_cell):
    feed = service.machines.first.cell.samples
    with open_socket(SAMPLES) as socket:
        wait_until(lambda: feed._queues, "the subscription")
        make_cell.cell.say(BlockRecorded(make_samples(0, 50)))
        frames = [decode(socket.recv(timeout=20)) for _ in range(3)]
        service.end_streams()
        with pytest.raises(ConnectionClosed, match="1001"):
            socket.recv(timeout=20)
    assert [len(rows) for rows in frames] == [20, 20, 10]
    rows = [row for rows in frames for row in rows]
    assert rows[7] == (7 / 500.0, 7.0, 3.5, -14.0, 0)
    assert [row[4] for row in rows] == [255 if n % 10 == 9 else 0 for n in range(50)]
    wait_until(lambda: not feed._queues, "the end of the subscription")


@pytest.mark.fault_row(32)
def test_who_is_slow_loses_the_oldest_and_is_told_how_many():
    feed = SampleFeed()
    slow, quick = feed.subscribe(lambda: None), feed.subscribe(lambda: None)
    taken = []
    for block in range(CHUNKS + 7):
        feed.publish(make_samples(block * CHUNK, CHUNK))
        taken.append(quick.pop_oldest())
    assert [chunk.sequence[0] // CHUNK for chunk, _ in taken] == [*range(CHUNKS + 7)]
    chunk, dropped = slow.pop_oldest()
    assert (chunk.sequence[0], dropped) == (7 * CHUNK, 7 * CHUNK)
    assert quick.pop_oldest() == (None, 0)
