"""Parts of a Run: without some cells, or before and after steps of the set-up's place.

What goes is said, by line and time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from app.alignment.cell_gate import describe_cells
from app.alignment.left_out import LeftOut
from app.alignment.observations import Observations
from app.estimation.setup_steps import Step
from app.numerics.rigid import RigidTransform

_FEWEST_CELLS = 4  # of a line that was cut
_LEAST_SPREAD_MM = 10.0  # root mean square, of points that tell a pose


@dataclass(frozen=True, slots=True)
class RunPart:
    """Observations of a Run given, or of its part between two knocks."""

    given: int
    seen: Observations


@dataclass(frozen=True, slots=True)
class Knock:
    """A step of the place of tracker or reflector, both sides of which were solved.

    run : of those given; row : on the way to which, or at which, it happened
    moved_mm : of the pose, at the middle of the measured points; turned_rad : likewise
    """

    run: int
    row: int
    time_s: float
    moved_mm: float
    turned_rad: float


def leave_out(
    seen: Observations,
    bad: Bool[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
    edges: Int64[np.ndarray, " e"],
) -> Observations:
    """Return observations without some cells, and with what is said of these.

    bad : of those that were fitted; edges : where they begin among those seen
    """
    said: list[LeftOut] = []
    sizes = np.diff(edges)
    bad, off_mm = np.repeat(bad, sizes), np.repeat(off_mm, sizes)
    for first, last in seen.lines:
        part = slice(first, last)
        if bad[part].any():
            said += describe_cells(
                bad[part],
                seen.at.time_s[part],
                seen.count[part],
                off_mm[part],
                int(seen.row[first]),
            )
    kept = _drop_remnants(seen, np.flatnonzero(~bad))
    left_out = tuple(sorted([*seen.left_out, *said], key=_order))
    return replace(kept, used=int(kept.count.sum()), left_out=left_out)


def _drop_remnants(seen: Observations, cells: Int64[np.ndarray, " n"]) -> Observations:
    """Return some of the cells, without lines of which too little is left.

    Phase and speed of a line take two cells; what they leave of few tells nothing.
    Cells on ramps are not timed.
    """
    line, timed = seen.at.line[cells], np.where(seen.is_ramp, -1, seen.at.line)
    count = int(seen.at.line.max(initial=0)) + 2
    own = np.bincount(timed[cells] + 1, minlength=count)
    before = np.bincount(timed + 1, minlength=count)
    whole = (line < 0) | (own == before)[line + 1] | (own >= _FEWEST_CELLS)[line + 1]
    return seen.select(cells[whole])


def _order(each: LeftOut) -> tuple[float, int]:
    return float(np.nan_to_num(each.begin_s)), each.row


def split(part: RunPart, cell: int, edges: Int64[np.ndarray, " e"]) -> list[RunPart]:
    """Return what is before a step at a cell, and what is after it, as two Runs.

    Where it is within a line, the cell that it may be in belongs to neither.
    edges : where the cells that were fitted begin among those of the part
    """
    seen, joined, cell = part.seen, cell, int(edges[cell])
    within = seen.row[cell] == seen.row[cell - 1] and bool(
        seen.at.line[cell] == seen.at.line[cell - 1]
    )
    before, after = (cell, cell)
    if within:
        before, after = int(edges[joined - 1]), int(edges[joined + 1])
    halves = [np.arange(before), np.arange(after, len(seen))]
    time_s = 0.5 * float(seen.at.time_s[cell] + seen.at.time_s[cell - 1])
    found: list[RunPart] = []
    used = 0
    for number, cells in enumerate(halves):
        some = _drop_remnants(seen, cells)
        count = int(some.count.sum())
        offered = seen.offered - used if number else count
        used += count
        late = (each.begin_s >= time_s for each in seen.left_out)
        said = tuple(
            each
            for each, is_late in zip(seen.left_out, late, strict=True)
            if is_late == bool(number)
        )
        own = replace(some, used=count, offered=offered, left_out=said)
        found.append(RunPart(part.given, own))
    return found


def split_at_all(
    part: RunPart,
    knocks: Sequence[Step],
    edges: Int64[np.ndarray, " e"],
    off_mm: Float64[np.ndarray, " n"],
) -> list[RunPart]:
    """Return what is before, between and after knocks, as Runs of their own.

    off_mm : how far the cells that were fitted lie aside
    """
    found = [part]
    off_mm = np.repeat(off_mm, np.diff(edges))
    for step in reversed(knocks):  # the cells before it keep their numbers
        if edges[step.cell + 1] <= len(found[0].seen):
            halves = split(found[0], step.cell, edges)
            found[:1] = _join_scraps(halves, part.seen.at.time_s, off_mm)
    return found


def _join_scraps(
    halves: list[RunPart],
    time_s: Float64[np.ndarray, " n"],
    off_mm: Float64[np.ndarray, " n"],
) -> list[RunPart]:
    """Return the halves of which a pose can be told; what is of the others is said.

    time_s, off_mm : of the cells of both, how far they lie aside
    """
    kept = [part for part in halves if _tells_pose(part.seen)]
    halves = [part for part in halves if len(part.seen)]
    if len(kept) != 1:
        return halves
    scraps = [part.seen for part in halves if part is not kept[0]]
    if not scraps:
        return kept
    (scrap,) = scraps
    off_mm = off_mm[np.searchsorted(time_s, scrap.at.time_s)]
    said = [
        describe_cells(
            np.ones(last - first, bool),
            scrap.at.time_s[first:last],
            scrap.count[first:last],
            off_mm[first:last],
            int(scrap.row[first]),
        )[0]
        for first, last in scrap.lines
    ]
    seen = kept[0].seen
    left_out = sorted([*seen.left_out, *scrap.left_out, *said], key=_order)
    offered = seen.offered + scrap.offered
    return [
        RunPart(kept[0].given, replace(seen, offered=offered, left_out=tuple(left_out)))
    ]


def _tells_pose(seen: Observations) -> bool:
    """Tell whether points lie on no straight line."""
    if len(seen) < _FEWEST_CELLS:
        return False
    away = seen.at.point_mm - seen.at.point_mm.mean(axis=0)
    spread = np.linalg.svd(away, compute_uv=False) / np.sqrt(len(seen))
    return bool(spread[1] > _LEAST_SPREAD_MM)


def measure_knock(
    parts: tuple[RunPart, RunPart],
    poses: tuple[RigidTransform, RigidTransform],
    middle_mm: Float64[np.ndarray, "3"],
) -> Knock:
    """Return the step between the poses before and after it."""
    (before, after), (a, b) = parts, poses
    moved = b.apply(middle_mm[None]) - a.apply(middle_mm[None])
    turned = 0.5 * float(np.linalg.norm(b.rotation @ a.rotation.T - np.eye(3)))
    return Knock(
        after.given,
        int(after.seen.row[0]),
        0.5 * float(before.seen.at.time_s[-1] + after.seen.at.time_s[0]),
        float(np.linalg.norm(moved)),
        turned * float(np.sqrt(2.0)),
    )
