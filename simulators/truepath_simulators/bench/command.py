"""`truepath simulate`: the simulated tracker and CNC as stand-alone processes.

Prints where they listen, one line each (or one JSON object), and serves until SIGINT or
SIGTERM. Lines on standard input are faults to inject, or `move X,Y,Z`, which moves the
tracker.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.control import ControlSocket, obey
from truepath_simulators.compensation.correction import BACKLASH_READINGS, Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.faults import KINDS, parse_fault
from truepath_simulators.hidden.effects_by_name import list_names
from truepath_simulators.machine_file import list_machines, load_machine
from truepath_simulators.processes import DeviceProcesses
from truepath_simulators.replay.replay import Replay

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


_LAST_PORT = 65535


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="truepath simulate",
        description="A simulated tracker and CNC (Modbus) for test rigs.",
        epilog="faults: "
        + "; ".join(
            f"{device}:{kind} ({entry.meaning})"
            for device, kinds in KINDS.items()
            for kind, entry in kinds.items()
        ),
    )
    _add_simulation(parser.add_argument)
    _add_compensation(parser.add_argument)
    _add_links(parser.add_argument)
    add = parser.add_argument
    add(
        "--follow",
        metavar="SOURCE",
        help="file, FIFO or HOST:PORT with lines of time and axis positions, in place "
        "of the simulated CNC",
    )
    add(
        "--follow-unit",
        type=float,
        default=1.0,
        metavar="SECONDS",
        help="what a step of the first column of those lines is",
    )
    add(
        "--control",
        type=Path,
        metavar="PATH",
        help="Unix socket for orders in lines of JSON, for this user alone",
    )
    add("--json", action="store_true", help="print one JSON object")
    return parser


def _add_simulation(add: Callable[..., object]) -> None:
    add(
        "--machine",
        default="demo",
        help=f"machine.json, or one of {', '.join(list_machines())}",
    )
    add(
        "--replay",
        type=Path,
        metavar="RUN",
        help="repeat this recorded Run in place of simulating; --speed is its pace",
    )
    add("--seed", type=_natural, default=1, help="of errors, noise and pose")
    add("--speed", type=_positive, default=1.0, help="device seconds in a wall second")
    add("--error-scale", type=_finite, default=1.0, help="0 is a perfect machine")
    add(
        "--fault",
        action="append",
        default=[],
        type=_fault,
        help="device:kind[@begin][+duration][*amount]; may be given several times",
    )
    add(
        "--hide",
        action="append",
        default=[],
        metavar="EFFECT[*SIZE_UM]",
        help="an effect that the model in use lacks, drawn by the seed, or a JSON "
        "object with its numbers: " + ", ".join(list_names()),
    )


def _add_compensation(add: Callable[..., object]) -> None:
    add(
        "--compensation",
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="FILE",
        help="compensation tables of one controller: LinuxCNC, SINUMERIK, Heidenhain, "
        "Fanuc, ISG_CSV or Etalon Exchange",
    )
    add(
        "--backlash-reading",
        choices=BACKLASH_READINGS,
        default=Rules().backlash_reading,
        help="of the column BACKLASH of Heidenhain tables",
    )
    add(
        "--measuring-system",
        metavar="1|2|X=1,Y=2",
        default=Rules().measuring_system,
        help="that is active, of the axes of a SINUMERIK; 1 of axes not named",
    )
    add(
        "--reversed-sign",
        action="store_true",
        help="the controller takes the tables with the other sign",
    )


def _add_links(add: Callable[..., object]) -> None:
    add("--tracker", choices=["pty", "tcp"], default="pty", help="link of the tracker")
    add(
        "--protocol",
        choices=["gst", "geocom", "t2sa"],
        default="gst",
        help="of the tracker: gst streams, geocom and t2sa are asked point by point",
    )
    add("--tracker-port", type=_port, default=0, help="TCP port; 0 takes a free one")
    add("--modbus-port", type=_port, default=0, help="TCP port; 0 takes a free one")
    add("--rtu", action="store_true", help="serve Modbus RTU on a terminal as well")
    add("--host", default="127.0.0.1", help="address to listen on")
    add("--links", type=Path, help="folder for links named tracker and modbus-rtu")


def _natural(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is no whole number from 0 on")
    return int(text)


def _port(text: str) -> int:
    if _natural(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text} is no port: 0 to {_LAST_PORT}")
    return int(text)


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is no number")
    return value


def _positive(text: str) -> float:
    if _finite(text) <= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not above zero")
    return float(text)


def _fault(text: str) -> str:
    try:
        parse_fault(text)
    except SimulatorError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


if __name__ == "__main__":
    sys.exit(main())
