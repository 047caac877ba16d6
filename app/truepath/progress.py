"""Callbacks for the progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Receives the fraction done, 0 to 1, and the stage of the work."""
ShareProgress = Callable[[float], None]
"""Receives the fraction done, 0 to 1."""


def ignore_progress(share: float, stage: str = "") -> None:
    """No action: the default without a listener."""


def scale_progress(
    on_progress: Progress, begin: float, end: float, stage: str
) -> ShareProgress:
    """Callback of a stage that advances the work from `begin` to `end`."""
    return lambda share: on_progress(begin + share * (end - begin), stage)
