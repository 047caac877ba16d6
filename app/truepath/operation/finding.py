"""One thing that was looked at."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Grade(StrEnum):
    """How it is. `WRONG` keeps the service from measuring; `UNTOLD` cannot be seen."""

    OK = "ok"
    UNTOLD = "untold"
    WARNING = "warning"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Finding:
    """What was looked at, how it is, and what to do about it.

    subject : short, such as `disk`; text : what was found
    remedy : empty where nothing is to be done
    """

    subject: str
    grade: Grade
    text: str
    remedy: str = ""
