"""Orders that a rig executes from its control socket."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from truepath_simulators.bench.bench import Bench
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.processes import DeviceProcesses
from truepath_simulators.worlds.bundle_files import truth_of

Order = dict[str, Any]


def obey(rig: DeviceProcesses, order: Order) -> dict[str, Any]:
    """Execute an order and give its answer. Raises SimulatorError with the reason.

    `own`, `links` and `state` are for every rig, the others for a bench.
    """
    verb = order.get("do")
    if verb in _ANY:
        return _ANY[verb](rig)
    if verb not in _BENCH:
        known = ", ".join([*_ANY, *_BENCH])
        raise SimulatorError(f"order {verb!r}: unknown; known are {known}")
    if not isinstance(rig, Bench):
        raise SimulatorError(f"{verb}: a replay only repeats what was recorded")
    return _BENCH[verb](rig, order)


def _inject(bench: Bench, order: Order) -> dict[str, Any]:
    bench.inject(str(_take(order, "fault")))
    return {}


def _move_tracker(bench: Bench, order: Order) -> dict[str, Any]:
    place = np.asarray(_take(order, "place_mm"), float)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise SimulatorError("place_mm: expected [x, y, z] in mm")
    bench.move_tracker(place.tolist(), int(order.get("number", 1)))
    return {}


def _load_compensation(bench: Bench, order: Order) -> dict[str, Any]:
    rules = Rules(
        order.get("backlash_reading", Rules().backlash_reading),
        bool(order.get("reversed_sign", False)),
        float(order.get("tool_length_mm", 0.0)),
        str(order.get("measuring_system", Rules().measuring_system)),
    )
    bench.load_compensation(LoadedTables.from_paths(_take(order, "files"), rules))
    return {"files": list(bench.compensation.files)}


def _read_position(bench: Bench, order: Order) -> dict[str, Any]:
    times = np.atleast_1d(np.asarray(order.get("time_s", bench.now_s()), float))
    if times.ndim != 1 or not np.isfinite(times).all():
        raise SimulatorError("time_s: expected seconds of the machine's clock")
    followed = bench.follow(times, str(order.get("target", "")))
    return {
        "axes": list(bench.truth.machine.axis_names),
        "time_s": followed.time_s.tolist(),
        "position": followed.position.tolist(),
        "target_mm": followed.target_mm.tolist(),
    }


def _read_truth(bench: Bench, order: Order) -> dict[str, Any]:
    told = truth_of(bench.truth, bench.hidden_truth())
    if "points" in order:
        points = np.atleast_2d(np.asarray(order["points"], float))
        if points.shape[1:] != (len(bench.truth.machine.axes),):
            raise SimulatorError("points: expected rows of axis positions")
        deviation_um = bench.truth_at(points, float(order.get("direction", 1.0)))
        told |= {"points_mm": points.tolist(), "deviation_um": deviation_um.tolist()}
    return {
        **told,
        "squareness_rad": dict(bench.truth.squareness_rad),
        "locations": bench.truth.locations(),
        "pose": {
            "position_mm": bench.pose.position_mm.tolist(),
            "rotation": bench.pose.rotation.tolist(),
        },
    }


def _take(order: Order, key: str) -> Any:
    if key not in order:
        raise SimulatorError(f"{order['do']}: {key} is missing")
    return order[key]


_ANY: dict[str, Callable[[DeviceProcesses], dict[str, Any]]] = {
    "links": lambda rig: rig.describe(),
    "state": lambda rig: rig.read_state(),
    "own": lambda _: {},
}
_BENCH: dict[str, Callable[[Bench, Order], dict[str, Any]]] = {
    "compensate": _load_compensation,
    "inject": _inject,
    "move-tracker": _move_tracker,
    "position": _read_position,
    "truth": _read_truth,
}
