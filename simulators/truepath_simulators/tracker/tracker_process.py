"""The tracker as a separate process.

`python -m truepath_simulators.tracker.tracker_process`
"""

from __future__ import annotations

import json
import select
import time
from functools import partial
from typing import Any

from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.faults import Schedule, parse_fault
from truepath_simulators.hidden.effects_by_name import from_json
from truepath_simulators.links.links import Port, make_port
from truepath_simulators.machine import tracker_head
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.followed_positions import FollowedPositions
from truepath_simulators.processes import LifeLine, MachineClock, is_question
from truepath_simulators.timeline import BoardReader
from truepath_simulators.tracker.polled import (
    GeoComStation,
    LineInstrument,
    T2saApplication,
)
from truepath_simulators.tracker.tracker_device import BUFFER_BYTES, TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts

# Ten samples at 500 Hz: few wake-ups, and well below the delay that a host notices.
PERIOD_S = 0.02
_IDLE_S = 0.1
_POLLED = {"geocom": GeoComStation, "t2sa": T2saApplication}
Device = TrackerDevice | LineInstrument


def main() -> None:
    life = LifeLine()
    orders = life.orders()
    if not orders:
        return
    try:
        port = make_port(orders["link"])
    except OSError as error:
        life.report_failure(error)
        return
    try:
        _serve(life, port, orders)
    finally:
        port.close()


def _serve(life: LifeLine, port: Port, orders: dict[str, Any]) -> None:
    source = _source(orders)
    clock = (
        source
        if isinstance(source, FollowedPositions)
        else MachineClock(orders["epoch_ns"], orders["speed"])
    )
    faults = Schedule(map(parse_fault, orders["faults"]))
    device = _device(orders, faults)
    _obey(device, {"compensation": orders["compensation"]}, orders)
    life.report(port.address)
    wake_s = time.monotonic()
    while not life.ended:
        for line in life.lines():
            if is_question(line):
                life.report(device.read_state())
            elif line.startswith("{"):
                _obey(device, json.loads(line), orders)
            else:
                faults.add(parse_fault(line), clock.now_s())
        # Its clock first: see `timeline`. Followed positions have their own time.
        now_s, wall_s = clock.now_s(), time.monotonic()
        timeline = source.timeline()
        if faults.strikes("disconnect", now_s):
            port.disconnect()
            device.forget_host()
        port.converse(
            partial(device.receive, true_s=now_s, wall_s=wall_s), device.forget_host
        )
        due = b""
        if timeline is not None:
            due = device.due(timeline, now_s, wall_s, port.waiting_bytes)
        port.send(due)
        wake_s = _next_wake(wake_s, wall_s, streaming=device.streaming)
        _wait([life.descriptor, *port.descriptors()], port, wake_s)


def _obey(device: Device, order: dict[str, Any], orders: dict[str, Any]) -> None:
    if "compensation" in order:
        machine = parse_machine(orders["machine"])
        tables = LoadedTables.from_json(order["compensation"])
        device.sight.correct(tables.correct(machine))
        return
    seed = orders["seed"] + 1000 * order["number"]
    device.sight.set_down(tracker_head.reposition(order["place"], seed))


def _next_wake(last_s: float, now_s: float, *, streaming: bool) -> float:
    """Keeps absolute deadlines; after a stall the next one is in the future again."""
    if not streaming:
        return now_s + _IDLE_S
    steps = max(int((now_s - last_s) / PERIOD_S) + 1, 1)
    return last_s + steps * PERIOD_S


def _wait(descriptors: list[int], port: Port, until_s: float) -> None:
    # Waiting bytes are sent as soon as there is room, not at the next period: the reply
    # to a new host is queued behind the bytes that the last one has not read.
    blocked = port.list_blocked_descriptors()
    select.select(descriptors, blocked, [], max(until_s - time.monotonic(), 0.0))


def _source(orders: dict[str, Any]) -> BoardReader | FollowedPositions:
    if orders["source_unit_s"] is None:
        return BoardReader(orders["board"])
    axes = len(orders["machine"]["axes"])
    return FollowedPositions(orders["board"], axes, orders["source_unit_s"])


def _device(orders: dict[str, Any], faults: Schedule) -> Device:
    machine, seed = parse_machine(orders["machine"]), orders["seed"]
    parts = TrackerParts(
        random_machine(machine, seed, scale=orders["error_scale"]),
        tracker_head.random_pose(machine, seed),
        tracker_head.random_clock(seed),
        Air(),
        seed,
        tuple(map(from_json, orders["hidden"])),
    )
    if make := _POLLED.get(orders.get("protocol", "gst")):
        return make(parts, faults)
    # Time limits of a link stay in wall seconds: a faster clock fills a larger buffer.
    buffer_bytes = int(BUFFER_BYTES * max(orders["speed"], 1.0))
    return TrackerDevice(parts, faults, buffer_bytes)


if __name__ == "__main__":
    main()
