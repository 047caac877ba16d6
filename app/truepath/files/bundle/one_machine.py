"""Several Runs of one machine: their common machine, its targets, their times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from typing import Any

from truepath.errors import BadInput, BundleError
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.bundle.run import Run, digest_run
from truepath.kinematics.machine.machine import Machine, Target


def one_machine(machines: Sequence[Machine], names: Sequence[str]) -> Machine:
    """The machine of all Runs, with the targets of all.

    names : of the Runs, in the same order

    The tracker is that of the first. A target keeps its name where no other has it,
    else it is named by its Run as well; the first of the first Run stays the first.
    Raises BundleError naming Run and field if the machines are not one and the same.
    """
    first = machines[0]
    for machine, name in zip(machines[1:], names[1:], strict=True):
        _require_same(first, machine, names[0], name)
    targets: list[Target] = []
    for machine, name in zip(machines, names, strict=True):
        for target in machine.targets:
            if not any(_is_same(target, other) for other in targets):
                targets.append(_rename(target, targets, name))
    if len(targets) > 1 and not targets[0].name:
        targets[0] = _rename(targets[0], targets[1:], names[0])
    return replace(first, targets=tuple(targets))


def have_same_targets(one: Machine, other: Machine) -> bool:
    """Same sides and offsets, to 1 nm; names do not matter."""
    return len(one.targets) == len(other.targets) and all(
        any(_is_same(target, known) for known in other.targets)
        for target in one.targets
    )


def list_differences(before: Machine, now: Machine) -> list[str]:
    """Each changed field of the machine file, as a sentence."""
    was, found = (dict(_flatten(machine_to_json(one))) for one in (before, now))
    return [
        f"{field} is {_show(found.get(field))} and was {_show(was.get(field))}"
        for field in {**was, **found}
        if was.get(field) != found.get(field)
    ]


def _require_same(first: Machine, other: Machine, first_run: str, run: str) -> None:
    expected, found = (dict(_flatten(_state_identity(m))) for m in (first, other))
    for field in {**expected, **found}:
        if expected.get(field) != found.get(field):
            raise BundleError(
                f"{field} is {_show(found.get(field))}, but "
                f"{_show(expected.get(field))} in {first_run}",
                file=f"{run}/machine.json",
                remedy="analyse Runs of one machine together, others apart",
            )


def _state_identity(machine: Machine) -> dict[str, Any]:
    content = machine_to_json(machine)
    return {
        "name": content["name"],
        "kinematic_chain": content["kinematic_chain"],
        "axes": content["axes"],
        "tracker": {"stands_on": content["tracker"]["stands_on"]},
    }


def _flatten(content: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _show(value: object) -> str:
    return "missing" if value is None else str(value)


def _is_same(one: Target, other: Target) -> bool:
    away = [abs(a - b) for a, b in zip(one.offset_mm, other.offset_mm, strict=True)]
    return one.on == other.on and max(away) < 1e-6


def _rename(target: Target, others: Sequence[Target], run: str) -> Target:
    taken = {other.name for other in others}
    if not others or (target.name and target.name not in taken):
        return target
    name = base = f"{run} {target.name}".strip()
    count = 1
    while name in taken:
        count += 1
        name = f"{base} ({count})"
    return replace(target, name=name)


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
