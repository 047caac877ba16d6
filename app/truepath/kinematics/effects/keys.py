"""Keys distinguish an effect within its family, and name it in files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    LINEAR,
    SQUARENESS,
    describe_symbol,
    list_error_motions,
)


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a family.

    phrase : for a title, such as `of {}`; empty where the title leaves it out
    read : field of an effect from the text of a file. Raises KeyError if the machine
        has no such thing
    explain : the text in words
    """

    phrase: str
    read: Callable[[Machine, str], Any]
    explain: Callable[[str], str] = str

    def describe(self, text: str) -> str:
        """The key as it appears in a title."""
        return self.phrase.format(self.explain(text))


def choose_from(phrase: str, values: Sequence[str]) -> Key:
    """Key with a fixed set of texts; reading another raises KeyError."""

    def read(machine: Machine, text: str) -> str:
        if text not in values:
            raise KeyError(text)
        return text

    return Key(phrase, read)


def _with_meaning(symbol: str) -> str:
    return f"{symbol}, {describe_symbol(symbol)}"


def _read_motion(machine: Machine, text: str) -> str:
    if text not in {s for a in machine.linear_axes for s in list_error_motions(a.name)}:
        raise KeyError(text)
    return text


AXIS = Key("of {}", Machine.linear)
ROTARY_AXIS = Key("of {}", Machine.rotary)
ANY_AXIS = Key("of {}", Machine.axis)
DIRECTION = choose_from("along {}", LINEAR)
MOTION = Key("in {}", _read_motion, _with_meaning)
SYMBOL = replace(choose_from("{}", SQUARENESS), explain=_with_meaning)
PLANE = Key("({})", lambda m, text: tuple(map(m.linear, text)), " and ".join)
