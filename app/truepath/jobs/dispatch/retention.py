"""Deletion by age according to the settings; dependencies are kept.

Expired keys and events are pruned too. Calibrations in the history of a machine stay,
and so does every Run of a result. Superseded analyses, verifications, plans, failed
jobs and their Runs are deleted when old enough.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import structlog

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.errors import StillNeeded, StorageUnavailable
from truepath.catalogue.job import format_utc
from truepath.errors import NotFound, TruepathError
from truepath.jobs.dispatch.deletion import Deletion, Note
from truepath.jobs.running.context import JobContext
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)

EVERY_S = 3600.0
FIRST_S = 60.0
MOST_AHEAD = timedelta(days=30)
"""How far the clock may be ahead of the newest job: else it may be wrong."""
_PAGE = 200


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """Days for which Runs, and jobs with their answers, are kept; 0 is for ever."""

    keep_runs_days: int = 0
    keep_results_days: int = 0


class Retention:
    """Periodic deletion in a separate thread.

    note : records each deletion, in its transaction
    is_measuring : nothing is deleted while it is true
    """

    def __init__(
        self,
        context: JobContext,
        calibrations: Calibrations,
        deletion: Deletion,
        rules: RetentionRules,
        note: Note,
        is_measuring: Callable[[], bool],
    ) -> None:
        self._context, self._calibrations = context, calibrations
        self._deletion, self._rules, self._note = deletion, rules, note
        self._is_measuring = is_measuring
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="retention")

    def start(self) -> None:
        """Start the thread; files left by earlier deletions are removed first."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread after the current deletion."""
        self._closing.set()
        if self._thread.is_alive():
            host_clock.join(self._thread)

    def sweep(self, now: datetime | None = None) -> int:
        """Delete expired items; gives their number. Raises StorageUnavailable.

        Deletes nothing where the clock is behind the newest job, or `MOST_AHEAD` of it.
        """
        now = now or datetime.now(UTC)
        self._context.store.prune()
        self._deletion.remove_files()
        if not self._is_plausible(now):
            return 0
        count = 0
        if days := self._rules.keep_results_days:
            count += self._sweep_jobs(now - timedelta(days=days))
        if days := self._rules.keep_runs_days:
            count += self._sweep_runs(now - timedelta(days=days))
        if count:
            log.info("kept long enough", deleted=count)
        return count

    def _is_plausible(self, now: datetime) -> bool:
        newest = self._context.store.find_newest_created()
        if newest is None or newest <= now <= newest + MOST_AHEAD:
            return True
        if self._rules != RetentionRules():
            log.warning(
                "nothing is deleted: the clock does not go with the newest job; set it "
                "right, or make any job where it is",
                clock=format_utc(now),
                newest_job=format_utc(newest),
            )
        return False

    def _sweep_jobs(self, before: datetime) -> int:
        history = self._list_history()
        count, seq = 0, None
        while page := self._context.store.list_page(_PAGE, before_seq=seq):
            seq = page[-1].seq
            for job in page:  # the newest first: it may depend on an older one
                is_old = job.is_final and (job.ended or job.created) < format_utc(
                    before
                )
                if is_old and job.id not in history:
                    count += self._try(
                        lambda i=job.id: self._deletion.delete_job(i, self._note)
                    )
        return count

    def _sweep_runs(self, before: datetime) -> int:
        count, seq = 0, None
        while page := self._context.runs.list_page(_PAGE, before_seq=seq, until=before):
            seq = page[-1].seq
            for run in page:
                count += self._try(
                    lambda i=run.id: self._deletion.delete_run(i, note=self._note)
                )
        return count

    def _try(self, delete: Callable[[], object]) -> int:
        if self._closing.is_set() or self._is_measuring():
            return 0
        try:
            delete()
        except (StillNeeded, NotFound) as error:
            log.debug("kept", reason=str(error))
            return 0
        except StorageUnavailable:
            raise
        except TruepathError as error:  # of this one: the others continue
            log.warning("not deleted", reason=str(error))
            return 0
        return 1

    def _list_history(self) -> set[str]:
        machines = self._context.store.list_machines()
        found = (self._calibrations.list_of(machine) for machine in machines)
        return {one.job_id for calibrations in found for one in calibrations}

    def _run(self) -> None:
        pause_s = FIRST_S
        while not host_clock.wait(self._closing, pause_s):
            pause_s = EVERY_S
            try:
                self.sweep()
            except (TruepathError, OSError) as error:
                log.warning("nothing more is deleted for now", reason=str(error))
            except Exception:
                log.exception("nothing more is deleted for now")
