"""Choice of the known points that the tracker measures from every station."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, Configurations
from truepath.motion.workspace.travel import DECIMALS, inner_travel
from truepath.motion.workspace.workspace import Workspace, moving_targets

DWELL_S = 1.5
_POINTS, _FEWEST = 5, 4
_APART_MM = 50.0  # off the line through the points: else they determine no turn


def choose_known_points(
    machine: Machine,
    workspace: Workspace,
    places_mm: Sequence[Float64[np.ndarray, "3"]],
    lines: Sequence[Commanded],
) -> Configurations:
    """Points of the travel, far apart, that every station sees.

    lines : rows of each station, after the known points
    Raises PlanningError if there are not enough of them, or none can be reached.
    """
    places = _make_grid(machine)
    for place_mm in places_mm:
        seen = workspace.place_tracker(place_mm)
        places = places[seen.allows(machine, places, places)]
    chosen = _spread(places)
    spread = np.linalg.svd(chosen - chosen.mean(axis=0), compute_uv=False)
    if len(chosen) < _FEWEST or spread[1] < _APART_MM:
        raise PlanningError(
            "not enough places of the travel are in range and in sight of every "
            "station to check one against the other; plan fewer stations, or correct "
            "the workspace"
        )
    unseen = workspace.without_sight
    for order in permutations(chosen.tolist()):
        way = np.array(order)
        if unseen.allows(machine, *_list_moves(way, lines)).all():
            name = moving_targets(machine)[0].name
            target = (name,) * len(way) if len(machine.targets) > 1 else ()
            dwell_s = np.full(len(way), DWELL_S)
            return Configurations(machine.axis_names, way, dwell_s, target)
    raise PlanningError(
        "keep-out boxes stand between the places that check one station against the "
        "other; correct the workspace"
    )


def _list_moves(
    way: Float64[np.ndarray, "n a"], lines: Sequence[Commanded]
) -> tuple[Float64[np.ndarray, "m a"], Float64[np.ndarray, "m a"]]:
    """Begins and ends of moves between known points and lines.

    A check that ends early restarts from any of the points.
    """
    first, last = way[:1], way[-1:]
    begin, end = [way[:-1], way], [way[1:], np.repeat(first, len(way), axis=0)]
    for rows in lines:
        begin += [last, rows.position[-1:]]
        end += [rows.position[:1], first]
    return np.concatenate(begin), np.concatenate(end)


def _make_grid(machine: Machine) -> Float64[np.ndarray, "n a"]:
    low, high = inner_travel(machine)
    unit = np.array(list(product((0.0, 0.5, 1.0), repeat=len(machine.linear_axes))))
    linear = unit.shape[1]
    places = low[:linear] + unit * (high - low)[:linear]
    rest = [float(np.clip(0.0, a.low, a.high)) for a in machine.rotary_axes]
    return np.round(np.hstack([places, np.tile(rest, (len(places), 1))]), DECIMALS)


def _spread(places: Float64[np.ndarray, "n a"]) -> Float64[np.ndarray, "m a"]:
    if not len(places):
        return np.zeros((1, places.shape[1]))
    chosen = places[:1]
    while len(chosen) < min(_POINTS, len(places)):
        apart = np.linalg.norm(places[:, None] - chosen, axis=2).min(axis=1)
        chosen = np.vstack([chosen, places[np.argmax(apart)]])
    return chosen
