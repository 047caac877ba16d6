"""Arcs of a path: their geometry, and their approximation by short chords.

Keep-out boxes and sight are checked along chords of a degree: they stay within 0.004 %
of the radius of the arc. The travel is checked where an axis reverses on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.records import ARC_PLANES, Arc, Path

SAME_RADIUS_MM = 2e-3  # ends and centre are rounded, by a control to 0.001 mm
_CHORD_DEG = 1.0


def describe_bad_arc(
    axes: Sequence[str],
    begin: NDArray[np.float64],
    end: NDArray[np.float64],
    arc: Arc,
) -> str:
    """Error of the arc between two rows, "" if there is none."""
    if arc.axes not in ARC_PLANES or not set(arc.axes) <= set(axes):
        return f"has an arc in {arc.axes}; planes are {', '.join(ARC_PLANES)}"
    if not np.isfinite([*arc.centre_mm, arc.turn_deg]).all() or arc.turn_deg == 0.0:
        return f"has an arc that turns by {arc.turn_deg:g} deg"
    radii = [measure_radius_mm(axes, at, arc) for at in (begin, end)]
    if min(radii) < 1.0 or abs(radii[1] - radii[0]) > SAME_RADIUS_MM:
        return (
            f"begins {radii[0]:.4f} mm from the centre of its arc and ends at "
            f"{radii[1]:.4f} mm"
        )
    led = turn_about(axes, begin, arc, np.array([arc.turn_deg]))[0]
    if np.abs(led - end).max() > 2.0 * SAME_RADIUS_MM:
        return f"ends {np.abs(led - end).max():.4f} mm from where its arc leads to"
    return ""


def measure_radius_mm(
    axes: Sequence[str], place: NDArray[np.float64], arc: Arc
) -> float:
    """Distance of a position from the centre of an arc, in its plane."""
    columns = [axes.index(name) for name in arc.axes]
    return float(np.linalg.norm(place[columns] - arc.centre_mm))


def turn_about(
    axes: Sequence[str],
    begin: NDArray[np.float64],
    arc: Arc,
    turned_deg: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Positions (n, axes) after turning by (n,) angles from the begin of an arc."""
    columns = [axes.index(name) for name in arc.axes]
    centre = np.array(arc.centre_mm)
    x, y = begin[columns] - centre
    cosine, sine = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    places = np.tile(begin, (len(turned_deg), 1))
    turned = np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
    places[:, columns] = centre + turned
    return places


def trace(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions of a path with its arcs as chords, and the row of each.

    The last position of a row is that of the row itself.
    """
    if not any(path.arc):
        return path.position, np.arange(len(path))
    places: list[NDArray[np.float64]] = []
    owner: list[int] = []
    for row, end in enumerate(path.position):
        arc = path.arc[row] if row else None
        if arc is not None:
            count = int(np.ceil(abs(arc.turn_deg) / _CHORD_DEG))
            turned = arc.turn_deg * np.arange(1, count) / count
            begin = path.position[row - 1]
            places.append(turn_about(path.axes, begin, arc, turned))
            owner += [row] * (count - 1)
        places.append(end[None])
        owner.append(row)
    return np.concatenate(places), np.array(owner, np.int64)


def measure_length_mm(
    axes: Sequence[str], begin: NDArray[np.float64], arc: Arc
) -> float:
    """Length of an arc from its begin to its end."""
    return measure_radius_mm(axes, begin, arc) * abs(float(np.radians(arc.turn_deg)))


def find_reach(
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Outermost positions of each row, and the row of each.

    Those of an arc are the reversals of its axes, and its end.
    """
    places, rows = [path.position], [np.arange(len(path))]
    for row, arc in enumerate(path.arc):
        if arc is None or row == 0:
            continue
        begin = path.position[row - 1]
        columns = [path.axes.index(name) for name in arc.axes]
        x, y = begin[columns] - np.array(arc.centre_mm)
        away = np.degrees(np.arctan2(y, x))
        low, high = sorted((away, away + arc.turn_deg))
        quarter = 90.0 * np.arange(np.ceil(low / 90.0), np.floor(high / 90.0) + 1.0)
        turned = turn_about(path.axes, begin, arc, quarter[:4] - away)
        places.append(turned)
        rows.append(np.full(len(turned), row))
    order = np.argsort(np.concatenate(rows), kind="stable")
    return np.concatenate(places)[order], np.concatenate(rows)[order]
