"""`truepath machine new`: a machine file from options, or from answers."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import typer

from truepath.cli.terminal import OutputFile, print_files, say
from truepath.errors import BadInput

machine = typer.Typer(help="Machine files.", no_args_is_help=True)

_LINEAR, _ROTARY = "XYZ", "ABC"
_CHAIN = "w-X-b-Y-Z-t"


@dataclass
class _Stated:
    """What options state, in their form."""

    travel: list[str] = field(default_factory=list[str])
    chain: str = ""
    targets: list[str] = field(default_factory=list[str])
    origins: list[str] = field(default_factory=list[str])
    directions: list[str] = field(default_factory=list[str])
    stands_on: str = "workpiece"
    max_feed: float | None = None
    acceleration: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Keys of `machine.json`. Raises BadInput naming the option."""
        if not self.chain or not self.targets:
            option = (
                "--target, as 20,30,-150" if self.chain else f"--chain, as {_CHAIN}"
            )
            raise BadInput(f"with --travel nothing is asked for; add {option}")
        axes = dict(_read_travel(text) for text in self.travel)
        turns = ("origin_mm", self.origins), ("direction", self.directions)
        for key, text in ((key, text) for key, texts in turns for text in texts):
            name, numbers = _read_numbers(text, 3)
            if axes.get(name, {}).get("type") != "rotary":
                raise BadInput(f"{text}: --travel states no rotary axis {name!r}")
            axes[name][key] = numbers
        targets = dict(_read_target(text) for text in self.targets)
        limits = {
            "max_feed_mm_min": self.max_feed,
            "acceleration_mm_s2": self.acceleration,
        }
        return {
            "axes": axes,
            "kinematic_chain": self.chain,
            **({"targets": targets} if all(targets) else {}),
            **({"tool_offset_mm": targets[""]["offset_mm"]} if "" in targets else {}),
            "tracker": {"stands_on": self.stands_on},
            "motion": {k: v for k, v in limits.items() if v is not None},
        }


@machine.callback()
def machine_files() -> None:
    """Machine files."""


@machine.command("new")
def new_machine(
    output: OutputFile,
    name: Annotated[str, typer.Option(help="Else that of the file.")] = "",
    travel: Annotated[
        list[str] | None,
        typer.Option(metavar="AXIS=LOW,HIGH", help="mm; of A, B, C deg."),
    ] = None,
    chain: Annotated[
        str, typer.Option(metavar="CHAIN", help=f"From workpiece to tool: {_CHAIN}.")
    ] = "",
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=SIDE,]X,Y,Z",
            help="Offset of the reflector, mm; of several its name, and tool or "
            "workpiece.",
        ),
    ] = None,
    origin: Annotated[
        list[str] | None,
        typer.Option(metavar="AXIS=X,Y,Z", help="A point that it turns about."),
    ] = None,
    direction: Annotated[
        list[str] | None,
        typer.Option(metavar="AXIS=X,Y,Z", help="About which it turns right-handed."),
    ] = None,
    stands_on: Annotated[
        Literal["workpiece", "base"],
        typer.Option(help="The tracker: on the table, on the floor."),
    ] = "workpiece",
    max_feed: Annotated[
        float | None, typer.Option(metavar="MM/MIN", help="The highest of a plan.")
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(metavar="MM/S2", help="Along a line.")
    ] = None,
) -> None:
    """A machine file; without --travel it asks, and shows what is usual."""
    from truepath.files.bundle.machine_file import encode_machine, machine_from_json

    if output.exists():
        raise BadInput(f"{output}: is there already; name another file")
    stated = (
        _Stated(
            travel,
            chain,
            target or [],
            origin or [],
            direction or [],
            stands_on,
            max_feed,
            acceleration,
        )
        if travel
        else _interview()
    )
    content = {"schema": "machine/1", "name": name or output.stem, **stated.as_json()}
    output.write_bytes(encode_machine(machine_from_json(content, file=output.name)))
    print_files([output])
    say(f"next: truepath plan {output} -o plan")


def _interview() -> _Stated:
    made = _Stated()
    for axis in _LINEAR:
        made.travel.append(
            _ask(f"Travel of {axis}, LOW,HIGH in mm", _read_travel, axis)
        )
    for axis in _ROTARY:
        question = f"Travel of {axis}, LOW,HIGH in deg; empty if there is none"
        if ends := _ask(question, _read_travel, axis, usual=""):
            made.travel.append(ends)
            question = f"A point that {axis} turns about, X,Y,Z in mm"
            made.origins.append(_ask(question, _read_turn, axis, usual="0,0,0"))
            usual = ",".join("01"[axis == other] for other in _ROTARY)
            question = f"About which {axis} turns right-handed"
            made.directions.append(_ask(question, _read_turn, axis, usual=usual))
    question = "Workpiece, axes of the table, b for the bed, axes of the tool, tool"
    made.chain = _ask(question, str, usual=_CHAIN)
    question = "Reflector from the point that the control shows, X,Y,Z in mm"
    made.targets.append(_ask(question, _read_target, "T1=tool," * bool(made.origins)))
    question = (
        "Another reflector, NAME=tool,X,Y,Z or NAME=workpiece,X,Y,Z; empty if none"
    )
    while made.origins and (more := _ask(question, _read_target, usual="")):
        made.targets.append(more)
    question = "Tracker on the table, workpiece, or on the floor, base"
    made.stands_on = _ask(question, _read_place, usual=made.stands_on)
    limits = [
        _ask(f"{name}; empty if not known", _read_limit, usual="")
        for name in ("Highest feed in mm/min", "Acceleration in mm/s²")
    ]
    made.max_feed, made.acceleration = map(_read_limit, limits)
    return made


def _ask(
    question: str,
    read: Callable[[str], object],
    begin: str = "",
    usual: str | None = None,
) -> str:
    """The answer that can be read, after a begin that it does not state itself."""
    begin += "=" * (len(begin) == 1)
    while True:
        say(f"{question}{f' [{usual}]' if usual else ''}:")
        line = sys.stdin.readline()
        if not line:
            raise BadInput(f"{question}: nobody answers; state all by options (--help)")
        answer = line.strip() or usual
        if answer == "":
            return ""
        try:
            text = begin + (answer or "")
            read(text)
        except BadInput as error:
            say(str(error))
        else:
            return text


def _read_travel(text: str) -> tuple[str, dict[str, Any]]:
    name, (low, high) = _read_numbers(text, 2)
    if name in _LINEAR:
        return name, {"type": "linear", "min_mm": low, "max_mm": high}
    return name, {"type": "rotary", "min_deg": low, "max_deg": high}


def _read_turn(text: str) -> object:
    return _read_numbers(text, 3)


def _read_target(text: str) -> tuple[str, dict[str, Any]]:
    name, _, rest = text.rpartition("=")
    side, _, numbers = rest.partition(",") if name else ("tool", "", rest)
    offset_mm = _read_numbers(f"{name}={numbers}", 3)[1]
    return name, {"on": side, "offset_mm": offset_mm}


def _read_place(text: str) -> None:
    if text not in ("workpiece", "base"):
        raise BadInput(f"{text}: write workpiece or base")


def _read_limit(text: str) -> float | None:
    return _read_numbers(f"={text}", 1)[1][0] if text else None


def _read_numbers(text: str, count: int) -> tuple[str, list[float]]:
    """Raises BadInput unless it is NAME=, and so many numbers between commas."""
    name, _, rest = text.rpartition("=")
    with suppress(ValueError):
        numbers = [float(part) for part in rest.split(",")]
        if len(numbers) == count and all(map(math.isfinite, numbers)):
            return name, numbers
    example = ",".join(["0", "500", "20"][:count])
    raise BadInput(f"{text}: write {count} numbers and commas, as {name}={example}")
