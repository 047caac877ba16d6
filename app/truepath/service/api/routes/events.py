"""Streams: events of the service, and every sample of a tracker.

Stored events are never missed, live ones may be dropped. `job` events have identifiers
of the catalogue; a client that returns with Last-Event-ID gets all later ones, in
order, from the catalogue itself. Other events (`progress`, `live`, `estimate`,
`notice`, `condition`, `tick`) are momentary: only the newest matters. A stream has all
events, or those of named jobs and machines.

Samples are sent as they are recorded, in binary frames over a WebSocket. A frame is a
header of 12 bytes and `count` samples of 33 bytes, little-endian, packed:

    header   magic 4 bytes "TPLV", version u16, count u16, dropped u32
    sample   device_time_s f64, x, y, z f64 (mm, tracker's frame), status u8

`dropped` counts the samples that this client was too slow for since it connected. The
view is not the record: dropped samples are in the Run.
"""

from __future__ import annotations

import asyncio
import struct
import threading
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine
from contextlib import aclosing, suppress
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from anyio import CapacityLimiter
from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Header, Query, WebSocket
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocketState

from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import Job, JobEvent, decode_job, format_utc_now
from truepath.errors import BadInput, NotFound
from truepath.machines.cell_supervisor import SampleQueue
from truepath.machines.machine_cells import MachineCell
from truepath.service.api.access_control import read_token
from truepath.service.api.job import describe_job
from truepath.service.api.models.base import JobId
from truepath.service.api.problems import declare_problems
from truepath.service.api.service import Service, ServiceDep
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import TrackerSamples

GOING_AWAY, POLICY, TRY_LATER = 1001, 1008, 1013

TICK_S = 1.0
ASK_S = 0.5
"""Interval at which a stream checks whether it may still be read."""
_ASKING = CapacityLimiter(4)  # apart from all other work, that may take long
WAITING = 50
"""Live events that wait for a slow client; older ones are dropped."""

MOST_TOPICS = 32
_OF_MACHINE = ("machine", "condition")
_LIVE = ("job", "progress", "live", "estimate", "plan", "notice", *_OF_MACHINE)

MAGIC, VERSION = b"TPLV", 1
HEADER = struct.Struct("<4sHHI")
SAMPLE = np.dtype(
    [("device_time_s", "<f8"), ("position_mm", "<f8", (3,)), ("status", "u1")]
)

FindMachine = Callable[[str], str | None]
"""Machine of an active job, without waiting; None where unknown."""

router = APIRouter(tags=["events"])

_EXAMPLE = (
    'event: job\ndata: {"id": "019a…", "state": "running", "version": 4, …}\nid: 17\n\n'
    'event: progress\ndata: {"job_id": "019a…", "stage": "measuring", …}\n\n'
    'event: tick\ndata: {"time": "2026-05-04T09:30:01.000Z", "last_event_id": 17}\n\n'
)
_STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `job` (kept, with id; without one where the catalogue "
        "cannot be written), and for now only: `progress`, "
        "`live`, `estimate`, `plan`, `notice`, `machine`, `condition`, `tick`.",
        "content": {"text/event-stream": {"example": _EXAMPLE}},
    },
    **declare_problems(404, 422, 429),
}


class Subscription:
    """Accepts events from any thread and makes one stream of them.

    session : the stream ends when it may not be read any more
    """

    def __init__(self, service: Service, topics: Topics, session: Session) -> None:
        self.service, self._topics, self._session = service, topics, session
        self._lock = threading.Lock()
        self._waiting: deque[JobEvent] = deque(maxlen=WAITING)
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()
        self._news = True

    def put(self, job_event: JobEvent) -> None:
        """Accept an event. Never waits; a full queue drops the oldest live one."""
        is_live = job_event.id is None and job_event.type in _LIVE
        find_machine = self.service.dispatcher.find_machine
        if is_live and not self._topics.includes_event(job_event, find_machine):
            return
        with self._lock:
            if job_event.id is not None:
                self._news = True
            elif is_live:
                self._waiting.append(job_event)
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._changed.set)

    async def events(self, last_event_id: str) -> AsyncGenerator[ServerSentEvent]:
        """Yield missed events, or the present state first, then new events."""
        async with aclosing(self._read_events(last_event_id)) as found:
            async for event in found:
                if not await self._session.is_open():
                    return
                if event is not None:
                    yield event

    async def _read_events(
        self, last_event_id: str
    ) -> AsyncGenerator[ServerSentEvent | None]:
        """Yields None when there was no event for a while."""
        service, topics = self.service, self._topics
        newest = await run_sync(service.store.read_last_event_id)
        known = _parse_last_event_id(last_event_id, newest)
        if known is None:
            known = newest
            for event in await run_sync(_read_present, service, topics, newest):
                yield event
        next_tick = host_clock.now_s()
        while not service.closing.is_set():
            news, live = self._pop_waiting()
            while news:
                missed = await run_sync(
                    partial(
                        service.store.read_events_after, known, job_id=topics.only_job
                    )
                )
                for stored in missed:
                    known, job = stored.id or known, decode_job(stored.body)
                    if topics.includes_job(job):
                        yield _describe_job_event(job, stored.id)
                news = bool(missed)
            for job_event in live:
                yield _describe_live(job_event)
            if host_clock.now_s() >= next_tick:
                next_tick = host_clock.now_s() + TICK_S
                tick = {"time": format_utc_now(), "last_event_id": known}
                yield ServerSentEvent(data=tick, event="tick")
            yield None
            await self._wait(min(next_tick - host_clock.now_s(), ASK_S))

    def _pop_waiting(self) -> tuple[bool, list[JobEvent]]:
        with self._lock:
            news, self._news = self._news, False
            waiting = list(self._waiting)
            self._waiting.clear()
        self._changed.clear()
        return news, waiting

    async def _wait(self, timeout_s: float) -> None:
        with suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), timeout_s)


open_streams: set[Subscription] = set()
"""One per browser tab. Changed on the event loop only."""


def count_streams(service: Service) -> int:
    """Number of open event streams of a service."""
    return sum(stream.service is service for stream in list(open_streams))


class Session:
    """Validity of a stream's session and user."""

    def __init__(self, service: Service, token: str) -> None:
        self._access, self._token = service.access, token
        self._due_s = host_clock.now_s() + ASK_S

    async def is_open(self) -> bool:
        """Whether the stream may continue; queries at most every `ASK_S`."""
        if host_clock.now_s() < self._due_s:
            return True
        self._due_s = host_clock.now_s() + ASK_S
        return await run_sync(self._is_valid, limiter=_ASKING)

    def _is_valid(self) -> bool:
        try:
            return self._access.identify(self._token) is not None
        except StorageUnavailable:  # a disk error must not hide the present state
            return True


@dataclass(frozen=True, slots=True)
class Topics:
    """Selected events; without jobs and machines all.

    jobs, machines : identifiers; a machine includes its jobs
    """

    jobs: frozenset[str] = frozenset()
    machines: frozenset[str] = frozenset()

    @property
    def is_all(self) -> bool:
        """Whether nothing is excluded."""
        return not self.jobs and not self.machines

    @property
    def only_job(self) -> str | None:
        """The job, where it is the only topic."""
        (job_id,) = self.jobs if len(self.jobs) == 1 else (None,)
        return None if self.machines else job_id

    def includes_job(self, job: Job) -> bool:
        """Whether a job is selected."""
        return self.is_all or job.id in self.jobs or job.machine in self.machines

    def includes_event(self, event: JobEvent, find_machine: FindMachine) -> bool:
        """Whether an event is selected. Never waits."""
        if self.is_all or event.job_id in self.jobs:
            return True
        machine = event.body.get("machine")
        if event.job_id is not None and machine is None and self.machines:
            machine = find_machine(event.job_id)
        return machine in self.machines


def parse_topics(
    text: str,
    require_job: Callable[[str], object],
    require_machine: Callable[[str], object],
) -> Topics:
    """Topics of `job:ID,machine:ID`; all for an empty text.

    require_job, require_machine : raise NotFound where there is none

    Raises BadInput naming the topic.
    """
    named: dict[str, set[str]] = {"job": set(), "machine": set()}
    require = {"job": require_job, "machine": require_machine}
    topics = [topic.strip() for topic in text.split(",")] if text else []
    if len(topics) > MOST_TOPICS:
        raise BadInput(f"topics: {len(topics)} are named; at most {MOST_TOPICS} can be")
    for topic in topics:
        kind, _, identifier = topic.partition(":")
        if kind not in named or not identifier:
            raise BadInput(
                f"topics: {topic[:80]!r} is unknown; name job:ID or machine:ID, "
                "separated by commas, or leave topics out"
            )
        try:
            require[kind](identifier)
        except NotFound as error:
            raise BadInput(f"topics: {topic[:80]!r} is unknown: {error}") from error
        named[kind].add(identifier)
    return Topics(frozenset(named["job"]), frozenset(named["machine"]))


async def _subscribe(
    request: HTTPConnection,
    service: ServiceDep,
    topics: Annotated[
        str,
        Query(
            description="Only of these: `job:ID` and `machine:ID`, separated by "
            "commas; a machine stands for its jobs. Without it everything.",
            examples=["machine:default"],
            max_length=4096,
        ),
    ] = "",
) -> AsyncIterator[Subscription]:
    """Ended by the request, not by the stream's generator: a generator that waits for a
    slow client does not notice when that client leaves.
    """
    chosen = await run_sync(_choose_topics, request, service, topics)
    if len(open_streams) >= service.max_streams:
        raise HTTPException(429, f"{service.max_streams} event streams are open")
    session = Session(service, read_token(request.scope))
    subscription = Subscription(service, chosen, session)
    unsubscribe = service.event_bus.subscribe(subscription.put)
    open_streams.add(subscription)
    try:
        yield subscription
    finally:
        open_streams.remove(subscription)
        unsubscribe()


def _choose_topics(request: HTTPConnection, service: Service, text: str) -> Topics:
    """Raises NotFound, BadInput."""
    job_id = request.path_params.get("job_id")
    if job_id is not None:
        return Topics(jobs=frozenset({service.store.get(job_id).id}))
    return parse_topics(text, service.store.get, service.setup.registry.get)


SubscriptionDep = Annotated[Subscription, Depends(_subscribe)]
LastEventId = Annotated[
    str, Header(description="Identifier of the last event that was received.")
]


@router.get("/events", response_class=EventSourceResponse, responses=_STREAM)
async def stream_events(
    subscription: SubscriptionDep, last_event_id: LastEventId = ""
) -> AsyncIterator[ServerSentEvent]:
    """Follow everything, or the topics that are named: one stream a page.

    The browser reconnects by itself.
    """
    async for event in subscription.events(last_event_id):
        yield event


@router.get(
    "/jobs/{job_id}/events", response_class=EventSourceResponse, responses=_STREAM
)
async def stream_job_events(
    job_id: JobId, subscription: SubscriptionDep, last_event_id: LastEventId = ""
) -> AsyncIterator[ServerSentEvent]:
    """Follow one job."""
    async for event in subscription.events(last_event_id):
        yield event


@router.websocket("/events")
async def send_events(
    websocket: WebSocket, subscription: SubscriptionDep, last_event_id: str = ""
) -> None:
    """Follow as by `GET /events`, in JSON: `event`, `id` where it has one, `data`.

    For pages: of other streams a browser opens six to a host and then nothing more.
    """

    async def send() -> None:
        async with aclosing(subscription.events(last_event_id)) as events:
            async for event in events:
                sent = event.model_dump_json(include={"event", "id", "data"})
                await websocket.send_text(sent)

    await websocket.accept()
    await send_until_disconnected(websocket, send())


def _parse_last_event_id(last_event_id: str, newest: int) -> int | None:
    """None if the client is new or of another catalogue."""
    if not last_event_id.isdecimal() or len(last_event_id) > 18:
        return None
    seen = int(last_event_id)
    return seen if seen <= newest else None


def _read_present(
    service: Service, topics: Topics, newest: int
) -> list[ServerSentEvent]:
    store = service.store
    unfinished = {job.id: job for job in store.list_unfinished()}
    named = {job_id: store.get(job_id) for job_id in sorted(topics.jobs)}
    jobs = [job for job in (unfinished | named).values() if topics.includes_job(job)]
    shown = [service.dispatcher.show(job) for job in jobs]
    return [_describe_job_event(job, newest) for job in shown]


def _describe_live(job_event: JobEvent) -> ServerSentEvent:
    if job_event.type == "job":  # it could not be stored
        return ServerSentEvent(
            data=describe_job(decode_job(job_event.body)), event="job"
        )
    body = {"job_id": job_event.job_id, **job_event.body}
    return ServerSentEvent(data=body, event=job_event.type)


def _describe_job_event(job: Job, event_id: int | None) -> ServerSentEvent:
    return ServerSentEvent(data=describe_job(job), event="job", id=str(event_id))


open_scopes: set[SampleQueue] = set()
"""Changed on the event loop only."""


def encode_frame(samples: TrackerSamples, dropped: int) -> bytes:
    """A frame; a status above 255 is 255, as invalid as any but 0."""
    rows = np.empty(len(samples), SAMPLE)
    rows["device_time_s"] = samples.device_time_s
    rows["position_mm"] = samples.position_mm
    rows["status"] = np.where(samples.status == 0, 0, np.clip(samples.status, 1, 255))
    header = HEADER.pack(MAGIC, VERSION, len(samples), min(dropped, 0xFFFFFFFF))
    return header + rows.tobytes()


@router.websocket("/machines/current/live")
async def show_only_machine(websocket: WebSocket) -> None:
    """Show the samples of the only or first machine."""
    service: Service = websocket.app.state.service
    await _show(websocket, service, service.machines.first)


@router.websocket("/machines/{machine_id}/live")
async def show_machine(websocket: WebSocket, machine_id: str) -> None:
    """Show the samples of a machine."""
    service: Service = websocket.app.state.service
    try:
        machine = service.machines.get(machine_id)
    except NotFound:
        machine = None
    await _show(websocket, service, machine)


async def _show(
    websocket: WebSocket, service: Service, machine: MachineCell | None
) -> None:
    if machine is None:
        await websocket.close(POLICY, "there is no such machine")
        return
    if len(open_scopes) >= service.max_streams:
        await websocket.close(TRY_LATER, f"{service.max_streams} views are open")
        return
    await websocket.accept()
    loop, changed = asyncio.get_running_loop(), asyncio.Event()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(changed.set)

    queue = machine.cell.samples.subscribe(wake)
    open_scopes.add(queue)
    try:
        await send_until_disconnected(
            websocket, _send(websocket, service, queue, changed)
        )
    finally:
        open_scopes.remove(queue)
        machine.cell.samples.unsubscribe(queue)


async def _send(
    websocket: WebSocket, service: Service, queue: SampleQueue, changed: asyncio.Event
) -> None:
    """Raises WebSocketDisconnect, RuntimeError where the client has left."""
    session = Session(service, read_token(websocket.scope))
    while not service.closing.is_set():
        changed.clear()
        samples, dropped = queue.pop_oldest()
        while samples is not None and await session.is_open():
            await websocket.send_bytes(encode_frame(samples, dropped))
            samples, dropped = queue.pop_oldest()
        if not await session.is_open():
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(changed.wait(), ASK_S)


async def send_until_disconnected(
    websocket: WebSocket, sending: Coroutine[Any, Any, None]
) -> None:
    """Run a sender until it ends or the client has left, then close.

    Messages of the client are ignored.
    """
    tasks = [asyncio.create_task(_wait_for_disconnect(websocket))]
    tasks.append(asyncio.create_task(sending))
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if websocket.client_state is WebSocketState.CONNECTED:
        with suppress(RuntimeError):  # it has left just now
            await websocket.close(GOING_AWAY)


async def _wait_for_disconnect(websocket: WebSocket) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass
