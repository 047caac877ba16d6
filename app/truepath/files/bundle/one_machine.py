"""Several Runs of one machine: their common machine, and all its targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from truepath.errors import BundleError
from truepath.files.bundle.machine_file import machine_to_json
from truepath.kinematics.machine.machine import Machine, Target

_SAME_TARGET_MM = 1e-6


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
    return one.on == other.on and max(away) < _SAME_TARGET_MM


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
