"""Measures while the machine drives a path. The controller keeps time, not we."""

from __future__ import annotations

from app.measurement.parts import More
from app.measurement.session import Session
from drivers.interfaces.records import Path


def stream_path(
    session: Session, path: Path, more: More, *, rate_hz: float, feed: float
) -> None:
    """Stand at the first row, load the path, stream from before it to after it.

    The stream begins and ends at a standstill: segmentation counts on both. It goes on
    while further parts are loaded and driven.
    """
    session.approach(path.position[0], feed)
    session.motion.load(path)
    session.open_stream(rate_hz)
    session.run_path(path)
    while isinstance(part := more(), Path):
        session.motion.load(part)
        session.run_path(part)
    session.finish()
