"""One checked subject."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Grade(StrEnum):
    """Result of a check. `WRONG` prevents measurements; `UNTOLD` is unknown."""

    OK = "ok"
    UNTOLD = "untold"
    WARNING = "warning"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Finding:
    """A checked subject, the result, and the remedy.

    subject : short, such as `disk`; text : what was found
    remedy : empty where nothing is to be done
    """

    subject: str
    grade: Grade
    text: str
    remedy: str = ""
