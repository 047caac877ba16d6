"""Cross tables of a SINUMERIK: errors of one axis by another, alone and as a product.

Along the middle of the travel the error of output o is a table of each axis. The effect
of an axis' rotation away from the middle is a product: its angle less that at the
middle, times the distance of a later axis from its own middle; an effect of two axes,
as sag, is one too, as far as it is a product at all. `$AN_CEC_MULT_BY_TABLE` names the
second table by its number, index + 1. Lost motion is a table of negative travel alone.

Source: SINUMERIK Function Manual Extended Functions 03/2013, K3, pages 245 to 252.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import AxisTable
from truepath.kinematics.machine.machine import Machine

FACTOR_MM = 0.1  # largest value of a second table: harmless if it were added alone
_LEAST_MM = 1e-5  # root mean square of a correction: less is not worth a table
_TURNS = np.zeros((3, 3, 3))  # displacement o by the turn k at the lever l
for _o, _k, _l in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _TURNS[_o, _k, _l], _TURNS[_l, _k, _o] = 1.0, -1.0


@dataclass(frozen=True, slots=True)
class Factor:
    """The second table of a product, of another axis.

    value_mm : (m,) FACTOR_MM at most
    """

    axis: str
    position_mm: Float64[np.ndarray, " m"]
    value_mm: Float64[np.ndarray, " m"]


@dataclass(frozen=True, slots=True)
class CrossTable:
    """One table: input axis, output axis, values; all hold the error.

    direction : 0 for both, −1 for negative travel alone
    factor : the table by which it is multiplied; None for a single table
    gain_mm : root mean square of its correction
    """

    axis: str
    out: int
    position_mm: Float64[np.ndarray, " n"]
    value_mm: Float64[np.ndarray, " n"]
    gain_mm: float
    direction: int = 0
    factor: Factor | None = None


def choose_cross_tables(
    machine: Machine, tables: Sequence[AxisTable], most_tables: int, *, backlash: bool
) -> list[CrossTable]:
    """The tables with the largest corrections, as many as the control has.

    most_tables : second tables of products count as well
    backlash : whether lost motion is included
    """
    wanted = [c for t in tables for c in _list_straight(t)]
    wanted += [c for t in tables for c in _list_products(machine, t, tables)]
    wanted += [c for t in tables for c in _list_pairs(t, tables)]
    if backlash:
        wanted += [c for t in tables for c in _list_backlash(t)]
    wanted = [c for c in wanted if c.gain_mm > _LEAST_MM]
    kept: list[CrossTable] = []
    for one in sorted(wanted, key=lambda c: -c.gain_mm):
        more = [*kept, one]
        if len(more) + len(list_factors(more)) <= most_tables:
            kept.append(one)
    return sorted(kept, key=lambda c: (c.factor is not None, -c.direction))


def list_factors(chosen: Sequence[CrossTable]) -> list[tuple[int, Factor]]:
    """Second tables with their output axes, each once."""
    found: list[tuple[int, Factor]] = []
    for one in chosen:
        if one.factor and not any(_is_same(each, one) for each in found):
            found.append((one.out, one.factor))
    return found


def find_factor(one: CrossTable, factors: Sequence[tuple[int, Factor]]) -> int:
    """Index of a product's second table."""
    return next(k for k, each in enumerate(factors) if _is_same(each, one))


def _is_same(each: tuple[int, Factor], one: CrossTable) -> bool:
    out, factor = each
    mine = one.factor
    return (
        mine is not None
        and out == one.out
        and factor.axis == mine.axis
        and np.array_equal(factor.value_mm, mine.value_mm)
    )


def _list_straight(table: AxisTable) -> Iterator[CrossTable]:
    for out in range(3):
        value = table.mean_mm[:, out]
        if out != table.own:
            yield CrossTable(
                table.axis.name, out, table.position_mm, value, float(value.std())
            )


def _list_backlash(table: AxisTable) -> Iterator[CrossTable]:
    lost = (table.backward_mm - table.forward_mm)[:, table.own]
    gain = 0.5 * float(np.sqrt(np.mean(lost**2)))
    name, at = table.axis.name, table.position_mm
    yield CrossTable(name, table.own, at, lost, gain, direction=-1)


def _list_products(
    machine: Machine, table: AxisTable, tables: Sequence[AxisTable]
) -> Iterator[CrossTable]:
    order = machine.order
    middle = [
        np.interp(_middle(table), table.position_mm, table.rotation_rad[:, k])
        for k in range(3)
    ]
    turn = table.rotation_rad - np.array(middle)
    for later in tables:
        if order.index(later.axis.name) <= order.index(table.axis.name):
            continue
        for out in range(3):
            value = turn @ _TURNS[out, :, later.own]
            if out != later.own:
                lever = later.position_mm - _middle(later)
                yield _multiply(table, out, value, later, lever)


def _list_pairs(table: AxisTable, tables: Sequence[AxisTable]) -> Iterator[CrossTable]:
    pair = table.pair
    if pair is None:
        return
    other = next(t for t in tables if t.axis.name == pair.by.name)
    middle = int(np.argmin(np.abs(pair.by_mm - _middle(other))))
    own = int(np.argmin(np.abs(table.position_mm - _middle(table))))
    error = pair.error_mm - pair.error_mm[middle]
    error = error - error[:, own : own + 1]
    for out in range(3):
        left, size, right = np.linalg.svd(error[:, :, out], full_matrices=False)
        first: Float64[np.ndarray, " m"] = left[:, 0] * size[0]
        by = np.interp(other.position_mm, pair.by_mm, first)
        yield _multiply(table, out, right[0], other, by)


def _multiply(
    table: AxisTable,
    out: int,
    value: Float64[np.ndarray, " n"],
    other: AxisTable,
    lever: Float64[np.ndarray, " m"],
) -> CrossTable:
    scale = FACTOR_MM / max(float(np.abs(lever).max()), 1e-12)
    factor = Factor(other.axis.name, other.position_mm, scale * lever)
    gain = float(value.std() * lever.std())
    one = CrossTable(table.axis.name, out, table.position_mm, value / scale, gain)
    return replace(one, factor=factor)


def _middle(table: AxisTable) -> float:
    return 0.5 * (table.axis.low + table.axis.high)
