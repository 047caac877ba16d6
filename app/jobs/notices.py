"""What the live estimate notices, told as soon as it is and kept with the job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import structlog

from app.jobs.active_job import ActiveJob
from app.jobs.errors import StorageUnavailable
from app.jobs.job import LiveNotice, decode_notice

log = structlog.get_logger(__name__)


class NoticeBoard:
    """The notices of one measurement, in the words of the live estimate."""

    def __init__(self, active: ActiveJob) -> None:
        self._active = active
        self._shown: dict[int, LiveNotice] = {}

    def show(self, told: Sequence[Mapping[str, Any]]) -> list[LiveNotice]:
        """Tell what is new or has another name; return what is new."""
        notices = [decode_notice(each) for each in told]
        news = [n for n in notices if self._is_news(n)]
        fresh = [n for n in news if n.number not in self._shown]
        if news:
            self.keep(told)
        for notice in news:
            log.info("noticed", **told[notices.index(notice)])
            self._active.publish("notice", told[notices.index(notice)])
        return fresh

    def keep(self, told: Sequence[Mapping[str, Any]]) -> None:
        """Store the notices with the job, as they are now."""
        notices = tuple(decode_notice(each) for each in told)
        self._shown = {each.number: each for each in notices}
        try:
            self._active.store_values(notices=notices)
        except StorageUnavailable:
            log.exception("notices are not stored; the measurement goes on")

    def _is_news(self, notice: LiveNotice) -> bool:
        known = self._shown.get(notice.number)
        return known is None or known.heading != notice.heading
