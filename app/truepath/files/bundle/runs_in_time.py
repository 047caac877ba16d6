"""Runs of one machine, one after the other: their order and their times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from truepath.errors import BadInput
from truepath.files.bundle.one_machine import have_same_targets, one_machine
from truepath.files.bundle.run import Run, digest_run
from truepath.kinematics.machine.machine import Machine


@dataclass(frozen=True, slots=True)
class TimedRun:
    """Time of a Run, and its identity.

    digest : SHA-256 of machine, commanded rows and stream
    started_s : by the clock of the computer that recorded it, if that is known
    span_s : first and last sample by the tracker's clock
    """

    name: str
    machine: Machine
    digest: str
    started_s: float | None
    span_s: tuple[float, float]

    @staticmethod
    def of(run: Run, name: str) -> TimedRun:
        """Raises BadInput if the Run has no samples."""
        time_s = run.tracker.device_time_s
        if not len(time_s):
            raise BadInput(f"{name} has no samples")
        started = run.provenance.get("started")
        return TimedRun(
            name,
            run.machine,
            digest_run(run),
            datetime.fromisoformat(started).timestamp() if started else None,
            (float(time_s[0]), float(time_s[-1])),
        )


@dataclass(frozen=True, slots=True)
class RunsInTime:
    """One machine and the middle of each of its Runs, s from any origin."""

    machine: Machine
    time_s: tuple[float, ...]


def order_in_time(
    runs: Sequence[TimedRun], stated_s: Sequence[float] | None
) -> RunsInTime:
    """The machine of several Runs and when each was.

    stated_s : the middle of each as known to the user; else by the clocks

    Raises BadInput if a Run is given twice, if they are of different machines or
    targets, or if their order of time is not known or not kept.
    """
    if len(runs) < 2:
        raise BadInput("one Run tells nothing of time: give two at least")
    _reject_twice(runs)
    machine = one_machine([run.machine for run in runs], [run.name for run in runs])
    for run in runs[1:]:
        if not have_same_targets(runs[0].machine, run.machine):
            raise BadInput(
                f"{run.name} has other targets, or another tool, than {runs[0].name}: "
                "follow those apart"
            )
    time_s = tuple(_find_times(runs) if stated_s is None else stated_s)
    if len(time_s) != len(runs):
        raise BadInput(f"{len(time_s)} times are given for {len(runs)} Runs")
    for one, other, before, after in zip(
        runs, runs[1:], time_s, time_s[1:], strict=False
    ):
        if not 0.0 < after - before < math.inf:
            raise BadInput(
                f"the times do not increase from {one.name} to {other.name}: sort the "
                "Runs by time"
            )
    return RunsInTime(machine, time_s)


def _reject_twice(runs: Sequence[TimedRun]) -> None:
    known: dict[str, str] = {}
    for run in runs:
        if run.digest in known:
            raise BadInput(
                f"{known[run.digest]} and {run.name} are the same Run (SHA-256 "
                f"{run.digest[:16]}…): give it once"
            )
        known[run.digest] = run.name


def _find_times(runs: Sequence[TimedRun]) -> list[float]:
    halves = [0.5 * (run.span_s[1] - run.span_s[0]) for run in runs]
    started = [run.started_s for run in runs if run.started_s is not None]
    if len(started) == len(runs):
        return [begin + half for begin, half in zip(started, halves, strict=True)]
    for one, other in pairwise(runs):
        if other.span_s[0] <= one.span_s[1]:
            raise BadInput(
                f"the tracker's clock has begun anew between {one.name} and "
                f"{other.name}, so that their order of time is not known: state the "
                "middle of each Run in hours (--at, at_h)"
            )
    return [0.5 * sum(run.span_s) for run in runs]
