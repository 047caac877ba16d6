"""The check of formats, for any author to run: `write` and `read` keep every value.

With pytest:

    from truepath.compensation.conformance import CHECKS

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_my_format_conforms(check):
        check(MyFormat())
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import (
    AxisTable,
    CompensationFormat,
    CompensationTables,
)
from truepath.files.units import UM_PER_MM
from truepath.kinematics.effects.conformance import NotConforming, require
from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.symbols import LINEAR
from truepath.kinematics.machine.tracker_noise import TrackerNoise

UNPROVED = (
    "the format reads its own files, so a sign or unit that is wrong in write and read "
    "alike is not seen: try one value at the machine; nor are other choices than the "
    "default, rotary axes, effects of two axes, and tables by temperature"
)
_ROWS, _LOW_MM, _HIGH_MM = 21, -100.0, 400.0
_MIDDLE_MM = 0.5 * (_LOW_MM + _HIGH_MM)
_RESOLUTIONS = 1.5  # of the value, of that at the reference, and of a second column
_NOTHING_MM = 1e-9
_LEAST = 0.05  # factor on the values; below it they are all but nothing
_FACTORS = {1e3: "in µm for mm", 1e-3: "in mm for µm", 1e6: "in nm for mm"}
_SIDES = {
    "each": "each direction by itself",
    "mean": "the mean of both",
    "+": "the + direction for both",
    "-": "the - direction for both",
}
_STATED = {"each by itself": ("each",), "mean of both": ("mean",)}

_Sides = Float64[np.ndarray, "2 n"]
"""Addition in + and in − direction, less that at the reference row, mm."""


def what_is_read_back_is_minus_the_error(kind: CompensationFormat) -> None:
    """Known errors, written and read back, come as minus the errors.

    Raises NotConforming with what was expected and read, and the probable cause.
    """
    content = _make_content(kind)
    correct = kind.read(kind.write(content), content.machine)
    wanted = {
        (table.axis.name, out): _list_wanted(table, column)
        for table in content.tables
        for column, out in enumerate(LINEAR)
    }
    read: dict[tuple[str, str], _Sides] = {}
    for table in content.tables:
        place = np.full((len(table.position_mm), 3), _MIDDLE_MM)
        place[:, table.own] = table.position_mm
        added = np.array([correct(place, side) for side in (1.0, -1.0)])
        require(
            added.shape[1:] == place.shape,
            f"the correction at {len(place)} positions has the shape "
            f"{added.shape[1:]}, expected {place.shape}",
        )
        for column, out in enumerate(LINEAR):
            sides = _refer(added[:, :, column], table, out)
            if not np.abs(sides).max() <= _NOTHING_MM:  # NaN is something too
                read[table.axis.name, out] = sides
                _compare(kind, table, out, sides, wanted)
    require(
        bool(read),
        "the files, read back, add nothing anywhere: expected minus the errors of "
        "`content.tables`",
    )
    own = [name for name in LINEAR if (name, name) in read]
    lacking = [name for name in LINEAR if name not in own]
    require(
        not own or not lacking,
        f"along itself {', '.join(own)} is read back, {', '.join(lacking)} not: "
        "expected rows of every axis",
    )


CHECKS = (what_is_read_back_is_minus_the_error,)


def _make_content(kind: CompensationFormat) -> CompensationTables:
    axes = tuple(LinearAxis(name, _LOW_MM, _HIGH_MM) for name in LINEAR)
    target = Target("T", "tool", (0.0, 0.0, 0.0))
    machine = Machine("example", (), LINEAR, axes, (target,), TrackerNoise())
    most = kind.limit_rows(axes, (_HIGH_MM - _LOW_MM) / (_ROWS - 1))
    size_mm = max(kind.resolution_um, 1.0) / UM_PER_MM
    tables = tuple(_make_table(axis, most[axis.name], size_mm) for axis in axes)
    return CompensationTables("check", machine, tables, ("check of a format",))


def _make_table(axis: LinearAxis, most: int, size_mm: float) -> AxisTable:
    """Another error in each column, which no other row or direction has."""
    count = min(_ROWS, most)
    count -= count > 2 and count % 2 == 0  # the middle is a row
    at_mm, own = np.linspace(axis.low, axis.high, count), LINEAR.index(axis.name)
    zero = int(np.argmin(np.abs(at_mm)))
    share = np.linspace(-1.0, 1.0, count)
    slope = np.array([[7.0, -9.0, 11.0], [8.0, 10.0, -6.0], [-12.0, 5.0, 13.0]])[own]
    zigzag = 2.0 * (-1.0) ** np.arange(count)
    motion = size_mm * (slope * share[:, None] + zigzag[:, None])
    motion -= motion[zero]
    # 0 in the middle too: an axis that stands there turns none that moves.
    bow = share * (share - share[zero]) * (count > 2)
    turn = size_mm / _HIGH_MM * bow[:, None] * np.array([2.0, -3.0, 4.0])
    lever = np.where(np.arange(3) > own, _MIDDLE_MM, 0.0)
    half = np.zeros((count, 3))
    half[:, own] = size_mm * (2.0 + 0.5 * share)
    mean = motion + np.cross(turn, lever) - half[zero]
    return AxisTable(axis, at_mm, zero, mean + half, mean - half, motion, turn)


def _list_wanted(table: AxisTable, out: int) -> dict[str, _Sides]:
    up, down, mean = (
        -error[:, out] for error in (table.forward_mm, table.backward_mm, table.mean_mm)
    )
    pairs = {"each": (up, down), "mean": (mean, mean), "+": (up, up), "-": (down, down)}
    return {
        word: _refer(np.array(both), table, LINEAR[out]) for word, both in pairs.items()
    }


def _refer(sides: _Sides, table: AxisTable, out: str) -> _Sides:
    # Across itself there is the lost motion of an axis that stands: it is constant.
    side = slice(0, 1) if out == table.axis.name else slice(None)
    return sides - sides[side, table.reference, None]


def _compare(
    kind: CompensationFormat,
    table: AxisTable,
    out: str,
    read: _Sides,
    wanted: Mapping[tuple[str, str], Mapping[str, _Sides]],
) -> None:
    known = wanted[table.axis.name, out]
    allowed = [known[word] for word in _STATED.get(kind.directions, known)]
    limit_mm = _RESOLUTIONS * kind.resolution_um / UM_PER_MM
    if any(np.abs(read - one).max() <= limit_mm for one in allowed):
        return
    right = allowed[0]
    off_mm = np.abs(read - right)
    is_wrong = (off_mm > limit_mm).any(axis=0)
    cause = f"{is_wrong.sum()} of {is_wrong.size} rows are missing, moved or wrong"
    for probable, sides in _list_causes(kind, table, out, right, wanted):
        scale = max(1.0, float(np.abs(sides).max() / np.abs(right).max()))
        if sides.shape == read.shape and np.abs(read - sides).max() <= scale * limit_mm:
            cause = probable
            break
    else:
        factor = float((read * right).sum() / (right**2).sum())
        allowed_mm = max(1.0, abs(factor)) * limit_mm
        if abs(factor) > _LEAST and np.abs(read - factor * right).max() <= allowed_mm:
            cause = f"it is {factor:.3g} times the value"
    side, row = np.unravel_index(int(off_mm.argmax()), off_mm.shape)
    raise NotConforming(
        f"{table.axis.name} at {table.position_mm[row]:g} mm in {'+-'[side]} "
        f"direction, added to {out}: expected {UM_PER_MM * right[side, row]:.5g} µm, "
        f"read {UM_PER_MM * read[side, row]:.5g} µm: {cause}"
    )


def _list_causes(
    kind: CompensationFormat,
    table: AxisTable,
    out: str,
    right: _Sides,
    wanted: Mapping[tuple[str, str], Mapping[str, _Sides]],
) -> Iterator[tuple[str, _Sides]]:
    """Probable causes, and what would be read then."""
    sign = "the sign is reversed"
    yield sign, -right
    yield "the two directions are swapped", _refer(right[::-1], table, out)
    yield "the rows are in reverse order", _refer(right[:, ::-1], table, out)
    for factor, units in _FACTORS.items():
        cause = f"it is {factor:g} times the value, as {units}"
        yield cause, factor * right
        yield f"{cause}, and {sign}", -factor * right
    for (axis, other), sides in wanted.items():
        for word, cause in _SIDES.items():
            if (axis, other) == (table.axis.name, out):
                cause = f"directions is {kind.directions!r}, but read is {cause}"
            else:
                cause = f"that is added to {other} as {axis} moves"
            yield cause, sides[word]
