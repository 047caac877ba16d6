"""Readers of G-code (ISO 6983): words, modal groups, motions; the dialect of LinuxCNC.

LinuxCNC is RS-274/NGC; its motion rules are in `drivers.interfaces.rs274`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from truepath.motion.nc_programs.dialect import (
    CENTRES,
    PLANES,
    BlockForms,
    Dialect,
    ProgramContent,
    number_blocks,
)
from truepath.motion.nc_programs.programmed_motion import (
    AXES,
    Circle,
    ProgrammedMotion,
    SimulatedControl,
    line_error,
)
from truepath_drivers.interfaces import rs274

_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*")

ARCS = ("G2", "G3")

Groups = Mapping[str, Sequence[str]]
"""Modal groups by name; the first code of each is the one a motion needs."""

MILLING_GROUPS: Groups = {
    "the unit": ("G21", "G20"),
    "the plane": ("G17", "G18", "G19"),
    "radius compensation": ("G40", "G41", "G42"),
    "the tool length": ("G49", "G43"),
    "the cycle": ("G80", "G81", "G82", "G83"),
    "the dimension": ("G90", "G91"),
    "the feed": ("G94", "G93", "G95"),
}


@dataclass(frozen=True, slots=True)
class Word:
    """A letter and its number as written: `X10.` is not `X10` everywhere."""

    letter: str
    digits: str

    @property
    def value(self) -> float:
        """The number without regard to a missing decimal point."""
        return float(self.digits)

    @property
    def code(self) -> str:
        """A G or M word without leading zeros: `G1` for `G01`."""
        whole, point, rest = self.digits.partition(".")
        return f"{self.letter}{int(whole)}{point}{rest}"


def split_words(line: int, text: str) -> list[Word]:
    """Words of a block without comments. Raises PlanningError at unreadable text."""
    words: list[Word] = []
    at = 0
    block = text.strip().upper()
    while at < len(block):
        word = _WORD.match(block, at)
        if word is None:
            raise line_error(line, f"cannot be read at {block[at : at + 12]!r}")
        words.append(Word(word.group(1), word.group(2)))
        at = word.end()
    return words


class GCodeReader:
    """Runs a program block by block.

    groups : modal groups; no code is active until the program sets it
    path_modes : codes of one more group, which no motion needs, the exact stop first
    frame : codes that make a position one of the machine, the default first; each
        motion needs one of them, unless there are none
    passive : codes that change no mode
    dwell_letter : of the seconds of a dwell
    end : the code that ends the program, where it may be in any block
    modal, keywords : letters and words of codes
    """

    groups: ClassVar[Groups]
    path_modes: ClassVar[Sequence[str]]
    frame: ClassVar[Sequence[str]] = ()
    passive: ClassVar[Sequence[str]]
    dwell_letter: ClassVar[str]
    end: ClassVar[str] = ""
    modal: ClassVar[str] = "GM"
    keywords: ClassVar[re.Pattern[str]] = re.compile(r"(?!)")

    def __init__(self, text: str, name: str, *, counts_degrees: bool = False) -> None:
        self.control = SimulatedControl(text, name, counts_degrees=counts_degrees)
        groups = {**self.groups, "the path mode": self.path_modes}
        self._group_of = {c: name for name, codes in groups.items() for c in codes}
        self._active: dict[str, str] = {}
        self.feed: float | None = None
        self.turns = 0  # of the next circle, before its rest
        self.ended = False

    def read_block(self, line: int, block: str) -> None:
        """Run a block without its comment; lines count from 1."""
        every = split_words(line, self.keywords.sub("", block))
        codes = {word.code for word in every if word.letter in self.modal}
        codes |= set(self.keywords.findall(block))
        words = {word.letter: word for word in every}
        self.apply_codes(line, codes)
        if "G4" in codes:
            self.control.dwell(line, self.take_dwell_s(line, words))
        if "F" in words:
            self.feed = words["F"].value
        ends = {n: self.read_end(word) for n, word in words.items() if n in AXES}
        if ends:
            circle = self._read_circle(line, codes, words)
            self.check_motion(line, codes, PLANES[circle.axes] if circle else "")
            self.check_ends(line, ends)
            exact_stop = self._active.get("the path mode") == self.path_modes[0]
            self.control.move(
                line, ends, self.feed, exact_stop=exact_stop, circle=circle
            )

    def _read_circle(
        self, line: int, codes: set[str], words: Mapping[str, Word]
    ) -> Circle | None:
        """Its centre is in I, J, K from the begin, whatever the dimension."""
        if codes.isdisjoint(ARCS):
            return None
        for axes in PLANES:
            names = [CENTRES[axis] for axis in axes]
            if {*names} == {*CENTRES.values()} & words.keys():
                first, second = (self.read_end(words[name]) for name in names)
                turns, self.turns = self.turns, 0
                return Circle(axes, (first, second), "G3" in codes, turns)
        raise line_error(line, "a circle needs two of I, J and K")

    def take_dwell_s(self, line: int, words: dict[str, Word]) -> float:
        """Removes the word of a dwell from its block; s, −1 without one."""
        word = words.pop(self.dwell_letter, None)
        return -1.0 if word is None else word.value

    def read_end(self, word: Word) -> float:
        """Position in an axis word, mm or deg."""
        return word.value

    def check_ends(self, line: int, ends: Mapping[str, float]) -> None:
        """Hook: reject motions that this control would execute differently."""

    def apply_codes(self, line: int, codes: set[str]) -> None:
        """Stop, end or change modes by the codes of a block."""
        for code in codes.difference(self.passive, self.frame):
            if code == self.end:
                self.ended = True
            elif code == "M0":
                self.control.halt()
            elif code in self._group_of:
                self._active[self._group_of[code]] = code
            else:
                raise line_error(line, f"{code} has no place in a measuring path")

    def check_motion(self, line: int, codes: set[str], plane: str = "") -> None:
        """Reject a motion of another kind, or in another frame or mode.

        plane : of a circle
        """
        if codes.isdisjoint({"G1", *ARCS}):
            raise line_error(line, "a motion without G1")
        if self.frame and codes.isdisjoint(self.frame):
            raise line_error(
                line, f"a position in a work offset; {self.frame[0]} is needed"
            )
        for name, allowed in self.groups.items():
            active = self._active.get(name, "not set")
            needed = plane if plane and name == "the plane" else allowed[0]
            if active != needed:
                raise line_error(
                    line, f"a motion while {name} is {active}; {needed} is needed"
                )

    def finish(self) -> ProgrammedMotion:
        """The whole motion. Raises PlanningError if the program has no end."""
        if not self.ended:
            raise line_error(0, f"it has no {self.end} at its end")
        return self.control.finish()


def find_name(text: str, comment: re.Pattern[str]) -> str:
    """Program name from a comment, empty without one."""
    stated = comment.search(text)
    return stated.group(1) if stated else ""


_FORMS = BlockForms(
    motion=f"{rs274.MOTION} ({{row.label}})",
    dwell=(rs274.DWELL,),
    message="(MSG, {})",
    number=f".{rs274.DECIMALS}f",
)
_KEEP_MODES, _RESTORE_MODES = "M70", "M72"


class LinuxCnc(Dialect):
    control = "LinuxCNC"
    suffix = ".ngc"
    frame = "WITHOUT ANY OFFSET IN EACH BLOCK - G53"

    def write(self, content: ProgramContent) -> str:
        """The program's name is that of its file and in a comment."""
        lines = [f"({line})" for line in (f"PROGRAM {content.name}", *content.header)]
        rows = _FORMS.write_rows(content)
        blocks = [_KEEP_MODES, *rs274.SAFE_START, *rows, _RESTORE_MODES, rs274.END]
        return "\n".join([*lines, *number_blocks(blocks), ""])

    def read(self, text: str) -> ProgrammedMotion:
        """Blocks after the end of the program are ignored."""
        reader = _Reader(text, find_name(text, _NAME))
        for number, line in enumerate(text.splitlines(), 1):
            if not reader.ended:
                reader.read_block(number, _COMMENT.sub(" ", line))
        return reader.finish()


_NAME = re.compile(r"^\(PROGRAM (\w+)\)$", re.MULTILINE)
_COMMENT = re.compile(r"\([^()]*\)")


class _Reader(GCodeReader):
    groups: ClassVar[Groups] = {
        **MILLING_GROUPS,
        "the tool length": ("G49", "G43", "G43.1"),
    }
    path_modes = ("G61.1", "G61", "G64")
    frame = ("G53",)
    passive = ("G1", "G4", _KEEP_MODES, _RESTORE_MODES)
    dwell_letter = "P"
    end = rs274.END
