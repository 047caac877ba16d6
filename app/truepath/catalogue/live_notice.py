"""What the live estimate notices, as a job keeps it, and what is done about it."""

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
    """What the live estimate has noticed to change during the measurement.

    number : 1, 2, … of the job; kind : of the change, `something-changed` without a
        name; axis : of which, if of one; grade : `certain`, `likely` or `possible`
    since_row : first line or point that it shows on; noticed_row : the newest one when
        it was noticed; noticed_s : then, since the stream began
    size_um, uncertainty_um : what it moves the measured points by (k = 1)
    is_over : the newest lines show nothing of it any more
    action : what was done about it
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
        """What it is called: a change of it is told anew."""
        return self.kind, self.axis, self.grade, self.is_over


_NOTICE = TypeAdapter(LiveNotice)


def decode_notice(content: Mapping[str, Any]) -> LiveNotice:
    """Return the notice that the live estimate tells."""
    return _NOTICE.validate_python(content)
