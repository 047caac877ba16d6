"""Callbacks by which long work reports how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Receives the share that is done, 0 to 1, and the stage of the work."""
ShareProgress = Callable[[float], None]
"""Receives the share that is done, 0 to 1."""


def ignore_progress(share: float, stage: str = "") -> None:
    """Do nothing: the default where nobody asks for progress."""


def scale_progress(
    on_progress: Progress, begin: float, end: float, stage: str
) -> ShareProgress:
    """Return the callback of a stage that takes the work from `begin` to `end`."""
    return lambda share: on_progress(begin + share * (end - begin), stage)
