"""A path or points as a control's program, and back."""

from __future__ import annotations

import numpy as np

from app.errors import OutOfTravel, PlanningError
from app.kinematics.machine import Machine, position_unit
from app.motion.configurations import Configurations
from app.motion.motion_times import DEFAULT_FEED_MM_MIN
from app.motion.nc_programs.dialect import Dialect
from app.motion.nc_programs.program_content import (
    LARGEST_FEED,
    ProgramContent,
    clean_name,
    list_rows,
    round_path,
    write_header,
)
from app.motion.nc_programs.programmed_motion import ProgrammedMotion, compute_checksum
from app.motion.travel import check_travel
from app.plugins import installed, load
from drivers.interfaces.records import Path

GROUP = "truepath.nc_dialects"
_LEAST_FEED = 0.1  # mm/min


def list_dialects() -> tuple[str, ...]:
    """Return the controls that programs can be written for."""
    return tuple(sorted(installed(GROUP)))


def name_control(dialect: str) -> str:
    """Return the name of a control for people."""
    return _load_dialect(dialect).control


def write_program(
    path_or_points: Path | Configurations,
    machine: Machine,
    dialect: str,
    name: str = "",
    *,
    feed_mm_min: float = DEFAULT_FEED_MM_MIN,
) -> str:
    """Return the program of a path or of standstill points for a control.

    dialect : one of `list_dialects`
    name : of the program, adapted to the control; the machine's if empty
    feed_mm_min : between standstill points, which have no feed of their own

    Before it is returned, the text is read back by the dialect's own reader and
    compared with the path, row by row, and with the travel of the axes.

    Raises OutOfTravel naming row, axis, value and remedy; PlanningError where a feed, a
    dwell or the number of rows is beyond the control; BadInput for an unknown dialect.
    """
    kind = _load_dialect(dialect)
    check_travel(machine, path_or_points)
    planned = _convert_to_path(path_or_points, feed_mm_min)
    _check_limits(kind, planned)
    path = round_path(
        planned, kind.decimals, kind.least_dwell_s, counts_degrees=kind.counts_degrees
    )
    text = kind.write(_compose(kind, path, planned, machine, name))
    _compare(kind.read(text), path, machine, kind)
    return text


def read_program(text: str, dialect: str) -> ProgrammedMotion:
    """Return the motion of a control that runs a measuring program.

    Raises PlanningError naming the line that a measuring path must not have: a position
    that is not in machine coordinates, a mode that was not set, a word unknown here.
    """
    return _load_dialect(dialect).read(text)


def name_file(text: str, dialect: str) -> str:
    """Return the file name of a program on its control."""
    kind = _load_dialect(dialect)
    return f"{kind.read(text).name}{kind.suffix}"


def _load_dialect(name: str) -> Dialect:
    return load(GROUP, name)()


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
    wanted = clean_name(name or machine.name)
    return ProgramContent(
        name=kind.program_name(wanted, checksum),
        axes=path.axes,
        linear=tuple(n for n in path.axes if n not in rotary),
        rotary=tuple(n for n in path.axes if n in rotary),
        header=write_header(path, planned, machine, wanted, kind.control, kind.frame),
        rows=list_rows(path),
    )


def _check_limits(kind: Dialect, path: Path) -> None:
    """Refuse a path that no program of this control can state."""
    if len(path) > kind.most_rows:
        raise PlanningError(
            f"the path has {len(path)} rows; a {kind.control} program numbers "
            f"{kind.most_rows}; plan two shorter paths"
        )
    most_s = kind.longest_dwell_s
    for name, values, least, most, remedy in (
        ("feed_mm_min", path.feed_mm_min, _LEAST_FEED, LARGEST_FEED,
         f"give a feed of {_LEAST_FEED:g} to {LARGEST_FEED:g} mm/min"),
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
    """Compare what the reader found with the path and the travel."""
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
