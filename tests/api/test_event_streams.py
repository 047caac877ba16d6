"""Server-sent events over a real socket."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest
from arming import arm_over_http
from scripted_cell import wait_until

from truepath.catalogue.errors import StorageFull, StorageUnavailable
from truepath.catalogue.job import Job, JobEvent, JobKind, encode_job
from truepath.catalogue.transitions import State
from truepath.service.api.routes import events
from truepath.service.api.topics import Topics

EVENTS = "/api/v1/events"


@dataclass
class Event:
    type: str
    data: dict
    id: str | None = None


def parse(lines):
    """Yield the events of a stream."""
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
    """Return the next events of some types."""
    chosen = []
    for event in found:
        if event.type in types:
            chosen.append(event)
        if len(chosen) == count:
            return chosen
    return chosen


def advance(service, job_id, *states):
    for state in states:
        service.store.change(job_id, lambda job, to=state: replaced(job, to))


def replaced(job, state):
    return replace(job, state=state)


@pytest.fixture
def job(service):
    return service.store.create(Job(JobKind.ANALYSE))[0]


def test_a_new_client_sees_where_things_stand_then_what_happens(live, service, job):
    with stream(live) as found:
        (now,) = read(found, 1)
        assert (now.data["id"], now.data["state"]) == (job.id, "queued")
        advance(service, job.id, State.RUNNING, State.SUCCEEDED)
        later = read(found, 2)
    assert [event.data["state"] for event in later] == ["running", "succeeded"]
    assert [int(event.id) for event in later] == [2, 3]
    assert later[-1].data["result"]["report_html"].endswith("/result/report.html")


def test_a_client_that_comes_back_misses_nothing_and_hears_nothing_twice(
    live, service, job
):
    with stream(live) as found:
        last = read(found, 1)[0].id
    advance(service, job.id, State.RUNNING, State.PAUSED, State.RUNNING)
    with stream(live, last=last) as found:
        missed = read(found, 3)
        advance(service, job.id, State.SUCCEEDED)
        (after,) = read(found, 1)
    assert [event.data["state"] for event in missed] == ["running", "paused", "running"]
    ids = [int(event.id) for event in [*missed, after]]
    assert ids == [2, 3, 4, 5]


def test_many_missed_events_come_in_order(live, service, job):
    def flip(job):
        return replaced(job, State.PAUSED if job.state == "running" else State.RUNNING)

    for _ in range(600):
        service.store.change(job.id, flip)
    with stream(live, last="1") as found:
        missed = read(found, 600)
    assert [int(event.id) for event in missed] == list(range(2, 602))


@pytest.mark.parametrize("last", ["nonsense", "-3", "9" * 30, "999999", "²"])
def test_an_identifier_of_nothing_begins_anew(live, service, job, last):
    with stream(live, last=last.encode()) as found:
        (now,) = read(found, 1)
    assert now.data["id"] == job.id


def test_a_stream_of_one_job_leaves_others_out(live, service, job):
    other, _ = service.store.create(Job(JobKind.ANALYSE))
    with stream(live, f"/api/v1/jobs/{job.id}/events") as found:
        assert read(found, 1)[0].data["id"] == job.id
        service.event_bus.publish(JobEvent("progress", other.id, {"stage": "aligning"}))
        advance(service, other.id, State.RUNNING)
        service.event_bus.publish(JobEvent("progress", job.id, {"stage": "estimating"}))
        advance(service, job.id, State.RUNNING)
        heard = read(found, 2, ("job", "progress"))
    assert {event.type for event in heard} == {"job", "progress"}
    assert all(job.id in (e.data.get("id"), e.data.get("job_id")) for e in heard)


@pytest.fixture
def jobs_of_machines(service):
    """One job of each of two machines, and one of none."""

    def create(machine):
        return service.store.create(Job(JobKind.ANALYSE, machine=machine))[0]

    return [create(machine) for machine in ("default", "mill", None)]


@pytest.mark.parametrize(
    ("topics", "chosen"),
    [
        ("job:{1}", [1]),
        ("machine:default", [0]),
        ("machine:default,job:{2}", [0, 2]),
        ("", [0, 1, 2]),
    ],
)
def test_a_stream_carries_only_its_topics_and_misses_none_of_them(
    live, service, jobs_of_machines, topics, chosen
):
    ids = [job.id for job in jobs_of_machines]
    wanted = [ids[k] for k in chosen]
    path = f"{EVENTS}?topics={topics.format(*ids)}"
    with stream(live, path) as found:
        now = read(found, len(wanted))
        assert sorted(event.data["id"] for event in now) == wanted
        for job_id in ids:
            service.event_bus.publish(
                JobEvent("job", job_id, encode_job(service.store.get(job_id)))
            )
            advance(service, job_id, State.RUNNING)
        heard = read(found, 2 * len(wanted))
        assert {event.data["id"] for event in heard} == set(wanted)
    with stream(live, path, last="1") as found:
        later = [e.data["id"] for e in read(found, len(wanted)) if e.data]
    assert set(later) <= set(wanted)


def test_conditions_and_standing_of_other_machines_are_left_out(live, service):
    def publish(type_, machine):
        body = {"machine": machine, "level": "false"}
        service.event_bus.publish(JobEvent(type_, None, body))

    with stream(live, f"{EVENTS}?topics=machine:default") as found:
        read(found, 1, ("tick",))
        publish("condition", "mill")
        publish("machine", "mill")
        publish("condition", "default")
        publish("machine", "default")
        heard = read(found, 2, ("condition", "machine"))
    assert [(e.type, e.data["machine"]) for e in heard] == [
        ("condition", "default"),
        ("machine", "default"),
    ]


@pytest.mark.parametrize(
    "topics", ["jobs", "job:", "tool:1", "machine:nobody", "job:nobody", "a,", ","]
)
def test_an_unknown_topic_is_refused_before_the_stream_opens(
    client, is_problem, topics
):
    answer = client.get(f"{EVENTS}?topics={topics}")
    assert topics.split(",")[0] in is_problem(answer, 422, "bad-input")["detail"]


def test_a_tick_comes_every_second(live):
    begun = time.monotonic()
    with stream(live) as found:
        ticks = read(found, 3, ("tick",))
    assert 1.5 < time.monotonic() - begun < 6
    assert [tick.data["last_event_id"] for tick in ticks] == [0, 0, 0]
    assert ticks[0].data["time"] < ticks[1].data["time"]


def test_progress_and_live_views_name_their_job_and_have_no_identifier(
    live, service, job
):
    with stream(live) as found:
        read(found, 1)
        body = {"tracker_mm": [[1.0, 2.0, 3.0]], "axes": [1.0]}
        service.event_bus.publish(JobEvent("live", job.id, body))
        (seen,) = read(found, 1, ("live",))
    assert seen.data == {"job_id": job.id, **body}
    assert seen.id is None


def test_a_measurement_can_be_followed_to_its_result(live, make_cell, order, service):
    heard = []
    with stream(live) as found:
        read(found, 1, ("tick",))
        live.post("/api/v1/jobs", json=order)
        for event in found:
            heard.append(event)
            if event.type != "job":
                continue
            if event.data["state"] == "ready":
                arm_over_http(live, event.data)
                assert make_cell.cell.begun.wait(5)
                make_cell.cell.end()
            if event.data["state"] == "succeeded":
                break
    states = [event.data["state"] for event in heard if event.type == "job"]
    assert states[:4] == ["queued", "preparing", "ready", "running"]
    assert {event.type for event in heard} >= {"job", "progress", "live"}


@pytest.mark.fault_row(27)
def test_what_a_full_disk_does_not_take_is_told_and_shown(
    live, make_cell, order, service
):
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
def test_a_slow_client_keeps_the_newest_live_events_and_every_kept_one(
    live, service, job
):
    with stream(live) as found:
        read(found, 1)
        for number in range(20_000):
            service.event_bus.publish(
                JobEvent("live", job.id, {"number": number, "pad": "x" * 99})
            )
        advance(service, job.id, State.RUNNING)
        service.event_bus.publish(JobEvent("live", job.id, {"number": 20_000}))
        numbers, states = [], []
        for event in found:
            if event.type == "live":
                numbers.append(event.data["number"])
            if event.type == "job":
                states.append(event.data["state"])
            if numbers and numbers[-1] == 20_000 and states:
                break
    assert numbers == sorted(numbers)
    assert len(numbers) < 20_001
    assert states == ["running"]


def test_more_streams_than_allowed_are_refused_until_one_ends(live, is_problem):
    with stream(live), stream(live):
        is_problem(live.get(EVENTS), 429, "too-many-streams")
    wait_until(lambda: not events.open_streams, "the streams' end")
    with stream(live) as found:
        assert read(found, 1, ("tick",))


def test_an_open_stream_ends_when_the_service_does(live, service):
    with stream(live) as found:
        read(found, 1, ("tick",))
        begun = time.monotonic()
        service.end_streams()
        assert read(found, 1, ("never",)) == []
    assert time.monotonic() - begun < 1.0


def test_an_open_stream_ends_with_its_session(live, service, monkeypatch):
    with stream(live) as found:
        read(found, 1, ("tick",))
        monkeypatch.setattr(service.access, "identify", lambda _: None)
        assert read(found, 99, ("never",)) == []
    assert not service.closing.is_set()


def test_a_catalogue_that_is_away_ends_no_stream(live, service, monkeypatch):
    def away(_):
        raise StorageUnavailable("the catalogue is away")

    with stream(live) as found:
        read(found, 1, ("tick",))
        monkeypatch.setattr(service.access, "identify", away)
        assert len(read(found, 2, ("tick",))) == 2
        monkeypatch.undo()


def test_a_client_that_goes_away_is_forgotten(live, service):
    with stream(live) as found:
        read(found, 1, ("tick",))
        assert len(service.event_bus._listeners) == 1
    wait_until(lambda: not service.event_bus._listeners, "the listener's end")


def test_notices_after_the_loop_has_ended_are_harmless(service):
    async def subscribe():
        return events.Subscription(service, Topics(), lambda: True)

    subscription = asyncio.run(subscribe())
    thread = threading.Thread(
        target=subscription.put, args=(JobEvent("live", None, {}),)
    )
    thread.start()
    thread.join()
