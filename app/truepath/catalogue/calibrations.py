"""The calibrations of each machine, and its status by them.

A calibration is a job with error tables. Where the same Runs were analysed again, the
newest analysis replaces the others. Whether a machine exceeds its tolerance, or has
changed since its reference, follows from its newest usable calibration.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import structlog

from truepath.answers.machine_history import (
    RESULT,
    Calibration,
    ToleranceJudgement,
    assess_tolerance,
    changes_json,
    read_result_content,
)
from truepath.catalogue.job import Job, JobEvent, format_utc
from truepath.catalogue.machine_registry import MachineRecord, MachineRegistry
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.errors import BadInput, NotFound, TruepathError

log = structlog.get_logger(__name__)

NOT_USABLE = "not-usable"


@dataclass(frozen=True, slots=True)
class CalibrationStatus:
    """Status of a machine by its newest usable calibration.

    job_id : of that calibration; None where there is none
    tolerance : None where none is stated
    has_changed : since the reference; None where there is no reference to compare with
    text : what has changed, or why that is unknown
    is_reference_lost : the reference calibration cannot be used
    """

    machine: str
    job_id: str | None = None
    tolerance: ToleranceJudgement | None = None
    reference_job: str | None = None
    has_changed: bool | None = None
    text: str = ""
    is_reference_lost: bool = False

    @property
    def is_alarm(self) -> bool:
        """Whether the machine needs attention: over tolerance, or changed."""
        is_over = self.tolerance is not None and self.tolerance.state == "over"
        return is_over or bool(self.has_changed)

    def describe(self) -> dict[str, Any]:
        """Body of its event."""
        tolerance = self.tolerance
        return {
            "machine": self.machine,
            "calibration": self.job_id,
            "is_alarm": self.is_alarm,
            "tolerance": None if tolerance is None else tolerance.state,
            "tolerance_text": "" if tolerance is None else tolerance.text,
            "reference_job": self.reference_job,
            "has_changed": self.has_changed,
            "change_text": self.text,
        }


class Calibrations:
    """Calibrations of the machines in the catalogue; thread-safe.

    publish : receives the status of a machine whenever it changes
    """

    def __init__(
        self,
        registry: MachineRegistry,
        store: Store,
        runs: RunCatalogue,
        results: Path,
        publish: Callable[[JobEvent], None],
    ) -> None:
        self._registry, self._store, self._runs = registry, store, runs
        self._results, self._publish = results, publish
        self._lock = threading.Lock()
        self._status: dict[str, CalibrationStatus] = {}

    def list_of(self, machine_id: str) -> list[Calibration]:
        """The oldest measured first; one per set of Runs."""
        newest: dict[object, Calibration] = {}
        for job in self._store.list_with_result(machine_id):
            file = self._results / job.id / RESULT
            if file.is_file():
                key = tuple(sorted(job.run_ids)) or (job.id,)
                newest[key] = self._describe(job, file)
        # The same Run may have come twice, under two names.
        once = {_list_inputs(c) or c.job_id: c for c in newest.values()}
        return sort_by_time([(c, self._find_order(c)) for c in once.values()])

    def list_usable(self, machine_id: str) -> list[Calibration]:
        """Those whose verdict is not `not-usable`."""
        return [c for c in self.list_of(machine_id) if c.verdict != NOT_USABLE]

    def find(self, machine_id: str, job_id: str) -> Calibration:
        """Raises NotFound where the job has no result of this machine."""
        for job in self._store.list_with_result(machine_id):
            file = self._results / job.id / RESULT
            if job.id == job_id and file.is_file():
                return self._describe(job, file)
        raise NotFound(f"job {job_id} is no calibration of machine {machine_id}")

    def find_usable(self, machine_id: str, job_id: str) -> Calibration:
        """A calibration to compare others with. Raises BadInput."""
        remedy = f"name a usable one of `GET /machines/{machine_id}/history`"
        try:
            found = self.find(machine_id, job_id)
        except NotFound as error:
            raise BadInput(f"{error}; {remedy}") from error
        if found.verdict == NOT_USABLE:
            raise BadInput(f"the result of job {job_id} is not to be used; {remedy}")
        return found

    def find_calibration_status(self, machine_id: str) -> CalibrationStatus | None:
        """Status as found by the last `update_status`; None before it."""
        return self._status.get(machine_id)

    def update_status(self, machine_id: str) -> None:
        """Update the status of a machine, and publish it if it has changed.

        Raises nothing: a measurement has ended well whatever its history says.
        """
        try:
            now = self._find_status(self._registry.get(machine_id))
        except (TruepathError, OSError, ValueError, KeyError) as error:
            log.warning("no standing", machine=machine_id, reason=str(error))
            return
        with self._lock:
            before = self._status.get(machine_id)
            self._status[machine_id] = now
        if now != before:
            level = log.warning if now.is_alarm else log.info
            level("machine stands", **now.describe())
            self._publish(JobEvent("machine", None, now.describe()))

    def assess_all(self) -> None:
        """Update the status of every machine."""
        for record in self._registry.list_all():
            self.update_status(record.id)

    def _describe(self, job: Job, file: Path) -> Calibration:
        created = [self._runs.get(run_id).created for run_id in job.run_ids]
        catalogued = Calibration(
            str(job.machine),
            job.id,
            job.run_ids,
            min(created, default=job.created),
            job.machine_version,
            job.verdict,
            file,
            is_time_stated=False,
        )
        started = _find_start(catalogued)
        if started is None:
            return catalogued
        return replace(catalogued, measured=started, is_time_stated=True)

    def _find_order(self, one: Calibration) -> int | None:
        runs = [self._runs.get(run_id) for run_id in one.run_ids]
        recorded = [run.seq for run in runs if run.origin == "measured"]
        return min(recorded) if recorded and len(recorded) == len(runs) else None

    def _find_status(self, record: MachineRecord) -> CalibrationStatus:
        usable = self.list_usable(record.id)
        if not usable:
            return CalibrationStatus(record.id)
        *earlier, newest = usable
        tolerance = None
        if record.tolerance_um is not None:
            tolerance = assess_tolerance(newest, record.tolerance_um)
        if record.reference_job is not None:
            try:
                reference = self.find_usable(record.id, record.reference_job)
            except BadInput as error:
                return CalibrationStatus(
                    record.id,
                    newest.job_id,
                    tolerance,
                    record.reference_job,
                    text=f"changes are not watched: {error}",
                    is_reference_lost=True,
                )
            earlier = [reference] if reference.job_id != newest.job_id else []
        if not earlier:
            text = "there is no earlier usable calibration to compare with"
            return CalibrationStatus(record.id, newest.job_id, tolerance, text=text)
        found = _compare(earlier[-1], newest)
        return CalibrationStatus(
            record.id,
            newest.job_id,
            tolerance,
            earlier[-1].job_id,
            None if found.get("compensation_changed") else found.get("has_changed"),
            " ".join(found["text"]),
        )


def sort_by_time(
    found: Sequence[tuple[Calibration, int | None]],
) -> list[Calibration]:
    """Calibrations, the oldest measured first.

    Those of Runs recorded here keep the order of the catalogue: a clock may have been
    wrong. Others, of place None, are sorted in by time.
    """
    recorded = sorted(
        ((c, order) for c, order in found if order is not None),
        key=lambda pair: (pair[1], pair[0].job_id),
    )
    keys: list[tuple[tuple[bool, str, int, str], Calibration]] = []
    until = None
    for n, (c, _) in reversed(list(enumerate(recorded))):
        until = c.measured if until is None else min(until, c.measured)
        keys.append(((True, until, n, c.job_id), c))
    keys += [
        ((c.is_time_stated, c.measured, len(recorded), c.job_id), c)
        for c, order in found
        if order is None
    ]
    return [c for _, c in sorted(keys, key=lambda pair: pair[0])]


def _find_start(one: Calibration) -> str | None:
    runs = read_result_content(one).get("runs") or ()
    stated = [run.get("source", {}).get("started") for run in runs]
    times = [
        datetime.fromisoformat(str(each)).astimezone(UTC) for each in stated if each
    ]
    return format_utc(min(times)) if times else None


def _list_inputs(one: Calibration) -> frozenset[str]:
    runs = read_result_content(one).get("provenance", {}).get("runs") or ()
    return frozenset(str(run["input_sha256"]) for run in runs)


def _compare(since: Calibration, until: Calibration) -> Mapping[str, Any]:
    try:
        return changes_json(since, until)
    except TruepathError as error:  # other targets, another machine file
        return {"text": [f"not comparable: {error}"]}
