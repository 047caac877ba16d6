"""The interface of a controller's format of compensation tables."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
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
