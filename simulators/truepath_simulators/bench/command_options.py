"""Options of `truepath simulate`, and their valid values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from truepath_simulators.compensation.rules import BACKLASH_READINGS, Rules
from truepath_simulators.errors import SimulatorError
from truepath_simulators.faults import KINDS, parse_fault
from truepath_simulators.hidden.effects_by_name import list_names
from truepath_simulators.scenario import list_machines

_LAST_PORT = 65535


def make_parser() -> argparse.ArgumentParser:
    """Parser of `truepath simulate`; its epilog lists the faults."""
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
