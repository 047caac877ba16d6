"""Machines that a machine file may have meant: axes elsewhere, or reversed."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
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

    Rotary axes count the other way, follow one another in another order or are all on
    the other side, or one axis is.
    """
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


def describe_other(machine: Machine, other: Machine) -> str:
    """Text for reports: the other chain, and axes that count the other way."""
    axes = zip(machine.axes, other.axes, strict=True)
    back = [f"axis {a.name} counted the other way" for a, b in axes if a != b]
    return f"chain {other.chain}" + " with " * bool(back) + " and ".join(back)


def _turn(axis: RotaryAxis) -> RotaryAxis:
    x, y, z = axis.direction
    return replace(axis, direction=(-x, -y, -z))


def _move_across(machine: Machine, name: str) -> Machine:
    before, behind = (
        [n for n in s if n != name] for s in (machine.workpiece_side, machine.tool_side)
    )
    if name in machine.workpiece_side:
        behind.append(name)
    else:
        before.insert(0, name)
    return replace(machine, workpiece_side=tuple(before), tool_side=tuple(behind))
