"""State of one job, shared by its own thread and request threads, and its events."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import structlog

from truepath.catalogue.errors import (
    Aborted,
    Cancelled,
    Interrupted,
    StorageUnavailable,
)
from truepath.catalogue.job import (
    Failure,
    Health,
    Job,
    JobEvent,
    Json,
    OnNotice,
    Progress,
    Stage,
    encode_job,
)
from truepath.catalogue.job_changes import (
    apply_request,
    end_job,
    enter_state,
    requeue,
    set_failure,
)
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import MOVE_STATES, State, Verb
from truepath.errors import MeasurementFailed
from truepath.jobs.workers.executor import Computing
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.measurement.messages import CellVerb
from truepath_drivers import host_clock

JOBS = 16
"""Number of jobs whose estimates are kept: those with the newest ones."""
COURSE = ("elapsed_s", "done", "volumetric_uncertainty_um")

Listener = Callable[[JobEvent], None]


class EventBus:
    """Calls listeners in the thread that publishes: they must return at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self.estimates = EstimateHistory()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Add a listener; calling the result removes it."""
        with self._lock:
            self._listeners += (listener,)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(x for x in self._listeners if x is not listener)

        return unsubscribe

    def publish(self, event: JobEvent) -> None:
        """Pass an event to every listener; estimates are also remembered."""
        if event.type == "estimate" and event.job_id is not None:
            self.estimates.add(event.job_id, event.body)
        for listener in self._listeners:
            listener(event)


class EstimateHistory:
    """Newest estimates of `JOBS` jobs, with the course of their uncertainty."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: OrderedDict[str, Mapping[str, Any]] = OrderedDict()
        self._courses: dict[str, list[tuple[Any, ...]]] = {}

    def add(self, job_id: str, body: Mapping[str, Any]) -> None:
        """Add an estimate; a repeated one adds no step to the course."""
        step = tuple(body[name] for name in COURSE)
        with self._lock:
            self._newest[job_id] = body
            self._newest.move_to_end(job_id)
            course = self._courses.setdefault(job_id, [])
            if course[-1:] != [step]:
                course.append(step)
            while len(self._newest) > JOBS:
                oldest, _ = self._newest.popitem(last=False)
                del self._courses[oldest]

    def newest(self, job_id: str) -> Mapping[str, Any] | None:
        """None where no estimate is remembered."""
        return self._newest.get(job_id)

    def course(self, job_id: str) -> dict[str, list[Any]]:
        """Columns `COURSE`, one row per estimate, oldest first."""
        with self._lock:
            rows = list(self._courses.get(job_id, ()))
        return {name: [row[i] for row in rows] for i, name in enumerate(COURSE)}


log = structlog.get_logger(__name__)

POLL_DEVICES_S = 3.0
STORE_EVERY_S = 1.0
PUBLISH_EVERY_S = 0.1


class ActiveJob:
    """Requests come from request threads; the job's thread obeys at checkpoints.

    job, state : stored last; stage : the newest, stored or not
    is_aborted : a user has asked for it, stored or not; is_interrupted : the service
        ends
    wants_pause : a user's latest request is a pause, stored or not
    controller : name of the user who may let the machine move; None without login
    wants_cancel : end in order, after the current line or point
    """

    def __init__(self, job: Job, store: Store, event_bus: EventBus) -> None:
        self.job, self.job_id, self.kind = job, job.id, job.kind
        self._store, self._event_bus = store, event_bus
        self._changed = threading.Condition()
        self.state, self._since = job.state, host_clock.now_s()
        self.wants_pause = job.wants_pause
        self._armed: str | None = None
        self.is_aborted = self.is_interrupted = False
        self.wants_cancel = False
        self.controller = job.owner
        self._notice_action: OnNotice | None = None
        self._computation: Computing | None = None
        self.stage, self._progress, self._health = job.stage, job.progress, job.health
        self._stored_at = self._published_at = -float("inf")
        self._unstored: Failure | None = None

    @property
    def is_cancelled(self) -> bool:
        """Whether the job has to end now: aborted by a user, or the service ends."""
        return self.is_aborted or self.is_interrupted

    def discard_pending_end(self) -> None:
        """Leave the end of the job to the next start of the service."""
        self._store.discard_pending_end(self.job_id)

    @property
    def may_move(self) -> bool:
        """Whether the cell moves the machine for the job, or may resume by itself."""
        return self.stage is Stage.MEASURING and self.state in MOVE_STATES

    @property
    def state_lasts_s(self) -> float:
        """Time since the last change of state."""
        return host_clock.now_s() - self._since

    def apply_verb(self, verb: Verb, version: int | None = None) -> Job:
        """Store a user's request. Raises IllegalTransition, StaleVersion."""
        seen = self._store.apply_pending_end(self.job)
        if seen.is_final:  # whether that could be stored or not
            return apply_request(seen, verb)
        return self._change(lambda job: apply_request(job, verb), version)

    def arm(self, plan_sha256: str) -> None:
        """Permit the motion of the plan with this hash."""
        with self._changed:
            self._armed = plan_sha256
            self._changed.notify_all()

    def pause(self, cell: CellSupervisor) -> Job:
        """Hold the feed, then store the request.

        The cell gets the command even if it has paused: it might resume by itself. A
        pause that cannot be stored is wanted until the state changes. Raises
        IllegalTransition, StorageUnavailable; the cell has the command even then.
        """
        if self.may_move:
            cell.send(CellVerb.PAUSE)
        try:
            return self.apply_verb(Verb.PAUSE)
        except StorageUnavailable:
            with self._changed:
                self.wants_pause = True
            raise

    def request_notice_action(self, action: OnNotice) -> None:
        """Set the action on the newest notice."""
        self._notice_action = action

    def pop_notice_action(self) -> OnNotice | None:
        """Action that a user has chosen; None on the next call."""
        action, self._notice_action = self._notice_action, None
        return action

    def abort(self) -> None:
        """End the job at a user's request. Does not wait for the catalogue."""
        self.is_aborted = True
        self._wake()

    def cancel(self) -> None:
        """End the job in order: a measurement after its line or point."""
        self.wants_cancel = True
        self._wake()

    def interrupt(self) -> None:
        """End the job because the service ends."""
        self.is_interrupted = True
        self._wake()

    def checkpoint(self) -> None:
        """Raise Aborted, Interrupted or Cancelled if the job has to end."""
        if self.is_aborted:
            raise Aborted("aborted")
        if self.is_interrupted:
            raise Interrupted("the service was ended while the job was under way")
        if self.wants_cancel:
            raise Cancelled("cancelled")

    def wait_until_armed(
        self, plan_sha256: str, poll_devices: Callable[[], None]
    ) -> None:
        """Wait for `arm`.

        Raises as `checkpoint`, MeasurementFailed for another plan.

        plan_sha256 : of the rows about to be commanded
        poll_devices : polls the devices meanwhile
        """
        while True:
            with self._changed:
                if host_clock.wait_for(
                    self._changed,
                    lambda: bool(self._armed) or self.is_cancelled or self.wants_cancel,
                    POLL_DEVICES_S,
                ):
                    armed, self._armed = self._armed, None
                    break
            poll_devices()
        self.checkpoint()
        if armed != plan_sha256:
            raise MeasurementFailed(
                "the plan is not the one that the job was armed for; nothing has moved"
            )

    def compute(self, computation: Computing) -> Any:
        """Wait for a computation; it is cancelled when the job is."""
        with self._changed:
            self._computation = computation
        try:
            self.checkpoint()
            return computation.result()
        except Aborted:
            self.checkpoint()
            raise
        finally:
            with self._changed:
                self._computation = None

    def enter(self, state: State, stage: Stage, *, unless_pausing: bool = False) -> Job:
        """Change state or stage; a transition that is not allowed has no effect.

        unless_pausing : keep a pause that the cell has not confirmed yet
        """

        def change(job: Job) -> Job:
            if unless_pausing and job.state is State.PAUSING and job.wants_pause:
                return job
            return enter_state(job, state, stage, self._progress, self._health)

        if stage is not self.stage:
            self.stage, self._progress = stage, Progress()
        return self._change(change)

    def show_failure(self, failure: Failure | None) -> None:
        """Store why the machine does not move, None when it does; ends a resume."""
        self._change(lambda job: set_failure(job, failure))

    def end(self, state: State, failure: Failure | None) -> Job:
        """Enter a final state; an abort or cancel request overrides success."""

        def change(job: Job) -> Job:
            return end_job(
                job, state, failure, self.stage, self._progress, self._health
            )

        def request_abort(job: Job) -> Job:
            return apply_request(job, Verb.ABORT) if state is State.ABORTED else job

        try:
            if state is State.ABORTED:
                self._change(request_abort, ends=True)
            return self._change(change, ends=True)
        except StorageUnavailable as error:
            # A success is seen when it is stored: its result is found by it.
            if state is not State.SUCCEEDED:
                ended = self._store.mark_ended(
                    self.job, change(request_abort(self.job))
                )
                with self._changed:
                    if self.state is not ended.state:  # once; it is shown again then
                        self.state, self._unstored = ended.state, None
            self.show_unstored(error)
            raise

    def requeue(self) -> None:
        """Queue the job again for the next start of the service."""
        self._change(lambda job: requeue(job, in_order=True))

    def add_run(self, run_id: str) -> None:
        """Store a new Run of the job, unless it has ended."""
        self._change(lambda job: job if job.is_final else job.add_run(run_id))

    def store_values(self, **values: Any) -> None:
        """Store fields of the job, unless it has ended."""
        self._change(lambda job: job if job.is_final else replace(job, **values))

    def report_progress(
        self,
        progress: Progress,
        *,
        stage: Stage | None = None,
        health: Health | None = None,
    ) -> None:
        """Publish progress, and store it once per second."""
        is_new_stage = stage is not None and stage is not self.stage
        self.stage = stage or self.stage
        self._progress, self._health = progress, health or self._health
        now = host_clock.now_s()
        if is_new_stage or now - self._published_at >= PUBLISH_EVERY_S:
            self._published_at = now
            body = {
                "stage": str(self.stage),
                "progress": asdict(self._progress),
                "health": asdict(self._health),
            }
            self.publish("progress", body)
        if is_new_stage or now - self._stored_at >= STORE_EVERY_S:
            self._stored_at = now
            try:
                self._store.store_progress(
                    self.job_id, self.stage, progress, self._health
                )
            except StorageUnavailable as error:
                # Progress is a convenience: the measurement continues without it.
                self.show_unstored(error)
            else:
                if self._unstored is not None:
                    self._show_unstored(None)

    def set_sample_counts(self, samples: int, lost_samples: int) -> None:
        """Set the counts of the closed Run: the last progress may be slightly older."""
        self._health = replace(self._health, samples=samples, lost_samples=lost_samples)

    def publish(self, type_: str, body: Json) -> None:
        """Publish an event that is not stored: `live`, `estimate`, `plan`."""
        self._event_bus.publish(JobEvent(type_, self.job_id, body))

    def show(self, job: Job) -> Job:
        """The stored job, with a failure that could not be stored."""
        seen = self._store.apply_pending_end(job)
        if seen.is_final or self._unstored is None:
            return seen
        return replace(seen, failure=self._unstored)

    def show_unstored(self, error: StorageUnavailable) -> None:
        """Show at once that the catalogue cannot be written."""
        unstored = Failure(type(error).__name__, str(error))
        if unstored != self._unstored:
            log.warning("job not stored", job_id=self.job_id, reason=str(error))
            self._show_unstored(unstored)

    def _show_unstored(self, unstored: Failure | None) -> None:
        self._unstored = unstored
        self.publish("job", encode_job(self.show(self.job)))

    def _change(
        self,
        change: Callable[[Job], Job],
        version: int | None = None,
        *,
        ends: bool = False,
    ) -> Job:
        try:
            job = self._store.change(self.job_id, change, version=version, ends=ends)
        except StorageUnavailable as error:
            if not ends:
                self.show_unstored(error)
            raise
        self._unstored = None
        with self._changed:
            self.job = job
            is_other = job.state is not self.state
            self.wants_pause = job.wants_pause or (self.wants_pause and not is_other)
            if is_other:
                self.state, self._since = job.state, host_clock.now_s()
        return job

    def _wake(self) -> None:
        with self._changed:
            computation = self._computation
            self._changed.notify_all()
        if computation is not None:
            computation.cancel()
