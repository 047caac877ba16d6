"""Server-sent events over a real socket."""

import asyncio
import json
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice, product

import pytest

from arming import arm_over_http
from scripted_cell import wait_until
from truepath.catalogue.errors import StorageFull, StorageUnavailable
from truepath.catalogue.job import Job, JobEvent, JobKind, encode_job
from truepath.catalogue.transitions import State
from truepath.service.api.routes import events
from truepath.service.api.routes.events import Topics

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
    monkeypatch.setattr("truepath.catalogue.store.store._MOST_EVENTS", 20)
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
            service.event_bus.publish(
                JobEvent("live", job.id, {"number": number, "pad": "x" * 99})
            )
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
    assert time.monotonic() - begun_s < 0.9
    assert not service.closing.is_set()


def test_notices_after_the_loop_has_ended_are_harmless(service):
    async def subscribe():
        return events.Subscription(service, Topics(), lambda: True)

    subscription = asyncio.run(subscribe())
    event = JobEvent("live", None, {})
    thread = threading.Thread(target=subscription.put, args=(event,))
    thread.start()
    thread.join()
