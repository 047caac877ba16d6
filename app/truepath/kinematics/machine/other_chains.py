"""Machines that a file may have meant: tracker or axes elsewhere, axes reversed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import reduce
from itertools import islice, permutations, product

from truepath.kinematics.machine.machine import Machine, RotaryAxis


def list_orders(machine: Machine, names: Collection[str]) -> Iterator[Machine]:
    """The machine with these axes in each order, at their places of the chain."""
    own = [name for name in machine.order if name in names]
    for order in permutations(own):
        new = dict(zip(own, order, strict=True))
        sides = machine.workpiece_side, machine.tool_side
        before, behind = (tuple(new.get(n, n) for n in side) for side in sides)
        yield replace(machine, workpiece_side=before, tool_side=behind)


def list_other_machines(machine: Machine) -> Iterator[Machine]:
    """Variants of the machine that move the target differently.

    The tracker stands on the other side, or rotary axes count the other way, follow one
    another in another order or are all on the other side, or one axis is.
    """
    beside = "base" if machine.tracker.stands_on == "workpiece" else "workpiece"
    yield replace(machine, tracker=replace(machine.tracker, stands_on=beside))
    rotary = machine.rotary_axes
    names = [axis.name for axis in rotary]
    placed = [*list_orders(machine, names)]  # the first is the machine itself
    placed += [reduce(_move_across, some, machine) for some in permutations(names)]
    placed += [_move_across(machine, name) for name in machine.order]
    turns = product((False, True), repeat=len(rotary))
    for turned, other in islice(product(turns, placed), 1, None):
        back = dict(zip(names, turned, strict=True))
        axes = tuple(
            _turn(a) if isinstance(a, RotaryAxis) and back[a.name] else a
            for a in other.axes
        )
        yield replace(other, axes=axes)


@dataclass(frozen=True, slots=True)
class Difference:
    """What another machine has instead, for reports.

    other, declared : noun phrases; remedy : what to write in its file
    """

    other: str
    declared: str
    remedy: str


def describe_other(machine: Machine, other: Machine) -> Difference:
    """The other place of the tracker, or chain and axes that count the other way."""
    stands_on = other.tracker.stands_on
    if stands_on != machine.tracker.stands_on:
        there, here = (_PLACES[m.tracker.stands_on] for m in (other, machine))
        return Difference(there, here, f'"stands_on": "{stands_on}" in tracker')
    back = [b for b in other.rotary_axes if b != machine.rotary(b.name)]
    counted = " and ".join(f"axis {b.name} counted the other way" for b in back)
    fits = f"chain {other.chain}" + f" with {counted}" * bool(back)
    remedies = [f'"direction": {[*map(float, b.direction)]} in {b.name}' for b in back]
    if other.chain != machine.chain:
        remedies.insert(0, f'"kinematic_chain": "{other.chain}"')
    return Difference(fits, machine.chain, " and ".join(remedies))


_PLACES = {"workpiece": "a tracker on the table", "base": "a tracker on the floor"}


def _turn(axis: RotaryAxis) -> RotaryAxis:
    x, y, z = axis.direction
    return replace(axis, direction=(0.0 - x, 0.0 - y, 0.0 - z))


def _move_across(machine: Machine, name: str) -> Machine:
    before, behind = (
        [n for n in s if n != name] for s in (machine.workpiece_side, machine.tool_side)
    )
    if name in machine.workpiece_side:
        behind.append(name)
    else:
        before.insert(0, name)
    return replace(machine, workpiece_side=tuple(before), tool_side=tuple(behind))
