"""One measurement by the cell, followed from its beginning to its closed Run.

Every answer of the cell has a deadline: where it confirms neither a hold, nor going on,
nor an abort, its process is ended and the machine's own watchdog holds the feed.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from typing import Any

import structlog

from app.errors import MeasurementFailed
from app.jobs.active_job import ActiveJob
from app.jobs.cell_supervisor import CellSupervisor
from app.jobs.errors import Aborted, MachineFault, MeasurementEnded
from app.jobs.growth import Growth
from app.jobs.job import EarlyEnd, Failure, Health, Progress, Stage
from app.jobs.live_estimation import LiveEstimation
from app.jobs.transitions import State
from app.measurement.cell import CellEvent, Order

log = structlog.get_logger(__name__)

CONFIRM_S = {
    State.PAUSING: 30.0,  # a standstill point may be finished first
    State.RESUMING: 30.0,
    State.ABORTING: 10.0,
}
CLOSE_RUN_S = 60.0
INSIST_S = 1.0
_HEAR_S = 0.1

_STATES = {
    "running": State.RUNNING,
    "pausing": State.PAUSING,
    "paused": State.PAUSED,
    "resuming": State.RESUMING,
}
_ENDS = frozenset({"finished", "aborted", "failed", "faulted"})
_GO_AND_LOOK = (
    "Make sure that the machine stands, look at the log for the cause, then measure "
    "again; what was recorded is kept."
)


class CellMeasurement:
    """The events of one measurement, taken in order by the job's thread."""

    def __init__(
        self,
        job: ActiveJob,
        cell: CellSupervisor,
        *,
        confirm_s: Mapping[State, float] = CONFIRM_S,
        live: LiveEstimation | None = None,
        target_um: float | None = None,
        growth: Growth | None = None,
    ) -> None:
        self._growth = growth
        self._target_um, self._is_concluded = target_um, False
        self._job, self._cell, self._live = job, cell, live
        self._confirm_s = confirm_s
        self._events: queue.SimpleQueue[CellEvent | None] = queue.SimpleQueue()
        self._fault: Mapping[str, Any] = {}
        self._outcome = ""
        self._close_by = float("inf")
        self._insist_at = time.monotonic() + INSIST_S
        self._given_up = False

    def run(self, order: Order) -> None:
        """Measure. Returns when the path has been driven and the Run is closed.

        Raises Aborted, Interrupted, MeasurementEnded, or MachineFault where somebody
        has to look. What was recorded is on disk in any case.
        """
        if not self._cell.begin(order, self._events.put, self._is_called_off):
            self._job.checkpoint()
        try:
            self._follow()
        except Exception:
            self._cell.abort()
            self._wait_for_the_end()
            raise
        finally:
            self._cell.forget()
        self._judge()

    def _is_called_off(self) -> bool:
        return self._job.is_cancelled

    def _follow(self) -> None:
        while True:
            self._insist()
            self._conclude_at_target()
            if self._growth is not None and not self._is_concluded:
                self._growth.look()
            self._watch_the_clock()
            try:
                event = self._events.get(timeout=_HEAR_S)
            except queue.Empty:
                continue
            if event is None:
                self._note_death()
                return
            if event.kind == "closed":
                body = event.body
                self._job.set_sample_counts(body["samples"], body["lost_samples"])
                return
            self._take(event)

    def _wait_for_the_end(self) -> None:
        """Let the cell close its Run when nothing can be written down any more."""
        deadline = time.monotonic() + CLOSE_RUN_S
        while (left_s := deadline - time.monotonic()) > 0:
            try:
                event = self._events.get(timeout=left_s)
            except queue.Empty:
                break
            if event is None or event.kind == "closed":
                return
        self._cell.condemn()

    def _take(self, event: CellEvent) -> None:
        body = event.body
        if event.kind == "progress":
            self._job.report_progress(
                _progress(body), stage=Stage.MEASURING, health=_health(body)
            )
        elif event.kind == "live":
            self._job.publish_live(body)
        elif event.kind == "block" and self._live is not None:
            self._live.offer(body["samples"])
        elif event.kind == "part" and self._growth is not None:
            self._growth.ask()
        elif event.kind == "fault":
            self._take_fault(body)
        elif event.kind == "state":
            self._follow_state(str(body["state"]))

    def _take_fault(self, body: Mapping[str, Any]) -> None:
        """Show what is wrong. The cell says by its state whether this is the end."""
        log.error("fault", job_id=self._job.job_id, **body)
        self._fault = body
        code, text, action = _fault_texts(body)
        self._job.show_failure(Failure("MachineFault", text, code, action))

    def _follow_state(self, name: str) -> None:
        if name in _ENDS:
            self._outcome = name
            self._close_by = time.monotonic() + CLOSE_RUN_S
            return
        state = _STATES.get(name)
        if state is None:
            return
        # What the cell said before a pause reached it must not undo the pause.
        late = state is State.RUNNING
        job = self._job.enter(state, Stage.MEASURING, unless_pausing=late)
        if job.state is State.RUNNING:
            self._fault = {}
            self._job.show_failure(None)

    def _insist(self) -> None:
        """Repeat what has not been confirmed: it may have come before it could act.

        A pause is repeated only where a user wants it: from a stop of its own the cell
        goes on by itself, from one that it is told it does not.
        """
        now = time.monotonic()
        if self._outcome or now < self._insist_at:
            return
        self._insist_at = now + INSIST_S
        if self._job.is_cancelled:
            self._cell.abort()
        elif self._job.state is State.PAUSING and self._job.wants_pause:
            self._cell.pause()

    def _conclude_at_target(self) -> None:
        """End in order as soon as the volumetric uncertainty is what was asked for."""
        if self._is_concluded or self._target_um is None or self._live is None:
            return
        newest = self._live.newest
        if newest is None or self._job.state is not State.RUNNING:
            return
        reached_um = newest["volumetric_uncertainty_um"]
        if reached_um <= self._target_um:
            log.info("target reached", reached_um=reached_um, target_um=self._target_um)
            self._is_concluded = True
            self._cell.conclude()
            early_end = EarlyEnd(reached_um, newest["done"], newest["total"])
            self._job.note_early_end(early_end)

    def _watch_the_clock(self) -> None:
        state = self._job.state
        limit_s = float("inf") if self._outcome else self._confirm_s.get(state)
        overdue = limit_s is not None and self._job.state_lasts_s > limit_s
        if overdue and not self._given_up:
            self._give_up(f"not-{state}", f"the cell has not confirmed {state} in time")
        if time.monotonic() > self._close_by:
            self._close_by = float("inf")
            self._give_up("run-not-closed", "the cell has not closed its Run in time")

    def _give_up(self, code: str, text: str) -> None:
        log.error("cell given up", job_id=self._job.job_id, code=code)
        self._given_up = True
        self._fault = {
            "code": code,
            "text": f"{text}; its process was ended and the machine's watchdog holds",
            "action": _GO_AND_LOOK,
        }
        self._cell.condemn()

    def _note_death(self) -> None:
        self._outcome = "faulted"
        if not self._fault:
            self._fault = {
                "code": "cell-died",
                "text": "the cell process has died; the machine's watchdog holds",
                "action": _GO_AND_LOOK,
            }

    def _judge(self) -> None:
        """Return if all is well, else raise what the outcome means."""
        code, text, action = _fault_texts(self._fault)
        if self._outcome == "faulted":
            raise MachineFault(code or "fault", text or "the machine faulted", action)
        self._job.checkpoint()
        if self._outcome == "finished":
            return
        if self._outcome == "aborted":
            raise Aborted("aborted at the machine")
        if self._outcome == "failed":
            raise MeasurementEnded(code or "failed", text or "it failed", action)
        raise MeasurementFailed("the cell closed its Run without saying why")


def _fault_texts(body: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        str(body.get("code", "")),
        str(body.get("text", "")),
        str(body.get("action", "")),
    )


def _progress(body: Mapping[str, Any]) -> Progress:
    remaining_s = body.get("remaining_s")
    return Progress(
        done=float(body.get("done") or 0),
        total=float(body.get("total") or 0),
        unit=str(body.get("unit") or ""),
        eta_s=None if remaining_s is None else float(remaining_s),
        elapsed_s=float(body.get("elapsed_s") or 0),
        position=tuple(float(x) for x in body.get("position") or ()),
    )


def _health(body: Mapping[str, Any]) -> Health:
    return Health(
        samples=int(body.get("samples") or 0),
        lost_samples=int(body.get("lost_samples") or 0),
        crc_errors=int(body.get("crc_errors") or 0),
    )
