"""The content of a program, whatever its control: its header and its rows."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import Machine, position_unit
from app.motion.motion_times import ACCELERATION_MM_S2, travel_time_s
from app.motion.nc_programs.programmed_motion import compute_checksum
from drivers.interfaces.records import Path

_COLUMNS = 60  # of a header line; every control's screen shows as many
LARGEST_FEED = 99_999.0  # mm/min, that controls of all kinds read
_NAME_LENGTH = 16  # every control here takes as many
# What comments of all controls may hold; a bracket or a quote would end them.
_ODD = re.compile(r"[^A-Z0-9 .,+\-/=_]+")


@dataclass(frozen=True, slots=True)
class ProgramRow:
    """One row of the path.

    number : from 1
    position : rounded to what is printed, mm and deg
    rotary_only : only rotary axes move
    feed : of the linear axes, mm/min; of the rotary axes, deg/min, where only they move
    path_feed : of all axes together, a degree counted as a millimetre
    target_change : what the operator does before the motion, empty for nothing
    """

    number: int
    position: tuple[float, ...]
    rotary_only: bool
    feed: float
    path_feed: float
    dwell_s: float
    target_change: str


@dataclass(frozen=True, slots=True)
class ProgramContent:
    """A whole program: its name, its header in ASCII capitals, its rows."""

    name: str
    axes: tuple[str, ...]
    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    header: tuple[str, ...]
    rows: tuple[ProgramRow, ...]


def round_path(
    path: Path, decimals: int, least_dwell_s: float, *, counts_degrees: bool
) -> Path:
    """Return a path with positions, feeds and dwells as a program states them."""
    position = np.round(path.position, decimals) + 0.0  # no negative zero
    dwell_s: Float64[np.ndarray, " n"] = np.maximum(path.dwell_s, least_dwell_s)
    rounded = replace(path, position=position, dwell_s=np.round(dwell_s, 3))
    if not counts_degrees:
        return rounded
    # A large rotation on a short line would need a feed that no control reads.
    most = LARGEST_FEED / _divide_whole_by_straight(rounded)
    return replace(rounded, feed_mm_min=np.minimum(path.feed_mm_min, most))


def list_rows(path: Path) -> tuple[ProgramRow, ...]:
    """Return the rows of a rounded path."""
    straight, whole = _measure_lines(path)
    rotary_only = [False, *((straight == 0) & (whole > 0)).tolist()]
    share = _divide_whole_by_straight(path)
    return tuple(
        ProgramRow(
            number=index + 1,
            position=tuple(float(v) for v in path.position[index]),
            rotary_only=rotary_only[index],
            feed=float(path.feed_mm_min[index]),
            path_feed=float(path.feed_mm_min[index] * share[index]),
            dwell_s=float(path.dwell_s[index]),
            target_change=_word_target_change(path, index),
        )
        for index in range(len(path))
    )


def write_header(
    path: Path, planned: Path, machine: Machine, name: str, control: str, frame: str
) -> tuple[str, ...]:
    """Return what the operator needs to know, in lines that fit every screen.

    planned : the path before it was rounded
    """
    feeds = f"{path.feed_mm_min.min():.0f} TO {path.feed_mm_min.max():.0f} MM/MIN"
    minutes, seconds = divmod(round(travel_time_s(path)), 60)
    rounded = float(np.abs(path.position - planned.position).max())
    facts = [
        f"TRUEPATH MEASURING PATH {name} FOR {control}",
        f"MACHINE {machine.name}, {machine.chain}",
        f"ROWS {len(path)}, FEED {feeds}, FEED OVERRIDE 100 PERCENT",
        *_state_travel(path, machine),
        f"EXPECTED TIME {minutes} MIN {seconds} S FROM THE BEGIN OF THE "
        f"RECORDING, AT {ACCELERATION_MM_S2:.0f} MM/S2",
        f"PATH CHECKSUM {compute_checksum(path.axes, path.position)}",
        f"POSITIONS ARE MACHINE COORDINATES, MM AND DEG, {frame}",
        "NO TOOL LENGTH, NO TOOL RADIUS, NO ROTATION, NO TILTED PLANE",
        "EACH MOTION STATES ITS ROW OF THE PATH, FROM 1",
    ]
    if rounded > 1e-9:
        facts.append(f"POSITIONS ARE ROUNDED, BY AT MOST {rounded:.4f}")
    return tuple(line for fact in facts for line in wrap(clean_comment(fact), _COLUMNS))


def clean_comment(text: str) -> str:
    """Return text that may stand in a comment of any control."""
    return " ".join(_ODD.sub(" ", text.upper()).split())


def clean_name(text: str) -> str:
    """Return a program name of letters, digits and underscores, a letter first."""
    kept = re.sub(r"[^A-Z0-9]+", "_", text.upper()).strip("_")
    # Two letters first: a Siemens control takes no other names.
    named = kept if re.match(r"[A-Z]{2}", kept) else f"TP_{kept}"
    return named[:_NAME_LENGTH].rstrip("_")


def _measure_lines(
    path: Path,
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Return the length of each line: of its linear part, and with degrees as mm."""
    linear = np.array([name in "XYZ" for name in path.axes])
    move = np.diff(path.position, axis=0)
    straight = np.linalg.norm(move[:, linear], axis=1)
    return straight, np.linalg.norm(move, axis=1)


def _divide_whole_by_straight(path: Path) -> Float64[np.ndarray, " n"]:
    """Return the feed of all axes divided by that of the linear axes, a row each.

    The way to the first row is not known: 1 there.
    """
    straight, whole = _measure_lines(path)
    share = np.where(straight > 0, whole / np.where(straight, straight, 1.0), 1.0)
    return np.concatenate([[1.0], share])


def _state_travel(path: Path, machine: Machine) -> list[str]:
    axes = {axis.name: axis for axis in machine.axes}
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    return [
        f"{name} USES {_format_number(low[i])} TO {_format_number(high[i])} OF "
        f"{_format_number(axes[name].low)} TO {_format_number(axes[name].high)} "
        f"{position_unit(axes[name])}"
        for i, name in enumerate(path.axes)
    ]


def _format_number(value: Float64[np.ndarray, ""] | float) -> str:
    return f"{float(value):.3f}".rstrip("0").rstrip(".")


def _word_target_change(path: Path, index: int) -> str:
    """Return the target to mount before a row if it differs from the row before."""
    if not path.target or index == 0 or path.target[index] == path.target[index - 1]:
        return ""
    return clean_comment(
        f"PUT THE TRACKER ON TARGET {path.target[index]} - CYCLE START"
    )
