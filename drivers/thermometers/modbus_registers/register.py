"""One sensor's registers: where they are, and what their words mean."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from truepath.drivers.interfaces.thermometers import STUCK_S, Channel

Kind = Literal["int16", "uint16", "int32", "uint32", "float32"]
Function = Literal["holding", "input"]
WordOrder = Literal["big", "little"]
_FORMS = {"int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float32": ">f"}
_HIGHEST = 0xFFFF
_LONGEST_PERIOD_S = 3600.0


@dataclass(frozen=True, slots=True)
class Register:
    """A row of the register list.

    name : as in `Channel`; unit : Modbus unit (device id)
    address : of the first word, counted from 0: 30001 and 40001 of a manual are 0
    word_order : of two words, `big` where the high word comes first
    scale, offset : the reading is offset + scale · the register
    period_s : between two readings
    low, high, stuck_s : as in `Channel`
    """

    name: str
    address: int
    unit: int = 1
    function: Function = "input"
    type: Kind = "int16"
    word_order: WordOrder = "big"
    scale: float = 1.0
    offset: float = 0.0
    period_s: float = 1.0
    low: float = math.nan
    high: float = math.nan
    stuck_s: float = STUCK_S

    def __post_init__(self) -> None:
        for key, known in (
            ("function", get_args(Function)),
            ("type", get_args(Kind)),
            ("word_order", get_args(WordOrder)),
        ):
            self._require(key, getattr(self, key) in known, " or ".join(known))
        last = _HIGHEST + 1 - self.count
        self._require("address", self.address in range(last + 1), f"0 to {last}")
        self._require("unit", self.unit in range(256), "0 to 255")
        is_scale = math.isfinite(self.scale) and self.scale != 0.0
        self._require("scale", is_scale, "a number that is not 0")
        self._require("offset", math.isfinite(self.offset), "a number")
        is_period = 0.0 < self.period_s <= _LONGEST_PERIOD_S
        self._require("period_s", is_period, f"above 0, to {_LONGEST_PERIOD_S:g}")
        self.channel  # noqa: B018, refuses name and limits

    @property
    def channel(self) -> Channel:
        """What the service is told of it."""
        return Channel(self.name, self.low, self.high, self.stuck_s)

    @property
    def count(self) -> int:
        """Words."""
        return struct.calcsize(_FORMS[self.type]) // 2

    def decode(self, words: Sequence[int]) -> float:
        """Return the reading that words hold; NaN where they hold no number."""
        ordered = words if self.word_order == "big" else list(reversed(words))
        data = struct.pack(f">{len(ordered)}H", *ordered)
        value = struct.unpack(_FORMS[self.type], data)[0]
        if not math.isfinite(value):
            return math.nan
        # Rounded, so that 0 °C of an integer in kelvin is 0, not its rounding error.
        shown = self.offset + self.scale * value
        return shown if self.type == "float32" else round(shown, 9)

    def list_ways(self) -> list[Register]:
        """Return the ways to read it: this, the other order, an address beside."""
        other: WordOrder = "big" if self.word_order == "little" else "little"
        return [
            replace(self, address=address, word_order=order)
            for address in (self.address, self.address - 1, self.address + 1)
            if 0 <= address <= _HIGHEST + 1 - self.count
            for order in (self.word_order, other)[: self.count]
        ]

    def _require(self, key: str, kept: bool, otherwise: str) -> None:
        if not kept:
            raise ValueError(
                f"register {self.name!r}: {key} is {getattr(self, key)!r}, "
                f"expected {otherwise}"
            )
