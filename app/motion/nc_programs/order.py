"""What a program has to command, as it will be printed, and what its header says."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from textwrap import wrap

import numpy as np
from jaxtyping import Float64

from app.kinematics.machine import Machine, position_unit
from app.motion.nc_programs.motion import path_checksum
from app.motion.paths import ACCELERATION_MM_S2, travel_time_s
from drivers.interfaces.records import Path

COLUMNS = 60  # of a header; every control's screen shows them
LARGEST_FEED = 99_999.0  # mm/min, that controls of all kinds read
_NAME_LENGTH = 16  # within what every control here takes
# What comments of all controls may hold; a bracket or a quote would end them.
_ODD = re.compile(r"[^A-Z0-9 .,+\-/=_]+")

WAY_FREE = "ROW 1 IS APPROACHED STRAIGHT. WAY FREE - CYCLE START"
RECORD = "START THE RECORDING. AFTER 2 S CYCLE START"
THE_END = "END. AFTER 2 S STOP THE RECORDING"


@dataclass(frozen=True, slots=True)
class Step:
    """One row to drive to.

    row : from 1
    position : rounded to what is printed, mm and deg
    turns_only : no linear axis moves on the way to it
    feed : of the linear axes, mm/min; of the rotary axes, deg/min, where they turn only
    path_feed : of all axes together, a degree counted as a millimetre
    change : what the operator does before the motion, empty for nothing
    """

    row: int
    position: tuple[float, ...]
    turns_only: bool
    feed: float
    path_feed: float
    dwell_s: float
    change: str


@dataclass(frozen=True, slots=True)
class Order:
    """A whole program: its name, its header in plain capitals, its rows."""

    name: str
    axes: tuple[str, ...]
    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    header: tuple[str, ...]
    steps: tuple[Step, ...]


def as_printed(
    path: Path, decimals: int, least_dwell_s: float, *, counts_degrees: bool
) -> Path:
    """Return a path with positions, feeds and dwells as a program states them."""
    position = np.round(path.position, decimals) + 0.0  # no minus zero
    dwell_s: Float64[np.ndarray, " n"] = np.maximum(path.dwell_s, least_dwell_s)
    printed = replace(path, position=position, dwell_s=np.round(dwell_s, 3))
    if not counts_degrees:
        return printed
    # Much turning on a short line: F would be a number that no control reads.
    most = LARGEST_FEED / _whole_for_straight(printed)
    return replace(printed, feed_mm_min=np.minimum(path.feed_mm_min, most))


def steps_of(path: Path) -> tuple[Step, ...]:
    """Return the rows of a printed path."""
    straight, whole = _lengths(path)
    turns_only = [False, *((straight == 0) & (whole > 0)).tolist()]
    share = _whole_for_straight(path)
    return tuple(
        Step(
            row=index + 1,
            position=tuple(float(v) for v in path.position[index]),
            turns_only=turns_only[index],
            feed=float(path.feed_mm_min[index]),
            path_feed=float(path.feed_mm_min[index] * share[index]),
            dwell_s=float(path.dwell_s[index]),
            change=_change(path, index),
        )
        for index in range(len(path))
    )


def header_of(
    path: Path, planned: Path, machine: Machine, name: str, control: str, frame: str
) -> tuple[str, ...]:
    """Return what an operator has to know, in lines that fit every control's screen.

    planned : the path before it was rounded
    """
    feeds = f"{path.feed_mm_min.min():.0f} TO {path.feed_mm_min.max():.0f} MM/MIN"
    minutes, seconds = divmod(round(travel_time_s(path)), 60)
    rounded = float(np.abs(path.position - planned.position).max())
    facts = [
        f"TRUEPATH MEASURING PATH {name} FOR {control}",
        f"MACHINE {machine.name}, {machine.chain}",
        f"ROWS {len(path)}, FEED {feeds}, FEED OVERRIDE 100 PERCENT",
        *_travel_used(path, machine),
        f"EXPECTED TIME {minutes} MIN {seconds} S FROM THE BEGIN OF THE "
        f"RECORDING, AT {ACCELERATION_MM_S2:.0f} MM/S2",
        f"PATH CHECKSUM {path_checksum(path.axes, path.position)}",
        f"POSITIONS ARE MACHINE COORDINATES, MM AND DEG, {frame}",
        "NO TOOL LENGTH, NO TOOL RADIUS, NO ROTATION, NO TILTED PLANE",
        "EACH MOTION STATES ITS ROW OF THE PATH, FROM 1",
    ]
    if rounded > 1e-9:
        facts.append(f"POSITIONS ARE ROUNDED, BY AT MOST {rounded:.4f}")
    return tuple(line for fact in facts for line in wrap(plain(fact), COLUMNS))


def plain(text: str) -> str:
    """Return text that may stand in a comment of any control."""
    return " ".join(_ODD.sub(" ", text.upper()).split())


def plain_name(text: str) -> str:
    """Return a program name of letters, digits and underscores, a letter first."""
    kept = re.sub(r"[^A-Z0-9]+", "_", text.upper()).strip("_")
    # Two letters first: a Siemens control takes no other names.
    named = kept if re.match(r"[A-Z]{2}", kept) else f"TP_{kept}"
    return named[:_NAME_LENGTH].rstrip("_")


def _lengths(
    path: Path,
) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Return the length of each line: of its linear part, and with degrees as mm."""
    linear = np.array([name in "XYZ" for name in path.axes])
    move = np.diff(path.position, axis=0)
    straight = np.linalg.norm(move[:, linear], axis=1)
    return straight, np.linalg.norm(move, axis=1)


def _whole_for_straight(path: Path) -> Float64[np.ndarray, " n"]:
    """Return the feed of all axes for a unit of that of the linear ones, each row.

    The way to the first row is not known: its feed stands for itself.
    """
    straight, whole = _lengths(path)
    share = np.where(straight > 0, whole / np.where(straight, straight, 1.0), 1.0)
    return np.concatenate([[1.0], share])


def _travel_used(path: Path, machine: Machine) -> list[str]:
    axes = {axis.name: axis for axis in machine.axes}
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    return [
        f"{name} USES {_number(low[i])} TO {_number(high[i])} OF "
        f"{_number(axes[name].low)} TO {_number(axes[name].high)} "
        f"{position_unit(axes[name])}"
        for i, name in enumerate(path.axes)
    ]


def _number(value: Float64[np.ndarray, ""] | float) -> str:
    return f"{float(value):.3f}".rstrip("0").rstrip(".")


def _change(path: Path, index: int) -> str:
    """Name the target that has to be put in place before a row, if it differs."""
    if not path.target or index == 0 or path.target[index] == path.target[index - 1]:
        return ""
    return plain(f"PUT THE TRACKER ON TARGET {path.target[index]} - CYCLE START")
