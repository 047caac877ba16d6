"""The nominal path of the target: its points, and its curve on the way to each row.

All axes move together from row to row, so a line in axis positions is a straight line
of the target only where no rotary axis carries it or the observer; else it is an arc,
or the curve that a turn and a travel make together. Positions on that curve are given
by the share of the line that is done, which grows uniformly at a constant feed: along a
curve the target's own speed need not be constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from truepath.errors import AlignmentError
from truepath.kinematics.conditions import observe_targets
from truepath.kinematics.machine.machine import Machine, RotaryAxis
from truepath.motion.configurations import Commanded, Configurations
from truepath_drivers.interfaces.records import Path

NODES = 8  # of a line, and one more a degree: then a spline is good to a nanometre
_STRAIGHT_MM = 1e-6  # off the chord: rounding
_BRANCH = 0.05  # weight of the path length against the distance


MIN_MOTION_MM = 1.0  # smaller motions of a target are not evaluated
_SLOWEST_TRAVERSE_MM_S = 10.0  # between points, to be distinguished from rest


@dataclass(frozen=True)
class Curve:
    """The target's nominal path along one line; `share` runs from 0 to 1.

    node_mm : (k, 3) points at equal shares; both ends alone where the target goes
        straight at constant speed
    turn_deg : total turn of the rotary axes
    """

    node_mm: Float64[np.ndarray, "k 3"]
    turn_deg: float = 0.0

    @property
    def is_straight(self) -> bool:
        """True if the target goes straight at constant speed."""
        return len(self.node_mm) == 2

    @property
    def chord_mm(self) -> Float64[np.ndarray, "3"]:
        return self.node_mm[-1] - self.node_mm[0]

    @cached_property
    def length_mm(self) -> float:
        """Along a curve its mean slope by Simpson's rule."""
        if self.is_straight:
            return float(np.linalg.norm(self.chord_mm))
        finer = np.linspace(0.0, 1.0, 2 * len(self.node_mm) - 1)
        slope = np.linalg.norm(self.slope_mm(finer), axis=1)
        weight = np.full(len(slope), 2.0)
        weight[1::2] = 4.0
        weight[[0, -1]] = 1.0
        return float(weight @ slope / weight.sum())

    def move_ends(
        self, begin_mm: Float64[np.ndarray, "3"], end_mm: Float64[np.ndarray, "3"]
    ) -> Curve:
        """Shifts both ends, and points between them in proportion."""
        moved = begin_mm + _node_shares(self.node_mm)[:, None] * (end_mm - begin_mm)
        return replace(self, node_mm=self.node_mm + moved)

    def point_mm(self, share: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        if self.is_straight:
            return self.node_mm[0] + share[:, None] * self.chord_mm
        return self._spline(share)

    def slope_mm(self, share: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        if self.is_straight:
            return np.tile(self.chord_mm, (len(share), 1))
        return self._spline(share, 1)

    def relative_speed(
        self, share: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Target's speed over its mean speed on the line."""
        if self.is_straight:
            return np.ones(len(share))
        return np.linalg.norm(self.slope_mm(share), axis=1) / self.length_mm

    def fastest(self) -> float:
        return float(self.relative_speed(_node_shares(self.node_mm)).max())

    def nearest(
        self,
        point_mm: Float64[np.ndarray, "n 3"],
        travelled_mm: Float64[np.ndarray, " n"] | None = None,
    ) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Share nearest to each point, and the distance of the point, mm.

        travelled_mm : path length since the beginning of the line, roughly: it
            separates the branches where the curve returns to a point
        """
        if self.is_straight:
            square = max(float(self.chord_mm @ self.chord_mm), 1e-24)
            share = (point_mm - self.node_mm[0]) @ self.chord_mm / square
            near = np.clip(share, 0.0, 1.0)
        else:
            nodes = _node_shares(self.node_mm)
            share = nodes[self._nearest_node(point_mm, travelled_mm)]
            most = 1.5 * float(nodes[1])
            for _ in range(2):
                slope = self.slope_mm(share)
                off = np.einsum("ni,ni->n", point_mm - self.point_mm(share), slope)
                square = np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-12)
                share = np.clip(share + np.clip(off / square, -most, most), 0.0, 1.0)
            near = share
        return share, np.linalg.norm(point_mm - self.point_mm(near), axis=1)

    def _nearest_node(
        self,
        point_mm: Float64[np.ndarray, "n 3"],
        travelled_mm: Float64[np.ndarray, " n"] | None,
    ) -> Int64[np.ndarray, " n"]:
        # Imported for curved lines only: they are rare, and the import is slow.
        from scipy.spatial import KDTree

        step = np.linalg.norm(np.diff(self.node_mm, axis=0), axis=1)
        run = np.concatenate([[0.0], np.cumsum(step)])
        if travelled_mm is None:
            travelled_mm, run = np.zeros(len(point_mm)), np.zeros(len(run))
        tree = KDTree(np.column_stack([self.node_mm, _BRANCH * run]))
        sought = np.column_stack([point_mm, _BRANCH * travelled_mm])
        return np.asarray(tree.query(sought)[1], np.int64)

    @cached_property
    def _spline(self) -> Callable[..., Float64[np.ndarray, "n 3"]]:
        from scipy.interpolate import CubicSpline

        return CubicSpline(_node_shares(self.node_mm), self.node_mm)


def _node_shares(node_mm: Float64[np.ndarray, "k 3"]) -> Float64[np.ndarray, " k"]:
    return np.linspace(0.0, 1.0, len(node_mm))


def _is_curved(node_mm: Float64[np.ndarray, "k 3"]) -> bool:
    begin, end = node_mm[0], node_mm[-1]
    chord = begin + _node_shares(node_mm)[:, None] * (end - begin)
    return bool(np.abs(node_mm - chord).max() > _STRAIGHT_MM)


@dataclass(frozen=True)
class NominalPath:
    """The commanded rows as the tracker should see them.

    begin_mm, end_mm : (w, 3) ends of the line towards each row, of that row's target
    length_mm, turn_deg : (w,); bends : curves of the rows that are not straight
    speed_mm_s : (w,) mean speed to each row; infinite where the target hardly moves
    first, last : (p,) rows at each point, in order: on rows between them the target
        hardly moves, so that one standstill is seen
    arcs : rows reached on an arc; only their ends are given here
    """

    begin_mm: Float64[np.ndarray, "w 3"]
    end_mm: Float64[np.ndarray, "w 3"]
    length_mm: Float64[np.ndarray, " w"]
    turn_deg: Float64[np.ndarray, " w"]
    bends: dict[int, Curve]
    speed_mm_s: Float64[np.ndarray, " w"]
    first: Int64[np.ndarray, " p"]
    last: Int64[np.ndarray, " p"]
    arcs: frozenset[int] = frozenset()

    @property
    def slowest_mm_s(self) -> float:
        return float(self.speed_mm_s.min())

    @property
    def place_mm(self) -> Float64[np.ndarray, "p 3"]:
        """Nominal standstill positions, one after another."""
        return self.end_mm[self.first]

    def shift_through(
        self, place: Int64[np.ndarray, " k"], seen_mm: Float64[np.ndarray, "k 3"]
    ) -> NominalPath:
        """Path shifted so that it passes through the observed standstills.

        place : in order; points between them are shifted as their neighbours are

        Relative to it a sample is off by how much the line is bent, and its share of
        the line is that of the command, however far off both ends are.
        """
        off = seen_mm - self.place_mm[place]
        at = np.searchsorted(self.first, np.arange(len(self.end_mm)), "right") - 1
        shift = np.empty_like(self.end_mm)
        for k in range(3):
            shift[:, k] = np.interp(at, place, off[:, k])
        before: Float64[np.ndarray, "w 3"] = np.concatenate([shift[:1], shift[:-1]])
        bends = {
            row: bend.move_ends(before[row], shift[row])
            for row, bend in self.bends.items()
        }
        begin_mm, end_mm = self.begin_mm + before, self.end_mm + shift
        return replace(self, begin_mm=begin_mm, end_mm=end_mm, bends=bends)

    def curve(self, row: int) -> Curve:
        straight = np.stack([self.begin_mm[row], self.end_mm[row]])
        return self.bends.get(row) or Curve(straight, float(self.turn_deg[row]))


def compute_nominal_path(
    machine: Machine,
    commanded: Commanded,
    first: Int64[np.ndarray, " p"] | None = None,
) -> NominalPath:
    """Of a path or of standstill points, as seen from the tracker's frame of reference.

    first : rows of the points, where they are known already
    """
    n = len(commanded)
    end_mm = _compute_target_mm(machine, commanded, np.arange(n), commanded.position)
    if isinstance(commanded, Configurations):
        rows, none = np.arange(n), np.zeros(n)
        speed = none + _SLOWEST_TRAVERSE_MM_S
        return NominalPath(end_mm, end_mm, none, none, {}, speed, rows, rows)
    before = np.concatenate([commanded.position[:1], commanded.position[:-1]])
    begin_mm = _compute_target_mm(machine, commanded, np.arange(n), before)
    length_mm = np.linalg.norm(end_mm - begin_mm, axis=1)
    is_rotary = np.array([isinstance(axis, RotaryAxis) for axis in machine.axes])
    step = commanded.position - before
    turn_deg = np.abs(step[:, is_rotary]).sum(axis=1)
    bends = _compute_bends(machine, commanded, before, turn_deg)
    for row, bend in bends.items():
        length_mm[row] = bend.length_mm
    speed = _compute_speed_mm_s(commanded, step, is_rotary, length_mm)
    moved = np.concatenate([[True], length_mm[1:] >= MIN_MOTION_MM])
    if commanded.target:
        moved[1:] |= np.array(commanded.target[1:]) != np.array(commanded.target[:-1])
    arcs = frozenset(row for row, arc in enumerate(commanded.arc) if arc and row)
    moved[list(arcs)] = True
    first = np.flatnonzero(moved) if first is None else first
    last = np.append(first[1:], n) - 1
    return NominalPath(
        begin_mm, end_mm, length_mm, turn_deg, bends, speed, first, last, arcs
    )


def require_spread(waypoints: Float64[np.ndarray, "w 3"], ordered_by: str) -> None:
    """Raise AlignmentError where points do not determine a pose."""
    spread = np.linalg.svd(waypoints - waypoints.mean(axis=0), compute_uv=False)
    if len(waypoints) < 3 or spread[1] < 1.0:
        raise AlignmentError(
            f"{ordered_by} lies on one straight line, so the tracker's turn about it "
            "cannot be told; add a waypoint off the line"
        )


def _compute_target_mm(
    machine: Machine,
    commanded: Commanded,
    row: Int64[np.ndarray, " n"],
    position: Float64[np.ndarray, "n a"],
) -> Float64[np.ndarray, "n 3"]:
    targets = [machine.target(name) for name in commanded.target or ("",)]
    if commanded.target:
        targets = [targets[int(r)] for r in row]
    return observe_targets(machine, position, targets).point_mm


def _compute_bends(
    machine: Machine,
    commanded: Path,
    before: Float64[np.ndarray, "w a"],
    turn_deg: Float64[np.ndarray, " w"],
) -> dict[int, Curve]:
    rows = np.flatnonzero(turn_deg)
    if not len(rows):
        return {}
    nodes = NODES + np.ceil(turn_deg[rows]).astype(np.int64)
    shares = [np.linspace(0.0, 1.0, count) for count in nodes]
    row, share = np.repeat(rows, nodes), np.concatenate(shares)
    step = commanded.position[row] - before[row]
    point = _compute_target_mm(
        machine, commanded, row, before[row] + share[:, None] * step
    )
    parts = np.split(point, np.cumsum(nodes)[:-1])
    return {
        int(row): Curve(points, float(turn_deg[row]))
        for row, points in zip(rows, parts, strict=True)
        if _is_curved(points)
    }


def _compute_speed_mm_s(
    commanded: Path,
    step: Float64[np.ndarray, "w a"],
    is_rotary: np.ndarray,
    length_mm: Float64[np.ndarray, " w"],
) -> Float64[np.ndarray, " w"]:
    """Mean speed of the target to each row; infinite where it hardly moves.

    The feed is of the linear axes, in deg/min of the rotary ones where none moves.
    """
    straight = np.linalg.norm(step[:, ~is_rotary], axis=1)
    fed = straight + np.linalg.norm(step[:, is_rotary], axis=1) * (straight == 0.0)
    moves = (length_mm >= MIN_MOTION_MM) & (fed > 0.0)
    speed = np.full(len(fed), np.inf)
    speed[moves] = (commanded.feed_mm_min / 60.0 * length_mm)[moves] / fed[moves]
    return speed
