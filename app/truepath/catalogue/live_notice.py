"""Notices of the live estimate, as a job stores them, and the reaction to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pydantic import TypeAdapter


class OnNotice(StrEnum):
    """What is done where the live estimate notices a change, besides telling it."""

    NOTE = "note"  # nothing
    PAUSE = "pause"  # hold the feed; a person decides
    CHECK = "check"  # measure again from the line before the change on
    REPLAN = "replan"  # measure again what was measured since the change


@dataclass(frozen=True, slots=True)
class LiveNotice:
    """A change during the measurement, noticed by the live estimate.

    number : 1, 2, … of the job; kind : of the change, `something-changed` without a
        name; axis : of which, if of one; grade : `certain`, `likely` or `possible`
    since_row : first line or point that it shows on; noticed_row : the newest one when
        it was noticed; noticed_s : then, since the stream began
    size_um, uncertainty_um : displacement of the measured points (k = 1)
    is_over : the newest lines no longer show it
    action : the reaction
    """

    number: int
    kind: str
    grade: str
    since_row: int
    noticed_row: int
    noticed_s: float
    size_um: float
    uncertainty_um: float
    axis: str = ""
    is_over: bool = False
    action: OnNotice = OnNotice.NOTE

    @property
    def heading(self) -> tuple[str, str, str, bool]:
        """Kind, axis, grade and end: a change of these is published again."""
        return self.kind, self.axis, self.grade, self.is_over


_NOTICE = TypeAdapter(LiveNotice)


def decode_notice(content: Mapping[str, Any]) -> LiveNotice:
    """From the JSON of the live estimate. Raises ValidationError."""
    return _NOTICE.validate_python(content)
