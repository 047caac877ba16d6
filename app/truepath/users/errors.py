"""Reasons to refuse a request."""

from __future__ import annotations

from truepath.errors import JobError, TruepathError


class NotLoggedIn(TruepathError):
    """No session and no API key that is valid came with the request."""


class WrongPassword(NotLoggedIn):
    """Name and password do not belong together; which of them is wrong stays unsaid."""


class RoleTooLow(TruepathError):
    """The role of the user does not allow it."""


class PersonNeeded(RoleTooLow):
    """Only the session of a person may set the machine in motion."""


class TooManyTries(TruepathError):
    """Too many log-ins failed; `retry_after_s` is the time to wait."""

    def __init__(self, text: str, retry_after_s: float) -> None:
        super().__init__(text)
        self.retry_after_s = retry_after_s


class TooManyRequests(TooManyTries):
    """One user changes more in a short time than a person or a program needs to."""


class UserConflict(JobError):
    """The name is taken, or the last administrator would be lost."""
