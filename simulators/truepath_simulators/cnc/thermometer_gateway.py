"""A Modbus gateway with the sensors of a machine: scales, spindle, air. No I/O.

Unit 1 has input registers, one per axis scale and one for the spindle, in 0.01 °C. Unit
2 has holding registers: air temperature and pressure as float32, the pressure with its
low word first, humidity in 0.1 %.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from truepath_simulators.cnc.modbus import (
    ILLEGAL_ADDRESS,
    ILLEGAL_FUNCTION,
    READ_HOLDING,
    exception,
)
from truepath_simulators.faults import Fault, Schedule
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.randomness import generator

UNITS = (1, 2)
READ_INPUT = 4
_FUNCTIONS = {READ_HOLDING: "holding", READ_INPUT: "input"}
_REQUEST = struct.Struct(">BHH")
_SIGMA = 0.02  # of the last digits of every sensor
_AIR_FIRST = 100


@dataclass(slots=True)
class Sensor:
    """A sensor and its registers.

    form : of its words in `struct`, high word first; shows : value at machine time
    """

    name: str
    unit: int
    function: int
    address: int
    kind: str
    form: str
    scale: float
    shows: Callable[[float], float]
    swapped: bool = False
    kept: dict[Fault, float] = field(default_factory=dict)

    @property
    def words(self) -> int:
        return struct.calcsize(self.form) // 2

    def encode(self, value: float) -> list[int]:
        """Words of a value; those of a broken wire for NaN."""
        if self.kind == "float32":
            data = struct.pack(self.form, value)
        elif math.isnan(value):
            data = struct.pack(self.form, (1 << 8 * struct.calcsize(self.form) - 1) - 1)
        else:
            data = struct.pack(self.form, round(value / self.scale))
        words = list(struct.unpack(f">{self.words}H", data))
        return words[::-1] if self.swapped else words

    def describe(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "unit": self.unit,
            "function": _FUNCTIONS[self.function],
            "address": self.address,
            "type": self.kind,
            "scale": self.scale,
            "word_order": "little" if self.swapped else "big",
        }


class ThermometerGateway:
    """Answers requests for the sensors of a machine, faults included."""

    def __init__(
        self,
        machine: MachineFile,
        hidden: Sequence[HiddenEffect],
        seed: int,
        faults: Schedule,
    ) -> None:
        self._hidden, self.faults = hidden, faults
        self._rng = generator(seed, "thermometers")
        names = [axis.name for axis in machine.linear_axes]
        scales = [
            Sensor(
                f"{name}_degC", 1, READ_INPUT, i, "int16", ">h", 0.01, self._of(name)
            )
            for i, name in enumerate([*names, "spindle"])
        ]
        at = _AIR_FIRST
        self.sensors = [
            *scales,
            Sensor("air_degC", 2, READ_HOLDING, at, "float32", ">f", 1.0, _air),
            Sensor(
                "pressure_hPa",
                2,
                READ_HOLDING,
                at + 2,
                "float32",
                ">f",
                1.0,
                _pressure,
                swapped=True,
            ),
            Sensor(
                "humidity_percent", 2, READ_HOLDING, at + 4, "uint16", ">H", 0.1, _damp
            ),
        ]

    def describe(self) -> list[dict[str, Any]]:
        """Register list that reads all sensors."""
        return [sensor.describe() for sensor in self.sensors]

    def answer(self, unit: int, pdu: bytes, now_s: float) -> bytes | None:
        """Answer to a request at machine time; None for silence."""
        if pdu[0] not in _FUNCTIONS or len(pdu) < _REQUEST.size:
            return exception(pdu, ILLEGAL_FUNCTION)
        if (refused := self.faults.strikes("exception", now_s)) is not None:
            return exception(pdu, int(refused.amount))
        function, address, count = _REQUEST.unpack_from(pdu)
        words: list[int] = []
        while len(words) < count:
            found = self._find(unit, function, address + len(words))
            if found is None:
                return exception(pdu, ILLEGAL_ADDRESS)
            number, sensor = found
            if self._strikes("silence", number, now_s):
                return None
            words += sensor.encode(self._show(number, sensor, now_s))
        return struct.pack(f">BB{count}H", function, 2 * count, *words[:count])

    def _find(self, unit: int, function: int, at: int) -> tuple[int, Sensor] | None:
        for number, sensor in enumerate(self.sensors, start=1):
            place = sensor.unit, sensor.function, sensor.address
            if place == (unit, function, at):
                return number, sensor
        return None

    def _show(self, number: int, sensor: Sensor, now_s: float) -> float:
        if self._strikes("broken-wire", number, now_s):
            return math.nan
        value = sensor.shows(now_s) + self._rng.normal(0.0, _SIGMA)
        stuck = self._strikes("stuck", number, now_s)
        return sensor.kept.setdefault(stuck, value) if stuck else value

    def _strikes(self, kind: str, number: int, now_s: float) -> Fault | None:
        for fault, _ in self.faults.struck(kind, np.array([now_s]), np.zeros(1)):
            if int(fault.amount) in (0, number):
                return fault
        return None

    def _of(self, axis: str) -> Callable[[float], float]:
        def show(now_s: float) -> float:
            at = np.array([now_s])
            return 20.0 + sum(float(e.warming_degc(axis, at)[0]) for e in self._hidden)

        return show


def _air(now_s: float) -> float:
    return 20.5 + 0.2 * math.sin(2.0 * math.pi * now_s / 900.0)


def _pressure(now_s: float) -> float:
    return 1002.0 + 0.1 * math.sin(2.0 * math.pi * now_s / 3600.0)


def _damp(now_s: float) -> float:
    return 45.0 + 2.0 * math.sin(2.0 * math.pi * now_s / 1800.0)
