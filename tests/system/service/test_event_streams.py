"""Server-sent events and WebSockets over a real socket, and who may hear them."""

import asyncio
import json
import struct
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from api_builders import FOREIGN, arm_over_http
from described_answers import read_document
from scripted_cell import wait_until
from truepath.catalogue.errors import StorageFull, StorageUnavailable
from truepath.catalogue.job import Job, JobEvent, JobKind, encode_job
from truepath.catalogue.transitions import State
from truepath.machines.cell_status import NOT_READ
from truepath.machines.cell_supervisor import CHUNK, CHUNKS, SampleFeed
from truepath.measurement.messages import BlockRecorded
from truepath.service.api.routes import events
from truepath.users.roles import Role
from truepath_drivers.interfaces.records import TrackerSamples

pytestmark = pytest.mark.database
EVENTS = "/api/v1/events"


@dataclass
class Event:
    type: str
    data: dict
    id: str | None = None


def parse(lines):
    fields: dict[str, str] = {}
    for line in lines:
        if line and not line.startswith(":"):
            name, _, value = line.partition(": ")
            fields[name] = value
        elif fields:
            yield Event(fields["event"], json.loads(fields["data"]), fields.get("id"))
            fields = {}


@contextmanager
def stream(client, path=EVENTS, last=None):
    headers = {} if last is None else {"Last-Event-ID": last}
    with client.stream("GET", path, headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield parse(answer.iter_lines())


def read(found, count, types=("job",)):
    chosen = (event for event in found if event.type in types)
    return list(islice(chosen, count))


def advance(service, job_id, *states):
    for state in states:
        service.store.change(job_id, lambda job, to=state: replace(job, state=to))


@pytest.fixture
def job(service):
    return service.store.create(Job(JobKind.ANALYSE))[0]


def test_a_client_that_comes_back_hears_everything_once(live, service, job):
    for odd in ("nonsense", "-3", "9" * 30, "999999", "²"):
        with stream(live, last=odd.encode()) as found:
            (anew,) = read(found, 1)
        assert anew.data["id"] == job.id
        wait_until(lambda: not events.open_streams, "the stream's end")
    with stream(live) as found:
        (now,) = read(found, 1)
        assert (now.data["id"], now.data["state"]) == (job.id, "queued")
        body = {"tracker_mm": [[1.0, 2.0, 3.0]], "axes": [1.0]}
        service.event_bus.publish(JobEvent("live", job.id, body))
        (seen,) = read(found, 1, ("live",))  # for now only: it has no identifier
        assert (seen.data, seen.id) == ({"job_id": job.id, **body}, None)
        advance(service, job.id, State.RUNNING)
        (last,) = read(found, 1)
    advance(service, job.id, State.PAUSED, State.RUNNING)
    with stream(live, last=last.id) as found:
        missed = read(found, 2)
        advance(service, job.id, State.SUCCEEDED)
        (after,) = read(found, 1)
    heard = [last, *missed, after]
    states = [event.data["state"] for event in heard]
    assert states == ["running", "paused", "running", "succeeded"]
    assert [int(event.id) for event in heard] == [2, 3, 4, 5]
    assert after.data["result"]["report_html"].endswith("/result/report.html")


def test_many_missed_events_come_in_order(live, service, job, monkeypatch):
    monkeypatch.setattr("truepath.catalogue.store._MOST_EVENTS", 20)
    for _ in range(30):
        advance(service, job.id, State.RUNNING, State.PAUSED)
    with stream(live, last="1") as found:
        missed = read(found, 60)
    assert [int(event.id) for event in missed] == list(range(2, 62))


@pytest.mark.parametrize(
    ("topics", "chosen", "count"),
    [  # nothing moves: of progress it is not known which machine it is of
        ("jobs/{1}/events", [1], 3),
        ("events?topics=job:{1}", [1], 3),
        ("events?topics=machine:default", [0], 2),
        ("events?topics=machine:default,job:{2}", [0, 2], 5),
        ("events?topics=", [0, 1, 2], 9),
    ],
)
def test_a_stream_carries_all_of_its_topics_alone(live, service, topics, chosen, count):
    """One job of each of two machines, and one of none."""
    jobs = [Job(JobKind.ANALYSE, machine=name) for name in ("default", "mill", None)]
    ids = [service.store.create(job)[0].id for job in jobs]
    wanted = [ids[k] for k in chosen]
    path = f"/api/v1/{topics.format(*ids)}"
    with stream(live, path) as found:
        now = read(found, len(wanted))
        assert sorted(event.data["id"] for event in now) == wanted
        for job_id in ids:
            body = encode_job(service.store.get(job_id))
            service.event_bus.publish(JobEvent("job", job_id, body))
            service.event_bus.publish(JobEvent("progress", job_id, {"stage": "x"}))
            advance(service, job_id, State.RUNNING)
        heard = read(found, count, ("job", "progress"))
        told = {event.data.get("id", event.data.get("job_id")) for event in heard}
        assert told == set(wanted)
        progress = [event for event in heard if event.type == "progress"]
        assert len(progress) == count - 2 * len(wanted)
    with stream(live, path, last="1") as found:
        later = [e.data["id"] for e in read(found, len(wanted)) if e.data]
    assert set(later) <= set(wanted)


def test_other_machines_and_unknown_topics_are_left_out(live, service, is_problem):
    with stream(live, f"{EVENTS}?topics=machine:default") as found:
        read(found, 1, ("tick",))
        for machine, type_ in product(("mill", "default"), ("condition", "machine")):
            body = {"machine": machine, "level": "false"}
            service.event_bus.publish(JobEvent(type_, None, body))
        heard = read(found, 2, ("condition", "machine"))
    told = [(event.type, event.data["machine"]) for event in heard]
    assert told == [("condition", "default"), ("machine", "default")]
    for topics in ("jobs", "job:", "tool:1", "machine:nobody", "job:nobody", "a,", ","):
        answer = live.get(f"{EVENTS}?topics={topics}")
        assert topics.split(",")[0] in is_problem(answer, 422, "bad-input")["detail"]


def test_a_tick_comes_every_second_until_the_service_ends(live, service):
    begun = time.monotonic()
    with stream(live) as found:
        ticks = read(found, 3, ("tick",))
        assert 1.5 < time.monotonic() - begun < 6
        begun = time.monotonic()
        service.end_streams()
        assert read(found, 1, ("never",)) == []
    assert time.monotonic() - begun < 1.0
    assert [tick.data["last_event_id"] for tick in ticks] == [0, 0, 0]
    assert ticks[0].data["time"] < ticks[1].data["time"]


@pytest.mark.fault_row(27)
def test_what_a_full_disk_does_not_take_is_told(live, make_cell, order, service):
    keep = service.store.change

    def full(*_, **__):
        raise StorageFull("the catalogue cannot be written: disk is full")

    with stream(live) as found:
        read(found, 1, ("tick",))
        job = live.post("/api/v1/jobs", json=order).json()
        address = f"/api/v1/jobs/{job['id']}"
        while (now := read(found, 1)[0]).data["state"] != "ready":
            pass
        arm_over_http(live, now.data)
        assert make_cell.cell.begun.wait(5)
        service.store.change = full
        make_cell.cell.say_state("paused")
        while (told := read(found, 1)[0]).data["state"] != "failed":
            pass
        shown = live.get(address).json()
        (listed,) = live.get("/api/v1/jobs").json()["items"]
        service.store.change = keep
        while (stored := read(found, 1)[0]).id is None:
            pass
    assert told.id is None
    for job in (told.data, shown, listed, stored.data):
        assert (job["state"], job["error"]["code"]) == ("failed", "storage-full")
    assert "Free some space" in shown["error"]["action"]


@pytest.mark.fault_row(32)
def test_a_slow_client_keeps_newest_live_and_every_kept_event(live, service, job):
    with stream(live) as found:
        read(found, 1)
        for number in range(20_000):
            body = {"number": number, "pad": "x" * 99}
            service.event_bus.publish(JobEvent("live", job.id, body))
        advance(service, job.id, State.RUNNING)
        service.event_bus.publish(JobEvent("live", job.id, {"number": 20_000}))
        numbers, states = [0], []
        while numbers[-1] < 20_000 or not states:
            (event,) = read(found, 1, ("live", "job"))
            if event.type == "live":
                numbers.append(event.data["number"])
            else:
                states.append(event.data["state"])
    assert numbers == sorted(numbers)
    assert len(numbers) < 20_002
    assert states == ["running"]


def test_a_stream_too_many_is_refused_until_one_ends(live, service, is_problem):
    with stream(live) as found, stream(live):
        read(found, 1, ("tick",))
        assert len(service.event_bus._listeners) == 2
        is_problem(live.get(EVENTS), 429, "too-many-streams")
    wait_until(lambda: not events.open_streams, "the streams' end")
    wait_until(lambda: not service.event_bus._listeners, "the listeners' end")
    with stream(live) as found:
        assert read(found, 1, ("tick",))


def test_a_stream_ends_with_its_session(live, service, monkeypatch):
    def away(_):
        raise StorageUnavailable("the catalogue is away")

    with stream(live) as found:
        read(found, 1, ("tick",))
        monkeypatch.setattr(service.access, "identify", away)
        assert len(read(found, 2, ("tick",))) == 2
        monkeypatch.setattr(service.access, "identify", lambda _: None)
        begun_s = time.monotonic()
        assert read(found, 99, ("never",)) == []
    assert time.monotonic() - begun_s < 5.0
    assert not service.closing.is_set()


def test_notices_after_the_loop_has_ended_are_harmless(service):
    async def subscribe():
        return events.Subscription(service, events.Topics(), lambda: True)

    subscription = asyncio.run(subscribe())
    event = JobEvent("live", None, {})
    thread = threading.Thread(target=subscription.put, args=(event,))
    thread.start()
    thread.join()


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
