"""Words and modal groups of G-code (ISO 6983), for readers."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from app.motion.nc_programs.control import fault

_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*")

Groups = Mapping[str, Sequence[str]]
"""Modal groups by name; the first code of each is the one a motion needs."""


@dataclass(frozen=True, slots=True)
class Word:
    """A letter and its number as written: `X10.` is not `X10` everywhere."""

    letter: str
    digits: str

    @property
    def value(self) -> float:
        """The number."""
        return float(self.digits)

    @property
    def code(self) -> str:
        """A G or M word without leading zeros: `G1` for `G01`."""
        whole, point, rest = self.digits.partition(".")
        return f"{self.letter}{int(whole)}{point}{rest}"


def words_of(line: int, text: str) -> list[Word]:
    """Split a block without comments into its words."""
    found: list[Word] = []
    at = 0
    block = text.strip().upper()
    while at < len(block):
        word = _WORD.match(block, at)
        if word is None:
            raise fault(line, f"cannot be read at {block[at : at + 12]!r}")
        found.append(Word(word.group(1), word.group(2)))
        at = word.end()
    return found


class Modes:
    """Which code of each modal group is in force; none is until it is stated.

    path_mode : codes of one more group, which no motion needs, the exact stop first
    """

    def __init__(self, groups: Groups, path_mode: Sequence[str]) -> None:
        self._groups = groups
        self._exact_stop = path_mode[0]
        self._group_of = {
            code: name
            for name, codes in {**groups, "the path mode": path_mode}.items()
            for code in codes
        }
        self._active: dict[str, str] = {}

    def take(self, line: int, code: str) -> None:
        """Put a code in force. Raises PlanningError where it belongs to no group."""
        if code not in self._group_of:
            raise fault(line, f"{code} has no place in a measuring path")
        self._active[self._group_of[code]] = code

    @property
    def exact_stop(self) -> bool:
        """Whether the axes come to a stand at the end of each motion."""
        return self._active.get("the path mode") == self._exact_stop

    def require(self, line: int) -> None:
        """Raise PlanningError unless every group is as a motion needs it."""
        for name, codes in self._groups.items():
            found = self._active.get(name, "not set")
            if found != codes[0]:
                raise fault(
                    line, f"a motion while {name} is {found}; {codes[0]} is needed"
                )
