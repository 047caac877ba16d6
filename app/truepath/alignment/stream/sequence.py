"""Matching of standstills to waypoints by sequence, not by the nearest point.

Distances between standstills do not depend on the tracker's position, so the longest
chain of standstills whose mutual distances match those of the waypoints, in order,
gives the correspondence without a first guess of the pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.stream.nominal_path import require_spread
from truepath.alignment.stream.seating import MOST_SIGMAS, Seating, Seats
from truepath.alignment.stream.stops import StopSequence
from truepath.errors import AlignmentError
from truepath.numerics.rigid import RigidTransform, fit_rigid

TOLERANCE_MM = 1.0  # most machine errors are far smaller, wrong lines far longer
_WIDER_MM = 2.5, 5.0  # for a machine with large errors
_CLEAR = 0.9  # of the standstills: so many in a row are no chance
_SPREAD = 4.0  # of the median residual of the pose
_LARGE_MM = 0.3  # below it levers and curves are accurate as specified
_BESIDE_MM = 10.0  # of another target's position, with the present pose
_FEW = 3  # lost standstills of a target: by chance
_WIDE = 0.1  # of the volume: standstills with this spread determine the pose
_ROUNDS = 3  # pose and seats of targets in turn


@dataclass(frozen=True, slots=True)
class Matching:
    """Standstill `stop[k]` is waypoint `waypoint[k]`, both in order; a rough `pose`.

    seats : targets that are far off their stated positions, and their shifts
    reach_mm : largest deviation of the machine from its nominal point
    """

    stop: Int64[np.ndarray, " k"]
    waypoint: Int64[np.ndarray, " k"]
    pose: RigidTransform
    seats: Seats = field(default_factory=dict[str, Float64[np.ndarray, "3"]])
    reach_mm: float = TOLERANCE_MM


def match_stops(
    stops: StopSequence,
    waypoint_mm: Float64[np.ndarray, "w 3"],
    *,
    ordered_by: str,
    seating: Seating | None = None,
) -> Matching:
    """Match standstills (tracker frame) to nominal waypoints (workpiece frame).

    ordered_by : name of the waypoints in messages ("path.csv", "points.csv")
    seating : possible shifts of targets; None for none
    Raises AlignmentError if they do not belong together, or only as mirror images.
    """
    places = stops.position_mm
    require_spread(waypoint_mm, ordered_by)
    slack_mm = 0.0 if seating is None else seating.max_distance_change_mm()
    stop, waypoint = _recognise(places, waypoint_mm, slack_mm, ordered_by)
    seated: Float64[np.ndarray, "w 3"] = waypoint_mm
    seats: Seats = {}
    if seating is not None:
        # A target with few rows in the chain, or none, is found by its positions.
        seated, _ = seat_points(places[stop], waypoint_mm, waypoint, seating)
        pose = fit_rigid(seated[waypoint], places[stop])
        near_mm = TOLERANCE_MM + seating.reach_mm
        stop, waypoint = match_points(places, pose.apply(seated), near_mm)
        _require_followed(len(stop), len(places), len(waypoint_mm), ordered_by)
        seated, seats = seat_points(places[stop], waypoint_mm, waypoint, seating)
    pose = fit_rigid(seated[waypoint], places[stop])
    _require_right_handed(places[stop], seated[waypoint], pose, ordered_by)
    reach_mm = TOLERANCE_MM
    if seating is None:
        off = np.linalg.norm(pose.apply(seated)[waypoint] - places[stop], axis=1)
        reach_mm = max(TOLERANCE_MM, _SPREAD * float(np.median(off)))
    stop, waypoint = match_points(places, pose.apply(seated), reach_mm)
    pose = fit_rigid(seated[waypoint], places[stop])
    return Matching(stop, waypoint, pose, seats, reach_mm)


def seat_points(
    place_mm: Float64[np.ndarray, "k 3"],
    waypoint_mm: Float64[np.ndarray, "w 3"],
    waypoint: Int64[np.ndarray, " k"],
    seating: Seating,
) -> tuple[Float64[np.ndarray, "w 3"], Seats]:
    """All waypoints with targets at their seats, and the large shifts.

    place_mm : standstills at some of the waypoints
    """
    seat_mm = np.zeros((len(seating.names), 3))
    for _ in range(_ROUNDS):
        seated = seating.move(waypoint_mm, seat_mm)[waypoint]
        to_machine = fit_rigid(seated, place_mm).invert()
        rest = to_machine.apply(place_mm) - waypoint_mm[waypoint]
        seat_mm = seating.fit(waypoint, waypoint_mm[waypoint], rest)
    # The estimate finds smaller shifts as well.
    is_large = np.abs(seat_mm).max(axis=1, keepdims=True) > _LARGE_MM
    seat_mm = np.where(is_large, seat_mm, 0.0)
    each = zip(seating.names, seat_mm, strict=True)
    seats = {name: shift for name, shift in each if shift.any()}
    return seating.move(waypoint_mm, seat_mm), seats


def is_wide(
    points_mm: Float64[np.ndarray, "k 3"], volume_mm: Float64[np.ndarray, "w 3"]
) -> bool:
    """True if points determine a pose for the whole volume, not for a line only."""
    spread = np.linalg.svd(points_mm - points_mm.mean(axis=0), compute_uv=False)
    reach = float(np.linalg.norm(np.ptp(volume_mm, axis=0)))
    return bool(spread[1] > _WIDE * reach)


def _recognise(
    places: Float64[np.ndarray, "m 3"],
    waypoints: Float64[np.ndarray, "w 3"],
    slack_mm: float | Float64[np.ndarray, "w w"],
    ordered_by: str,
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """The longest chain; a wider tolerance only if it makes it nearly complete.

    slack_mm : additional tolerance of distances
    """
    m, w = len(places), len(waypoints)
    alike = np.zeros((w, w)) + slack_mm
    stop, waypoint = compute_longest_chain(places, waypoints, alike + TOLERANCE_MM)
    clear = max(3, round(_CLEAR * min(w, m)))
    if len(stop) < clear and not alike.any():
        for within_mm in _WIDER_MM:
            wider = compute_longest_chain(places, waypoints, alike + within_mm)
            if len(wider[0]) >= clear:
                return wider
    _require_followed(len(stop), m, w, ordered_by)
    return stop, waypoint


def _require_followed(found: int, stops: int, waypoints: int, ordered_by: str) -> None:
    if found < max(3, round(0.5 * min(waypoints, max(stops, 1)))):
        raise AlignmentError(
            f"the stream does not follow {ordered_by}: of {waypoints} commanded "
            f"standstills {found} were recognised among {stops} in the stream; check "
            "that the recording belongs to this path, has its order and measures the "
            "targets that are named in it; a machine that errs by more than "
            f"{_WIDER_MM[-1]:g} mm looks like this as well, and so does a control that "
            "rounds corners where the rows have no dwell"
        )


def require_targets(
    seating: Seating,
    matching: Matching,
    stops: StopSequence,
    ordered_by: str,
    places_of: Callable[[str], Float64[np.ndarray, "w 3"]],
) -> None:
    """Reject a target that was at rest, but not where it may be.

    A target hidden from the tracker has no standstills; then nothing is rejected.

    places_of : nominal positions of all waypoints if one target were measured at them
    """
    order = np.searchsorted(matching.waypoint, np.arange(len(seating.target)))
    for number, name in enumerate(seating.names):
        rows = np.flatnonzero(seating.target == number)
        reach = MOST_SIGMAS * float(seating.sigma_mm[number])
        off = float(np.abs(matching.seats.get(name, np.zeros(3))).max())
        lost = rows if off > reach else np.setdiff1d(rows, matching.waypoint)
        # Standstills of no waypoint among those matched before and after the lost ones.
        gap = np.searchsorted(matching.stop, np.arange(len(stops)))
        free = ~np.isin(np.arange(len(stops)), matching.stop)
        unknown = np.flatnonzero(free & np.isin(gap, np.unique(order[lost])))
        if off > reach:
            unknown = matching.stop[np.isin(matching.waypoint, rows)]
            said = f"sits {off:.1f} mm off its offset_mm, where {reach:g} mm may be"
        elif 2 * len(lost) > len(rows) and len(lost) >= _FEW:
            said = (
                f"{len(lost)} of its {len(rows)} standstills are not where they should "
                f"be, while {len(unknown)} in the stream are nowhere in {ordered_by}; "
                f"it may sit {reach:g} mm off, no more"
            )
        else:
            continue
        if off > reach or 2 * len(unknown) >= len(lost):
            shown = _find_measured(
                [other for other in seating.names if other != name],
                lambda other, lost=lost: matching.pose.apply(places_of(other)[lost]),
                stops.position_mm[unknown],
            )
            raise AlignmentError(
                f"target {name} {said}: {shown}check offset_mm in machine.json and the "
                f"target column of {ordered_by}"
            )


def _find_measured(
    names: list[str],
    expect: Callable[[str], Float64[np.ndarray, "l 3"]],
    places: Float64[np.ndarray, "u 3"],
) -> str:
    for name in names:
        expected = expect(name)
        found, _ = match_points(places, expected, _BESIDE_MM)
        if 2 * len(found) > min(len(places), len(expected)):
            return f"the tracker measured {name} instead; "
    return ""


def _require_right_handed(
    places: Float64[np.ndarray, "k 3"],
    waypoints: Float64[np.ndarray, "k 3"],
    pose: RigidTransform,
    ordered_by: str,
) -> None:
    mirrored = fit_rigid(waypoints, places, mirrored=True)
    rms, mirrored_rms = (
        float(np.sqrt(np.mean((t.apply(waypoints) - places) ** 2)))
        for t in (pose, mirrored)
    )
    if rms > 5.0 * mirrored_rms and rms > 1.0:
        raise AlignmentError(
            f"the stream fits {ordered_by} only as a mirror image "
            f"({rms:.2f} mm against {mirrored_rms:.3f} mm): one axis of the tracker "
            "frame or of the path is reversed; record in a right-handed frame"
        )
    if rms > _WIDER_MM[-1]:
        raise AlignmentError(
            f"standstills and {ordered_by} disagree by {rms:.2f} mm after alignment; "
            "check the units, the order and that the recording belongs to this path"
        )


SKIP = 4  # how many standstills or waypoints in a row may be missing
FEWEST_UNMATCHED = 3  # standstills in a row off all points; fewer occur on any machine


def compute_longest_chain(
    places: Float64[np.ndarray, "m 3"],
    waypoints: Float64[np.ndarray, "w 3"],
    within: Float64[np.ndarray, "w w"],
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Longest chain of pairs (standstill, waypoint) with few skips.

    A link is allowed where the distance to the previous pair fits, and to the pair
    before that one as well; each pair adds one, each skip costs a little.

    within : tolerance on the distance of two waypoints
    """
    m, w = len(places), len(waypoints)
    score = np.ones((m, w))
    back = np.full((m, w, 2), -1)
    nominal = np.linalg.norm(waypoints[:, None] - waypoints[None], axis=2)
    for i in range(1, m):
        for di in range(1, min(SKIP, i) + 1):
            j = i - di
            step = float(np.linalg.norm(places[i] - places[j]))
            for da in range(1, min(SKIP, w - 1) + 1):
                a, b = np.arange(da, w), np.arange(w - da)
                fits = np.abs(nominal[a, b] - step) < within[a, b]
                earlier, waypoint = back[j, b, 0], back[j, b, 1]
                distance = np.linalg.norm(places[i] - places[earlier], axis=1)
                off = np.abs(nominal[a, waypoint] - distance)
                fits &= (earlier < 0) | (off < within[a, waypoint])
                better = score[j, b] + 1.0 - 0.2 * (di + da - 2)
                take = fits & (better > score[i, a])
                score[i, a[take]] = better[take]
                back[i, a[take]] = np.column_stack([np.full(take.sum(), j), b[take]])
    return _trace_back(score, back)


def _trace_back(
    score: Float64[np.ndarray, "m w"], back: Int64[np.ndarray, "m w 2"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    if score.size == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    i, a = (int(v) for v in np.unravel_index(int(np.argmax(score)), score.shape))
    chain: list[tuple[int, int]] = []
    while i >= 0:
        chain.append((i, a))
        i, a = int(back[i, a, 0]), int(back[i, a, 1])
    pairs = np.array(chain[::-1])
    return pairs[:, 0], pairs[:, 1]


def match_points(
    places: Float64[np.ndarray, "m 3"],
    expected: Float64[np.ndarray, "w 3"],
    within: float | Float64[np.ndarray, " w"],
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Pairs within tolerance, as the longest common subsequence of both orders."""
    m, w = len(places), len(expected)
    near = np.linalg.norm(places[:, None] - expected[None], axis=2) < within
    length = np.zeros((m + 1, w + 1), np.int64)
    for i in range(m):
        hit = length[i, :-1] + near[i]
        length[i + 1, 1:] = np.maximum.accumulate(np.maximum(hit, length[i, 1:]))
    pairs: list[tuple[int, int]] = []
    i, a = m, w
    while i and a:
        if length[i, a] == length[i - 1, a]:
            i -= 1
        elif length[i, a] == length[i, a - 1]:
            a -= 1
        else:
            i, a = i - 1, a - 1
            pairs.append((i, a))
    found = np.array(pairs[::-1]).reshape(-1, 2)
    return found[:, 0], found[:, 1]
