"""Further parts of an adaptive measurement: from the live estimate to the cell.

The cell asks when the machine stands at the end of what it has been given. Where the
live estimate has nothing to add, or says nothing in time, the measurement ends in
order with what has been recorded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import structlog

from app.measurement.parts import append_part
from app.motion.configurations import Commanded
from drivers.interfaces.records import Path

if TYPE_CHECKING:
    from app.planning.adaptive_plan import Part

log = structlog.get_logger(__name__)

ANSWER_S = 60.0
_MICRO = 1e3  # mm to µm

Told = Callable[[Commanded, Mapping[str, Any]], None]
"""Told all rows after each part, and the part in the words of the event `plan`."""


class Source(Protocol):
    """What `LiveEstimation` offers."""

    @property
    def is_over(self) -> bool: ...  # noqa: D102 (the class says it)
    def ask(self) -> None: ...  # noqa: D102
    def part(self) -> Part | None: ...  # noqa: D102


class Growth:
    """One measurement that grows. One thread.

    commanded : the first part
    extend, conclude : of the cell
    """

    def __init__(
        self,
        source: Source,
        commanded: Commanded,
        extend: Callable[[Commanded], object],
        conclude: Callable[[], object],
        told: Told,
    ) -> None:
        self._source, self._commanded = source, commanded
        self._extend, self._conclude, self._told = extend, conclude, told
        self._answer_by: float | None = None
        self._parts = 1

    def ask(self) -> None:
        """The machine stands: let the next part be chosen."""
        self._answer_by = time.monotonic() + ANSWER_S
        self._source.ask()

    def look(self) -> None:
        """Pass on the part that was asked for, if it is there. Never waits."""
        if self._answer_by is None:
            return
        part = self._source.part()
        if part is not None:
            self._answer_by = None
            self._go_on(part)
        elif self._source.is_over or time.monotonic() > self._answer_by:
            self._answer_by = None
            log.warning("nobody says what to measure next; the measurement ends")
            self._conclude()

    def _go_on(self, part: Part) -> None:
        if part.commanded is None:
            log.info("no further part", parts=self._parts)
            self._conclude()
            return
        self._commanded = append_part(self._commanded, part.commanded)
        self._parts += 1
        total = len(self._commanded) - isinstance(self._commanded, Path)
        body = {
            "part": self._parts,
            "rows": part.rows,
            "total": total,
            "duration_s": round(part.duration_s, 3),
            "predicted_um": round(_MICRO * part.predicted_sigma_mm, 4),
        }
        log.info("further part", **body)
        self._extend(part.commanded)
        self._told(self._commanded, body)
