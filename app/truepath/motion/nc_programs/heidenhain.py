"""Heidenhain TNC, Klartext.

`M91` holds in its block: positions count from the machine datum, without the tool's
length; `R0` disables its radius. A TNC has no exact-stop mode, and it smooths
transitions between lines, so each row has a dwell (cycle 9), a short one where the path
has none: a dwell makes the axes stop. Cycle 32 bounds the smoothing; without a value it
is again that of the machine. Rotary axes move at deg/min; on a line with both kinds a
degree counts as a millimetre. Centre and ends of circles count from the place where
they begin: `M91` has no place in their blocks. A turn is a block.

Source: iTNC 530 and TNC 640 user's manuals (M91; cycles 9 and 32; M116 for the feed).
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from truepath.motion.nc_programs.dialect import (
    PLANES,
    BlockForms,
    Dialect,
    ProgramArc,
    ProgramContent,
    ProgramRow,
    write_words,
)
from truepath.motion.nc_programs.programmed_motion import (
    AXES,
    Circle,
    ProgrammedMotion,
    SimulatedControl,
    line_error,
)

_FORMS = BlockForms(
    motion="L {ends} R0 F{row.path_feed:.3f} M91 ; {row.label}",
    dwell=("CYCL DEF 9.0 DWELL TIME", "CYCL DEF 9.1 DWELL {:.3f}"),
    message="; {}",
    stop="STOP",
    number="+.4f",
)
_NO_SMOOTHING = ("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1 T0.002")  # mm
_MACHINES_SMOOTHING = ("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1")


class Heidenhain(Dialect):
    """Klartext programs, `.H`. A file and its program have one name."""

    control = "Heidenhain TNC"
    suffix = ".h"
    least_dwell_s = 0.1
    counts_degrees = True
    frame = "FROM THE MACHINE DATUM IN EACH BLOCK - M91"
    drives_arcs = True

    def write(self, content: ProgramContent) -> str:
        """Blocks are numbered without a gap."""
        blocks = [
            f"BEGIN PGM {content.name} MM",
            *(f"; {line}" for line in content.header),
            *_NO_SMOOTHING,
            *_FORMS.write_rows(content, write_arc=_write_arc),
            *_MACHINES_SMOOTHING,
            "M30",
            f"END PGM {content.name} MM",
        ]
        return "".join(f"{number} {block}\n" for number, block in enumerate(blocks))

    def read(self, text: str) -> ProgrammedMotion:
        """Raises PlanningError at a gap in the block numbers."""
        return _Reader(text).finish()


def _write_arc(row: ProgramRow, arc: ProgramArc) -> Iterator[str]:
    columns = [row.axes.index(axis) for axis in arc.axes]
    sense = "+" if arc.is_positive else "-"
    for rest in range(arc.turns, -1, -1):
        led = [row.position[c] for c in columns] if rest == 0 else arc.begin
        step = [round(b - a, 4) + 0.0 for a, b in zip(arc.begin, led, strict=True)]
        ends = write_words(arc.axes, step, "+.4f", "I")
        yield f"CC {write_words(arc.axes, arc.centre, '+.4f', 'I')}"
        yield f"C {ends} DR{sense} R0 F{row.feed:.3f} ; {row.label}"


_BLOCK = re.compile(r"(\d+) (.+)")
_PROGRAM = re.compile(r"(BEGIN|END) PGM (\w+) (MM|INCH)")
_LINE = re.compile(r"L((?: [A-Z][-+]\d+\.\d*)+) R0(?: F(\d+\.?\d*))? M91")
_POLE = re.compile(r"CC I([XYZ])([-+]\d+\.\d*) I([XYZ])([-+]\d+\.\d*)")
_CIRCLE = re.compile(
    r"C I([XYZ])([-+]\d+\.\d*) I([XYZ])([-+]\d+\.\d*) DR([-+]) R0(?: F(\d+\.?\d*))?"
)
_END = re.compile(r"([A-Z])([-+]\d+\.\d*)")
_PASSIVE = re.compile(
    r"|M30|CYCL DEF 9\.0 DWELL TIME|CYCL DEF 32\.0 TOLERANCE|CYCL DEF 32\.1( T[\d.]+)?"
)
_DWELL = re.compile(r"CYCL DEF 9\.1 DWELL (\d+\.?\d*)")


class _Reader:
    def __init__(self, text: str) -> None:
        self._control = SimulatedControl(text, counts_degrees=True)
        self._feed: float | None = None
        self._ended = False
        self._pole: tuple[str, float, float] | None = None
        for number, line in enumerate(text.splitlines(), 1):
            numbered = _BLOCK.fullmatch(line.rstrip())
            if numbered is None or int(numbered.group(1)) != number - 1:
                raise line_error(
                    number, f"does not begin with block number {number - 1}"
                )
            self._read_block(number, numbered.group(2).partition(";")[0].strip())

    def finish(self) -> ProgrammedMotion:
        if not self._ended:
            raise line_error(0, "it has no END PGM")
        return self._control.finish()

    def _read_block(self, line: int, block: str) -> None:
        straight, dwell = _LINE.fullmatch(block), _DWELL.fullmatch(block)
        program = _PROGRAM.fullmatch(block)
        if self._ended:
            raise line_error(line, "a block after END PGM")
        if program:
            self._read_frame(line, *program.groups())
        elif not self._control.name:
            raise line_error(line, "it does not begin with BEGIN PGM")
        elif straight:
            self._drive(line, straight)
        elif pole := _POLE.fullmatch(block):
            first, x, second, y = pole.groups()
            self._pole = first + second, float(x), float(y)
        elif circle := _CIRCLE.fullmatch(block):
            self._turn(line, *circle.groups())
        elif dwell:
            self._control.dwell(line, float(dwell.group(1)))
        elif block == "STOP":
            self._control.halt()
        elif block.startswith("L "):
            raise line_error(
                line, "a straight line needs signed positions with a point, R0, M91"
            )
        elif not _PASSIVE.fullmatch(block):
            raise line_error(line, f"{block!r} has no place in a measuring path")

    def _read_frame(self, line: int, word: str, name: str, unit: str) -> None:
        if unit != "MM":
            raise line_error(line, "the unit is INCH; MM is needed")
        begins = word == "BEGIN"
        if begins == bool(self._control.name) or (
            not begins and name != self._control.name
        ):
            raise line_error(
                line, f"{word} PGM {name} does not fit the lines before it"
            )
        self._control.name, self._ended = name, not begins

    def _turn(
        self, line: int, first: str, x: str, second: str, y: str, sense: str, feed: str
    ) -> None:
        axes = first + second
        if axes not in PLANES or self._pole is None or self._pole[0] != axes:
            raise line_error(line, f"a circle in {axes} without CC in this order")
        (_, *centre), self._pole = self._pole, None
        self._feed = float(feed) if feed else self._feed
        self._control.turn(
            line,
            (float(x), float(y)),
            Circle(axes, (centre[0], centre[1]), sense == "+"),
            self._feed,
        )

    def _drive(self, line: int, straight: re.Match[str]) -> None:
        ends = {name: float(value) for name, value in _END.findall(straight.group(1))}
        odd = [name for name in ends if name not in AXES]
        if odd:
            raise line_error(line, f"{odd[0]} is no axis")
        if straight.group(2):
            self._feed = float(straight.group(2))
        self._control.move(line, ends, self._feed, exact_stop=False)
