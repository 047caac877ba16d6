"""`truepath simulate`: the simulated tracker and CNC as stand-alone processes.

Prints where they listen, one line each (or one JSON object), and serves until SIGINT or
SIGTERM. Lines on standard input are faults to inject, or `move X,Y,Z`, which moves the
tracker.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command_options import make_parser
from truepath_simulators.bench.control_orders import obey
from truepath_simulators.bench.control_socket import ControlSocket
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.processes import DeviceProcesses
from truepath_simulators.replay.replay import Replay
from truepath_simulators.scenario import load_machine

_CHECK_S = 0.5


def main(argv: Sequence[str] | None = None) -> int:
    """Runs until a signal comes. Exit status 2 on a bad machine, fault or port."""
    options = make_parser().parse_args(argv)
    try:
        bench = _rig(options)
        with _signals() as signalled, bench, _control(options, bench) as control:
            _announce(bench, as_json=options.json)
            return _serve(bench, signalled, control)
    except (SimulatorError, OSError) as error:
        print(f"truepath simulate: {error}", file=sys.stderr)
        return 2


def _rig(options: argparse.Namespace) -> DeviceProcesses:
    if options.replay is None:
        return _bench(options)
    changes = options.fault or options.hide or options.follow or options.compensation
    if changes or options.protocol != "gst":
        raise SimulatorError(
            "--replay only repeats: no --fault, --hide, --follow, --compensation or "
            "--protocol"
        )
    return Replay(
        options.replay,
        options.speed,
        options.links,
        tracker=options.tracker,
        host=options.host,
        tracker_port=options.tracker_port,
        modbus_port=options.modbus_port,
        rtu=options.rtu,
    )


def _bench(options: argparse.Namespace) -> Bench:
    return Bench(
        load_machine(options.machine),
        options.seed,
        options.speed,
        options.fault,
        options.links,
        tracker=options.tracker,
        host=options.host,
        tracker_port=options.tracker_port,
        modbus_port=options.modbus_port,
        error_scale=options.error_scale,
        rtu=options.rtu,
        hidden=options.hide,
        source=options.follow,
        source_unit_s=options.follow_unit,
        protocol=options.protocol,
        compensation=LoadedTables.from_paths(
            options.compensation,
            Rules(
                options.backlash_reading,
                options.reversed_sign,
                measuring_system=options.measuring_system,
            ),
        ),
    )


@contextmanager
def _control(
    options: argparse.Namespace, bench: DeviceProcesses
) -> Iterator[ControlSocket | None]:
    if options.control is None:
        yield None
        return
    with closing(ControlSocket(options.control, lambda o: obey(bench, o))) as control:
        yield control


def _serve(
    bench: DeviceProcesses, signalled: int, control: ControlSocket | None
) -> int:
    lines = _LineReader(sys.stdin.fileno()) if sys.stdin else None
    while True:
        listening = lines is not None and lines.ours
        waited = [signalled, lines.descriptor] if lines and listening else [signalled]
        waited += control.descriptors() if control else []
        ready, _, _ = select.select(waited, [], [], _CHECK_S)
        if signalled in ready:
            return 0
        if control:
            control.serve()
            if control.has_lost_owner:
                return 0
        if not bench.alive:
            print("truepath simulate: a simulator has ended", file=sys.stderr)
            return 1
        if lines and lines.descriptor in ready:
            _inject(bench, lines.read())
            lines = None if lines.ended else lines


def _inject(bench: DeviceProcesses, texts: list[str]) -> None:
    for text in texts:
        try:
            if not isinstance(bench, Bench):
                raise SimulatorError(f"{text}: a replay only repeats")
            if text.startswith("move "):
                _move(bench, text.removeprefix("move "))
            else:
                bench.inject(text)
        except SimulatorError as error:
            print(f"truepath simulate: {error}", file=sys.stderr)


def _move(bench: Bench, place: str) -> None:
    try:
        x, y, z = map(float, place.split(","))
    except ValueError as error:
        raise SimulatorError(f"move {place}: expected X,Y,Z in mm") from error
    bench.move_tracker((x, y, z))


class _LineReader:
    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.ended = False
        self._rest = b""

    @property
    def ours(self) -> bool:
        """A terminal stops a background job that reads."""
        if not os.isatty(self.descriptor):
            return True
        return os.tcgetpgrp(self.descriptor) == os.getpgrp()

    def read(self) -> list[str]:
        data = os.read(self.descriptor, 4096)
        self.ended = not data
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [line.decode().strip() for line in lines if line.strip()]


@contextmanager
def _signals() -> Iterator[int]:
    read, write = os.pipe()
    os.set_blocking(write, False)
    before = {
        number: signal.signal(number, lambda *_: os.write(write, b"!"))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield read
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(read)
        os.close(write)


def _announce(bench: DeviceProcesses, *, as_json: bool) -> None:
    where = bench.describe()
    if as_json:
        print(json.dumps(where), flush=True)
        return
    for name, value in where.items():
        print(f"{name:10s}  {_as_text(value)}", flush=True)


def _as_text(value: object) -> str:
    if not isinstance(value, dict):
        return str(value)
    return "  ".join(f"{key}={entry}" for key, entry in value.items())


if __name__ == "__main__":
    sys.exit(main())
