"""Live estimate of an active measurement, made by a separate process.

Committed blocks go in through a short queue that drops and counts blocks the process
cannot take in time: a slow estimate never delays the measurement, and the analysis of
the closed Run misses nothing. A failure of the process ends only the live estimate.

An estimate is shown as soon as it is made, and again every `PERIOD_S` with its age
until there is a newer one.
"""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import structlog

from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.job import LiveNotice, OnNotice, decode_notice
from truepath.child_process import BACKGROUND_NICENESS, ChildProcess
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import replace_file
from truepath.errors import IllegalTransition
from truepath.files.bundle.run import PointBlock
from truepath.files.earlier.verdict import verdict_from_json
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.live_process import (
    Estimated,
    EstimateFailed,
    LiveCommand,
    LiveEstimateOrder,
    PartChosen,
    estimate_live,
)
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.measurement.messages import (
    BlockRecorded,
    CellEvent,
    CellVerb,
    LinesDamaged,
    PartRequested,
)
from truepath.measurement.process.cell import Cell
from truepath.motion.configurations import Commanded, append_part
from truepath.motion.paths.plan_segments import PlannedRows
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path, TrackerSamples

if TYPE_CHECKING:
    from truepath.planning.adaptive_plan import Part

log = structlog.get_logger(__name__)

PERIOD_S = 0.25
WAITING_BLOCKS = 100  # about ten seconds of the stream
FINISH_S = 20.0
ANSWER_S = 60.0
_MICRO = 1e3  # mm to µm
_IN_UNCERTAINTY = "places-differ"  # a doubt that no further line takes away

Show = Callable[[Mapping[str, Any]], None]


class LiveEstimation:
    """One process for one measurement, from `start` to `close`.

    show : receives every estimate as in `GET /jobs/{id}/estimate`, from a separate
        thread; must return at once
    newest : the newest estimate in the same form, None before the first
    """

    def __init__(self, order: LiveEstimateOrder, show: Show) -> None:
        self._process = ChildProcess(
            "live-estimate", estimate_live, order, niceness=BACKGROUND_NICENESS
        )
        self._queue: queue.Queue[TrackerSamples | PointBlock | LiveCommand | Commanded]
        self._queue = queue.Queue(WAITING_BLOCKS)
        self._parts: queue.SimpleQueue[Part] = queue.SimpleQueue()
        self._show, self._ended = show, threading.Event()
        self._threads = (
            threading.Thread(target=self._feed, name="live-feeder", daemon=True),
            threading.Thread(target=self._listen, name="live-listener", daemon=True),
        )
        self.dropped_blocks = 0
        self.newest: Mapping[str, Any] | None = None

    def start(self) -> None:
        """Start process and threads."""
        self._process.start()
        for thread in self._threads:
            thread.start()

    def offer(self, block: TrackerSamples | PointBlock) -> None:
        """Pass on a committed block. Never waits: a full queue drops the block."""
        try:
            self._queue.put_nowait(block)
        except queue.Full:
            self.dropped_blocks += 1

    @property
    def is_over(self) -> bool:
        """Whether no further estimate or part follows."""
        return self._ended.is_set()

    def request_part(self) -> None:
        """Request the next part, chosen after the blocks so far are processed."""
        with suppress(queue.Full):
            host_clock.put(self._queue, LiveCommand.CHOOSE_PART, FINISH_S)

    def pop_part(self) -> Part | None:
        """Reply to `request_part`, once it is there. Never waits."""
        with suppress(queue.Empty):
            return self._parts.get_nowait()
        return None

    def extend(self, part: Commanded) -> None:
        """Announce the next rows, in addition to the rows so far."""
        with suppress(queue.Full):
            host_clock.put(self._queue, part, FINISH_S)

    def finish(self) -> None:
        """Wait for the last estimate, at most `FINISH_S`."""
        with suppress(queue.Full):
            host_clock.put(self._queue, LiveCommand.END, FINISH_S)
            host_clock.wait(self._ended, FINISH_S)

    def close(self) -> None:
        """Kill the process. Idempotent."""
        if self._process.process_id is None:
            self._process.close()
            return
        self._process.kill()
        with suppress(queue.Full):
            self._queue.put_nowait(LiveCommand.END)  # ends the feeder
        for thread in self._threads:
            host_clock.join(thread, FINISH_S)
        self._process.close()

    def _feed(self) -> None:
        with suppress(OSError):
            while True:
                message = host_clock.get(self._queue)
                self._process.link.send(message)
                if message is LiveCommand.END:
                    return

    def _listen(self) -> None:
        link, made_s = self._process.link, 0.0
        with suppress(EOFError, OSError):
            while True:
                if not link.poll(PERIOD_S):
                    self._show_newest(host_clock.now_s() - made_s)
                    continue
                match link.recv():
                    case Estimated(body):
                        self.newest, made_s = body, host_clock.now_s()
                        self._show_newest(0.0)
                    case PartChosen(part):
                        self._parts.put(part)
                    case EstimateFailed(reason):
                        log.warning("no live estimate any more", reason=reason)
        self._ended.set()

    def _show_newest(self, age_s: float) -> None:
        if self.newest is not None:
            more = {"age_s": round(age_s, 3), "dropped_blocks": self.dropped_blocks}
            self._show({**self.newest, **more})


@dataclass(slots=True)
class LiveSteering:
    """Steers a measurement by its live estimate: further parts, or an early end.

    Without a further part, or without a reply in time, the measurement ends in order;
    an estimate that is not usable without reservation reaches no target, unless it is
    for places that differ: that is in its uncertainty, and would stay. One thread.

    commanded : the first part of an adaptive measurement; None for one planned in full
    target_um : volumetric uncertainty (k = 1) at which the rest is omitted
    on_part : receives all rows after each part, and the body of the event `plan`
    on_again : receives all rows, where some are about to be repeated
    on_target : receives the estimate that has reached the target
    on_notices : receives all notices so far
    planned : rows that are executed part by part
    """

    live: LiveEstimation
    cell: Cell | CellSupervisor
    commanded: Commanded | None
    target_um: float | None
    on_part: Callable[[Commanded, Mapping[str, Any]], None]
    on_target: Show = lambda _: None
    on_notices: Callable[[Sequence[Mapping[str, Any]]], object] = lambda _: None
    planned: PlannedRows | None = None
    on_again: Callable[[Commanded], object] = lambda _: None
    _is_next_due: bool = False
    _reply_by: float | None = None
    _parts: int = 1
    _is_concluded: bool = False

    def handle(self, event: CellEvent) -> None:
        """Pass recorded blocks on; request the part that the machine waits for."""
        match event:
            case BlockRecorded(block):
                self.live.offer(block)
            case LinesDamaged(_, again) if again is not None:
                self.live.extend(again)
            case LinesDamaged(row) if self.planned is not None:
                self.planned.repeat(row)
            case PartRequested() if self.planned is not None:
                self._is_next_due = True
            case PartRequested() if self.commanded is not None:
                self._reply_by = host_clock.now_s() + ANSWER_S
                self.live.request_part()
            case _:
                pass

    def advance(self, *, may_conclude: bool = True) -> None:
        """Report notices; conclude at the target, else pass on the next part.

        Never waits.
        """
        if self.live.newest:
            self.on_notices(self.live.newest.get("notices", ()))
        if self._is_concluded:
            return
        newest = self.live.newest if may_conclude else None
        if newest and self._has_reached(newest):
            self._is_concluded = True
            self.cell.send(CellVerb.CONCLUDE)
            self.on_target(newest)
        elif self._reply_by is not None and self.commanded is not None:
            self._pass_on_part(self.commanded, self._reply_by)
        elif self._is_next_due and self.planned is not None and may_conclude:
            self._is_next_due = False
            self._command_next(self.planned)

    def count_total(self, total: int) -> int:
        """Total of lines or points, as known so far."""
        return total if self.planned is None else max(total, self.planned.total)

    def _command_next(self, planned: PlannedRows) -> None:
        total = planned.total
        part = planned.next()
        if part is None:
            self.cell.send(CellVerb.CONCLUDE)
            return
        if planned.total > total:  # needed to resume
            self.on_again(planned.rows)
        self.live.extend(part)
        self.cell.extend(part)

    def _has_reached(self, estimate: Mapping[str, Any]) -> bool:
        reached_um = estimate["volumetric_uncertainty_um"]
        grave = [
            r for r in verdict_from_json(estimate["verdict"]).reasons if r.severity
        ]
        is_trusted = all(reason.kind == _IN_UNCERTAINTY for reason in grave)
        return is_trusted and reached_um <= (self.target_um or 0.0)

    def _pass_on_part(self, commanded: Commanded, reply_by: float) -> None:
        part = self.live.pop_part()
        if part is not None:
            self._reply_by = None
            self._add(part, commanded)
        elif self.live.is_over or host_clock.now_s() > reply_by:
            self._reply_by = None
            log.warning("nobody says what to measure next; the measurement ends")
            self.cell.send(CellVerb.CONCLUDE)

    def _add(self, part: Part, commanded: Commanded) -> None:
        if part.commanded is None:
            log.info("no further part", parts=self._parts)
            self.cell.send(CellVerb.CONCLUDE)
            return
        self.commanded = commanded = append_part(commanded, part.commanded)
        self._parts += 1
        body = {
            "part": self._parts,
            "rows": part.rows,
            "total": len(commanded) - isinstance(commanded, Path),
            "duration_s": round(part.duration_s, 3),
            "predicted_um": round(_MICRO * part.predicted_sigma_mm, 4),
        }
        log.info("further part", **body)
        self.on_part(commanded, body)  # kept first: what is driven is in the plan
        self.cell.extend(part.commanded)


class LiveAlerts:
    """The notices of one measurement, in the form of the live estimate.

    policy : action on each
    planned : rows that are executed part by part, so that some can be repeated
    first_row : of the plan, with which the rows of the estimate begin
    before : notices of parts before, which are kept
    """

    def __init__(
        self,
        active: ActiveJob,
        cell: CellSupervisor,
        policy: OnNotice,
        planned: PlannedRows | None,
        *,
        first_row: int = 0,
        before: tuple[LiveNotice, ...] = (),
    ) -> None:
        self._active, self._cell = active, cell
        self._policy, self._planned = policy, planned
        self._before, self._first_row = before, first_row
        self._numbered = max((each.number for each in before), default=0)
        self._known_notices: dict[int, LiveNotice] = {}

    def show(self, notices: Sequence[Mapping[str, Any]]) -> None:
        """Publish new or renamed notices; act on new ones."""
        is_obeyed = self._obey()
        news = [n for n in map(self._read, notices) if self._is_news(n)]
        fresh = [n for n in news if n.number not in self._known_notices]
        for notice in fresh:
            self._act(notice)
        if news or is_obeyed:
            self.store_notices(notices)
        for notice in news:
            body = asdict(self._known_notices[notice.number])
            log.info("noticed", **body)
            self._active.publish("notice", {**body, "action": str(body["action"])})

    def store_notices(self, notices: Sequence[Mapping[str, Any]]) -> None:
        """Store the present notices with the job."""
        present = tuple(self._read(each) for each in notices)
        self._known_notices = {each.number: each for each in present}
        try:
            self._active.store_values(notices=(*self._before, *present))
        except StorageUnavailable:
            log.exception("notices are not stored; the measurement goes on")

    def _read(self, body: Mapping[str, Any]) -> LiveNotice:
        notice = decode_notice(body)
        number = self._numbered + notice.number
        known = self._known_notices.get(number)
        return replace(
            notice,
            number=number,
            since_row=self._first_row + notice.since_row,
            noticed_row=self._first_row + notice.noticed_row,
            action=self._policy if known is None else known.action,
        )

    def _is_news(self, notice: LiveNotice) -> bool:
        known = self._known_notices.get(notice.number)
        return known is None or known.heading != notice.heading

    def _act(self, notice: LiveNotice) -> None:
        if self._policy is OnNotice.PAUSE:
            try:
                self._active.pause(self._cell)
            except (IllegalTransition, StorageUnavailable) as error:
                log.warning("no pause is stored for a notice", reason=str(error))
        else:
            self._measure_again(self._policy, notice)

    def _obey(self) -> bool:
        wanted = self._active.pop_notice_action()
        newest = max(self._known_notices, default=None)
        if wanted is None or newest is None:
            return False
        self._known_notices[newest] = replace(
            self._known_notices[newest], action=wanted
        )
        self._measure_again(wanted, self._known_notices[newest])
        return True

    def _measure_again(self, how: OnNotice, notice: LiveNotice) -> None:
        if self._planned is None or how not in (OnNotice.CHECK, OnNotice.REPLAN):
            return
        first = notice.since_row - self._first_row - (how is OnNotice.CHECK)
        log.info("measure again", from_row=first)
        self._planned.repeat(first)


def add_to_result(file: FilePath, notices: Sequence[LiveNotice]) -> None:
    """Add the notices, if any, to the result file."""
    if notices and file.is_file():
        content = json.loads(file.read_text(encoding="utf-8"))
        content["notices"] = [asdict(each) for each in notices]
        replace_file(file, encode_json(content))
