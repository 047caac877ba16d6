"""The interface of a controller's format, and the tables that controllers add."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from app.compensation.axis_tables import CompensationTables
from app.kinematics.machine import Machine

Correction = Callable[[Float64[np.ndarray, "n a"], float], Float64[np.ndarray, "n 3"]]
"""What the controller adds at commanded positions (mm) in direction 1 or −1."""


class CompensationFormat(ABC):
    """One format: a writer, and a simulator of the controller that reads it.

    control : its name for people
    suffix : of its files
    most_points : rows of a table that the controller takes
    carries, not_carried : in words, for the account
    sign : the rule that gives the file its sign
    sign_is_verified : whether that rule is from the maker's manual or source; else one
        deliberate value has to settle it at the machine before first use
    note : what to do with the files
    """

    control: ClassVar[str]
    suffix: ClassVar[str]
    most_points: ClassVar[int]
    carries: ClassVar[str]
    not_carried: ClassVar[str]
    sign: ClassVar[str]
    sign_is_verified: ClassVar[bool]
    note: ClassVar[str]

    @abstractmethod
    def write(self, content: CompensationTables) -> dict[str, str]:
        """Return the files by name, ASCII."""

    @abstractmethod
    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Return the controller's correction from the files. Raises BadInput."""


@dataclass(frozen=True, slots=True)
class InterpolatedTable:
    """What a controller adds at positions of an axis, straight between rows.

    out : index of the axis that is corrected
    forward_mm, backward_mm : (n,) added in + and in − direction of the axis; end values
        hold beyond
    """

    axis: str
    out: int
    position_mm: Float64[np.ndarray, " n"]
    forward_mm: Float64[np.ndarray, " n"]
    backward_mm: Float64[np.ndarray, " n"]


def add_tables(tables: Sequence[InterpolatedTable], machine: Machine) -> Correction:
    """Return the sum of tables as a correction."""

    def correction(
        position_mm: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        added = np.zeros((len(position_mm), 3))
        for table in tables:
            at = position_mm[:, machine.axis_names.index(table.axis)]
            value_mm = table.forward_mm if direction > 0 else table.backward_mm
            added[:, table.out] += np.interp(at, table.position_mm, value_mm)
        return added

    return correction
