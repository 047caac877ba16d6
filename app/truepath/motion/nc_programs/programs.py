"""Conversion of a path or points to a control's program, and back."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from textwrap import wrap
from typing import Any, cast

import numpy as np
from jaxtyping import Float64

from truepath.errors import OutOfTravel, PlanningError
from truepath.kinematics.machine.machine import Machine, position_unit
from truepath.motion.configurations import Configurations
from truepath.motion.motion_times import (
    DEFAULT_FEED_MM_MIN,
    travel_time_s,
)
from truepath.motion.nc_programs.dialect import (
    Dialect,
    ProgramArc,
    ProgramContent,
    ProgramRow,
)
from truepath.motion.nc_programs.programmed_motion import (
    ProgrammedMotion,
    compute_checksum,
)
from truepath.motion.workspace import check_travel, inner_travel
from truepath.plugins import (
    PLAIN_NAME,
    Guarded,
    PluginFailed,
    find_point,
    gather,
    guarding,
    is_ours,
    load_point,
)
from truepath_drivers.interfaces.arcs import find_reach
from truepath_drivers.interfaces.records import Path

GROUP = "truepath.nc_dialects"
_COLUMNS = 60  # of a header line; every control's screen shows as many
_DECIMALS = 6  # mm, of differences
_SAME_TURN_DEG = 0.03  # ends of small circles are rounded
_LEAST_FEED = 0.1  # mm/min
LARGEST_FEED_MM_MIN = 99_999.0  # that controls of all kinds read
_NAME_LENGTH = 16  # every control here takes as many
# What comments of all controls may hold; a bracket or a quote would end them.
_ODD = re.compile(r"[^A-Z0-9 .,+\-/=_]+")


def list_dialects(*, with_arcs: bool = False) -> tuple[str, ...]:
    """Names of the installed dialects, third parties' included.

    with_arcs : those that drive arcs alone
    """
    drives = gather(GROUP, lambda _, make: bool(make().drives_arcs) or not with_arcs)
    return tuple(name for name, fits in drives.items() if fits)


def name_controls() -> dict[str, str]:
    return gather(GROUP, lambda _, make: _require_text(make().control))


def _require_text(text: Any) -> str:
    if not isinstance(text, str):
        raise TypeError(f"{type(text).__name__} in place of a text")
    return text


def write_program(
    path_or_points: Path | Configurations,
    machine: Machine,
    dialect: str,
    name: str = "",
    *,
    feed_mm_min: float = DEFAULT_FEED_MM_MIN,
) -> str:
    """Program of a path or of standstill points, verified by reading it back.

    dialect : one of `list_dialects`
    name : of the program, adapted to the control; the machine's if empty
    feed_mm_min : between standstill points, which have no feed of their own

    The text is read back by the dialect's own reader and compared with the path, row by
    row, and with the travel of the axes.

    Raises OutOfTravel naming row, axis, value and remedy; PlanningError where a feed, a
    dwell or the number of rows is beyond the control; BadInput for an unknown dialect.
    """
    kind = _load_dialect(dialect)
    check_travel(machine, path_or_points)
    planned = _convert_to_path(path_or_points, feed_mm_min)
    _check_limits(kind, planned)
    path = _round_path(planned, kind)
    text = kind.write(_compose(kind, path, planned, machine, name))
    motion = kind.read(text)
    _compare(motion, path, machine, kind)
    _compare_approach(motion, path, machine, kind)
    return text


def read_program(text: str, dialect: str) -> ProgrammedMotion:
    """Motion of a control that runs a measuring program.

    Raises PlanningError naming the line that a measuring path must not have: a position
    that is not in machine coordinates, a mode that was not set, a word unknown here.
    """
    return _load_dialect(dialect).read(text)


def name_file(text: str, dialect: str) -> str:
    """File name of a program on its control: program name and suffix."""
    kind = _load_dialect(dialect)
    name = f"{kind.read(text).name}{kind.suffix}"
    if PLAIN_NAME.fullmatch(name) is None:
        raise PluginFailed(f"the dialect {dialect}: {name!r} is no plain file name")
    return name


def _load_dialect(name: str) -> Dialect:
    point = find_point(GROUP, name)
    with guarding(point, "being made"):
        made = load_point(point)()
    return made if is_ours(point) else cast(Dialect, Guarded(made, point, _check))


def _check(call: str, answer: Any) -> Any:
    return _require_text(answer) if call == "write" else answer


def _convert_to_path(commanded: Path | Configurations, feed_mm_min: float) -> Path:
    if isinstance(commanded, Path):
        return commanded
    axes, position, dwell_s = commanded.axes, commanded.position, commanded.dwell_s
    feed = np.full(len(commanded), feed_mm_min)
    return Path(axes, position, feed, dwell_s, commanded.target)


def _compose(
    kind: Dialect, path: Path, planned: Path, machine: Machine, name: str
) -> ProgramContent:
    rotary = {axis.name for axis in machine.rotary_axes}
    checksum = compute_checksum(path.axes, path.position)
    wanted = _clean_name(name or machine.name)
    return ProgramContent(
        name=kind.program_name(wanted, checksum),
        axes=path.axes,
        linear=tuple(n for n in path.axes if n not in rotary),
        rotary=tuple(n for n in path.axes if n in rotary),
        header=_write_header(kind, path, planned, machine, wanted),
        approach=_list_approach(kind, path, machine),
        rows=_list_rows(path),
    )


def _check_limits(kind: Dialect, path: Path) -> None:
    if any(path.arc) and not kind.drives_arcs:
        raise PlanningError(
            f"the path has arcs, and {kind.control} drives straight lines alone in "
            "machine coordinates; let the service drive it, or plan circles in place "
            "of circles-in-motion"
        )
    if len(path) > kind.most_rows:
        raise PlanningError(
            f"the path has {len(path)} rows; a {kind.control} program numbers "
            f"{kind.most_rows}; plan two shorter paths"
        )
    most_s = kind.longest_dwell_s
    for name, values, least, most, remedy in (
        ("feed_mm_min", path.feed_mm_min, _LEAST_FEED, LARGEST_FEED_MM_MIN,
         f"give a feed of {_LEAST_FEED:g} to {LARGEST_FEED_MM_MIN:g} mm/min"),
        ("dwell_s", path.dwell_s, 0.0, most_s,
         f"{kind.control} dwells 0 to {most_s:g} s"),
    ):  # fmt: skip
        good = (values >= least) & (values <= most)
        if not good.all():
            row = int(np.argmin(good))
            raise PlanningError(f"row {row + 1}: {name} is {values[row]:g}; {remedy}")


def _compare(
    motion: ProgrammedMotion, path: Path, machine: Machine, kind: Dialect
) -> None:
    half = 0.5 * 10.0**-kind.decimals
    same = (
        motion.axes == path.axes
        and motion.position.shape == path.position.shape
        and bool((np.abs(motion.position - path.position) < half).all())
        and np.allclose(motion.feed_mm_min, path.feed_mm_min, rtol=1e-3, atol=1e-3)
        and np.allclose(motion.dwell_s, path.dwell_s, rtol=0.0, atol=5e-4)
        and bool(motion.exact_stop.all())
        and motion.row.tolist() == list(range(1, len(path) + 1))
        and motion.checksum == motion.stated_checksum
        and _has_same_arcs(motion.path, path, 2.0 * half)
    )
    if not same:
        raise PlanningError(
            f"the {kind.control} program does not read back as the path; do not run "
            "it, and report the path"
        )
    by_name = {axis.name: axis for axis in machine.axes}
    for column, axis in enumerate(by_name[name] for name in path.axes):
        for row, value in enumerate(motion.position[:, column], 1):
            if not axis.low - half <= value <= axis.high + half:
                unit = position_unit(axis)
                raise OutOfTravel(
                    f"row {row}: {axis.name} = {value:.4f} {unit} is outside "
                    f"{axis.low:g} to {axis.high:g} {unit} as the program states it; "
                    "shorten the plan or correct the travel in the machine file"
                )


def _has_same_arcs(read: Path, path: Path, within_mm: float) -> bool:
    pairs = zip(*(one.arc or (None,) * len(one) for one in (read, path)), strict=True)
    return all(
        a == b
        or (
            a is not None
            and b is not None
            and a.axes == b.axes
            and math.dist(a.centre_mm, b.centre_mm) < within_mm
            and abs(a.turn_deg - b.turn_deg) < _SAME_TURN_DEG
        )
        for a, b in pairs
    )


def _round_path(path: Path, kind: Dialect) -> Path:
    position = np.round(path.position, kind.decimals) + 0.0  # no negative zero
    arc = tuple(
        one and replace(one, centre_mm=_round_all(one.centre_mm, kind.decimals))
        for one in path.arc
    )
    dwell_s: Float64[np.ndarray, " n"] = np.maximum(path.dwell_s, kind.least_dwell_s)
    dwell_s = np.round(dwell_s, 3)
    rounded = replace(path, position=position, dwell_s=dwell_s, arc=arc)
    if not kind.counts_degrees:
        return rounded
    # A large rotation on a short line would need a feed that no control reads.
    most = LARGEST_FEED_MM_MIN / _divide_whole_by_straight(rounded)
    return replace(rounded, feed_mm_min=np.minimum(path.feed_mm_min, most))


def _list_rows(path: Path) -> tuple[ProgramRow, ...]:
    straight, whole = _measure_lines(path)
    rotary_only = [False, *((straight == 0) & (whole > 0)).tolist()]
    share = _divide_whole_by_straight(path)
    return tuple(
        ProgramRow(
            number=index + 1,
            axes=path.axes,
            position=tuple(float(v) for v in path.position[index]),
            rotary_only=rotary_only[index],
            feed=float(path.feed_mm_min[index]),
            path_feed=float(path.feed_mm_min[index] * share[index]),
            dwell_s=float(path.dwell_s[index]),
            target_change=_word_target_change(path, index),
            arc=_describe_arc(path, index),
        )
        for index in range(len(path))
    )


def _describe_arc(path: Path, index: int) -> ProgramArc | None:
    arc = path.arc[index] if path.arc and index else None
    if arc is None:
        return None
    columns = [path.axes.index(name) for name in arc.axes]
    first, second = (float(v) for v in path.position[index - 1, columns])
    u_mm, v_mm = arc.centre_mm
    # A rest of a millionth of a turn is rounding.
    turns = math.ceil(abs(arc.turn_deg) / 360.0 - 1e-6) - 1
    centre = _round_all((u_mm - first, v_mm - second), _DECIMALS)
    return ProgramArc(arc.axes, (first, second), centre, turns, arc.turn_deg > 0.0)


def _round_all(values: tuple[float, float], decimals: int) -> tuple[float, float]:
    first, second = (round(value, decimals) + 0.0 for value in values)
    return first, second


def _write_header(
    kind: Dialect, path: Path, planned: Path, machine: Machine, name: str
) -> tuple[str, ...]:
    feeds = f"{path.feed_mm_min.min():.0f} TO {path.feed_mm_min.max():.0f} MM/MIN"
    minutes, seconds = divmod(round(travel_time_s(path, machine.motion)), 60)
    rounded = float(np.abs(path.position - planned.position).max())
    facts = [
        f"TRUEPATH MEASURING PATH {name} FOR {kind.control}",
        f"MACHINE {machine.name}, {machine.chain}",
        f"ROWS {len(path)}, FEED {feeds}, FEED OVERRIDE 100 PERCENT",
        *_state_travel(path, machine),
        f"EXPECTED TIME {minutes} MIN {seconds} S FROM THE BEGIN OF THE "
        f"RECORDING, AT {machine.motion.acceleration_mm_s2:.0f} MM/S2",
        f"PATH CHECKSUM {compute_checksum(path.axes, path.position)}",
        f"POSITIONS ARE MACHINE COORDINATES, MM AND DEG, {kind.frame}",
        "NO TOOL LENGTH, NO TOOL RADIUS, NO ROTATION, NO TILTED PLANE",
        _describe_approach(_list_approach(kind, path, machine)),
        "EACH MOTION STATES ITS ROW OF THE PATH, FROM 1",
    ]
    if any(path.arc):
        facts.append("CIRCLES BEGIN WHERE THE AXES STAND, NO ROTATION MAY BE ACTIVE")
    if rounded > 1e-9:
        facts.append(f"POSITIONS ARE ROUNDED, BY AT MOST {rounded:.4f}")
    return tuple(
        line for fact in facts for line in wrap(_clean_comment(fact), _COLUMNS)
    )


def _list_approach(
    kind: Dialect, path: Path, machine: Machine
) -> tuple[ProgramRow, ...]:
    """Motions to row 1, one axis each: to clearance, then to the row."""
    stated, rotary = machine.approach, {axis.name for axis in machine.rotary_axes}
    feed = min(stated.feed_mm_min, machine.motion.max_feed_mm_min)
    clearance = stated.clearance_mm
    if clearance is None:
        top = dict(zip(machine.axis_names, inner_travel(machine)[1], strict=True))
        clearance = (("Z", float(top["Z"])),)
    missing = [name for name, _ in clearance if name not in path.axes]
    if missing:
        raise PlanningError(
            f"the path does not state {missing[0]}, which goes to clearance before the "
            "other axes; add its column"
        )
    last = [name for name, _ in reversed(clearance)]
    order = stated.order or (*(n for n in path.axes if n not in last), *last)
    first = dict(zip(path.axes, path.position[0].tolist(), strict=True))
    ends = [*clearance, *((name, first[name]) for name in order if name in first)]
    return tuple(
        ProgramRow(
            number=0,
            axes=(name,),
            position=(round(value, kind.decimals),),
            rotary_only=name in rotary,
            feed=feed,
            path_feed=feed,
            dwell_s=0.0,
        )
        for name, value in ends
    )


def _describe_approach(approach: tuple[ProgramRow, ...]) -> str:
    ends = ", ".join(
        f"{row.axes[0]} TO {_format_number(row.position[0])}" for row in approach
    )
    return f"TO ROW 1 BY {ends} AT {approach[0].feed:.0f} MM/MIN OR DEG/MIN"


def _compare_approach(
    motion: ProgrammedMotion, path: Path, machine: Machine, kind: Dialect
) -> None:
    wanted = [
        (dict(zip(row.axes, row.position, strict=True)), round(row.feed, 3))
        for row in _list_approach(kind, path, machine)
    ]
    if wanted != [(dict(m.ends), m.feed_mm_min) for m in motion.approach]:
        raise PlanningError(
            f"the {kind.control} program does not read back as the way to row 1; do "
            "not run it, and report the machine file"
        )


def _clean_comment(text: str) -> str:
    return " ".join(_ODD.sub(" ", text.upper()).split())


def _clean_name(text: str) -> str:
    kept = re.sub(r"[^A-Z0-9]+", "_", text.upper()).strip("_")
    # Two letters first: a Siemens control takes no other names.
    named = kept if re.match(r"[A-Z]{2}", kept) else f"TP_{kept}"
    return named[:_NAME_LENGTH].rstrip("_")


def _measure_lines(
    path: Path,
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Length of each line: of its linear part, and with degrees as mm."""
    linear = np.array([name in "XYZ" for name in path.axes])
    move = np.diff(path.position, axis=0)
    straight = np.linalg.norm(move[:, linear], axis=1)
    return straight, np.linalg.norm(move, axis=1)


def _divide_whole_by_straight(path: Path) -> Float64[np.ndarray, " n"]:
    """Feed of all axes divided by that of the linear axes, for each row.

    The motion to the first row is unknown: 1 there.
    """
    straight, whole = _measure_lines(path)
    share = np.where(straight > 0, whole / np.where(straight, straight, 1.0), 1.0)
    return np.concatenate([[1.0], share])


def _state_travel(path: Path, machine: Machine) -> list[str]:
    axes = {axis.name: axis for axis in machine.axes}
    reach = find_reach(path)[0]
    low, high = reach.min(axis=0), reach.max(axis=0)
    return [
        f"{name} USES {_format_number(low[i])} TO {_format_number(high[i])} OF "
        f"{_format_number(axes[name].low)} TO {_format_number(axes[name].high)} "
        f"{position_unit(axes[name])}"
        for i, name in enumerate(path.axes)
    ]


def _format_number(value: Float64[np.ndarray, ""] | float) -> str:
    return f"{float(value):.3f}".rstrip("0").rstrip(".")


def _word_target_change(path: Path, index: int) -> str:
    if not path.target or index == 0 or path.target[index] == path.target[index - 1]:
        return ""
    return _clean_comment(
        f"PUT THE TRACKER ON TARGET {path.target[index]} - CYCLE START"
    )
