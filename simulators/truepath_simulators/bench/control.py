"""The control socket of a rig: orders in, answers out, one JSON object a line.

A Unix socket that only its owner can open. Nothing blocks: the rig serves it together
with everything else. `truepath_simulators.bench.rig` is the other end.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from truepath_simulators.bench.bench import Bench
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.processes import DeviceProcesses
from truepath_simulators.worlds.recording import truth_of

MAX_LINE = 1 << 20
_BLOCK = 1 << 16
_BACKLOG = 8
_WRITE_S = 1.0

Answer = Callable[[dict[str, Any]], dict[str, Any]]


class ControlSocket:
    """Accepts any number of clients.

    path : of the socket; one left behind by a rig that was killed is replaced
    answer : executes an order and returns the answer; raises SimulatorError

    Raises SimulatorError if the path is taken by something else or by a rig that still
    listens.
    """

    def __init__(self, path: Path, answer: Answer) -> None:
        self._path, self._answer = path, answer
        self._listener = _listen(path)
        self._identity = os.stat(path).st_ino
        self._clients: dict[int, _Client] = {}
        self.has_lost_owner = False

    def descriptors(self) -> list[int]:
        """Descriptors that become readable when there is something to do."""
        return [self._listener.fileno(), *self._clients]

    def serve(self) -> None:
        """Accept new clients and answer what has arrived; never waits."""
        with contextlib.suppress(BlockingIOError):
            link, _ = self._listener.accept()
            link.settimeout(0.0)
            self._clients[link.fileno()] = _Client(link)
        for number, client in list(self._clients.items()):
            if not client.serve(self._answer):
                self._clients.pop(number)
                self.has_lost_owner |= client.owns
                client.close()

    def close(self) -> None:
        """Release the socket; remove its path if it is still ours."""
        self._listener.close()
        for client in self._clients.values():
            client.close()
        with contextlib.suppress(OSError):
            if os.stat(self._path).st_ino == self._identity:
                self._path.unlink()


class _Client:
    """owns : the rig ends with this connection"""

    def __init__(self, link: socket.socket) -> None:
        self.owns = False
        self._link, self._rest = link, b""

    def serve(self, answer: Answer) -> bool:
        try:
            data = self._link.recv(_BLOCK)
        except BlockingIOError:
            return True
        except OSError:
            return False
        *lines, self._rest = (self._rest + data).split(b"\n")
        if not data or len(self._rest) > MAX_LINE:
            return False
        return all(self._reply(line, answer) for line in lines if line.strip())

    def close(self) -> None:
        self._link.close()

    def _reply(self, line: bytes, answer: Answer) -> bool:
        try:
            order = _parse(line)
            self.owns = self.owns or order.get("do") == "own"
            told = {"ok": True, **answer(order)}
        except (SimulatorError, ValueError, TypeError, KeyError) as error:
            told = {"ok": False, "error": str(error)}
        self._link.settimeout(_WRITE_S)  # a client that does not read is left alone
        try:
            self._link.sendall(json.dumps(told).encode() + b"\n")
        except OSError:
            return False
        self._link.settimeout(0.0)
        return True


def _parse(line: bytes) -> dict[str, Any]:
    order = json.loads(line)
    if not isinstance(order, dict):
        raise SimulatorError('expected an object such as {"do": "state"}')
    return order


def _listen(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)  # the owner alone reads and writes, from the first moment
    try:
        if path.is_socket() and not _is_served(path):
            path.unlink()
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise SimulatorError(
            f"control socket {path}: {error.strerror or error}; give another path"
        ) from error
    finally:
        os.umask(before)
    listener.listen(_BACKLOG)
    listener.setblocking(False)
    return listener


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        return probe.connect_ex(str(path)) == 0


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
