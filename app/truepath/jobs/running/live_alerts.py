"""Notices of the live estimate: published at once, stored with the job, acted on."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import structlog

from truepath.catalogue.errors import StorageUnavailable
from truepath.catalogue.live_notice import LiveNotice, OnNotice, decode_notice
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import replace_file
from truepath.errors import IllegalTransition
from truepath.jobs.running.active_job import ActiveJob
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.motion.paths.plan_segments import PlannedRows

log = structlog.get_logger(__name__)


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
        self._shown: dict[int, LiveNotice] = {}

    def show(self, told: Sequence[Mapping[str, Any]]) -> None:
        """Publish new or renamed notices; act on new ones."""
        is_obeyed = self._obey()
        news = [n for n in map(self._read, told) if self._is_news(n)]
        fresh = [n for n in news if n.number not in self._shown]
        for notice in fresh:
            self._act(notice)
        if news or is_obeyed:
            self.keep(told)
        for notice in news:
            body = asdict(self._shown[notice.number])
            log.info("noticed", **body)
            self._active.publish("notice", {**body, "action": str(body["action"])})

    def keep(self, told: Sequence[Mapping[str, Any]]) -> None:
        """Store the present notices with the job."""
        notices = tuple(self._read(each) for each in told)
        self._shown = {each.number: each for each in notices}
        try:
            self._active.store_values(notices=(*self._before, *notices))
        except StorageUnavailable:
            log.exception("notices are not stored; the measurement goes on")

    def _read(self, body: Mapping[str, Any]) -> LiveNotice:
        notice = decode_notice(body)
        number = self._numbered + notice.number
        known = self._shown.get(number)
        return replace(
            notice,
            number=number,
            since_row=self._first_row + notice.since_row,
            noticed_row=self._first_row + notice.noticed_row,
            action=self._policy if known is None else known.action,
        )

    def _is_news(self, notice: LiveNotice) -> bool:
        known = self._shown.get(notice.number)
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
        newest = max(self._shown, default=None)
        if wanted is None or newest is None:
            return False
        self._shown[newest] = replace(self._shown[newest], action=wanted)
        self._measure_again(wanted, self._shown[newest])
        return True

    def _measure_again(self, how: OnNotice, notice: LiveNotice) -> None:
        if self._planned is None or how not in (OnNotice.CHECK, OnNotice.REPLAN):
            return
        first = notice.since_row - self._first_row - (how is OnNotice.CHECK)
        log.info("measure again", from_row=first)
        self._planned.repeat(first)


def add_to_result(file: Path, notices: Sequence[LiveNotice]) -> None:
    """Add the notices, if any, to the result file."""
    if notices and file.is_file():
        content = json.loads(file.read_text(encoding="utf-8"))
        content["notices"] = [asdict(each) for each in notices]
        replace_file(file, encode_json(content))
