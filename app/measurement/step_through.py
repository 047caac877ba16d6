"""Measures at standstill points: move, wait, settle, dwell."""

from __future__ import annotations

from app.measurement.session import Session
from app.planning.configurations import Configurations


def step_through(
    session: Session, points: Configurations, *, rate_hz: float, feed: float
) -> None:
    """Stand at every point in turn while the stream runs.

    Dwells are counted on the tracker's clock. A pause prolongs the standstill.
    """
    session.approach(points.position[0], feed)
    session.open_stream(rate_hz)
    for row, position in enumerate(points.position):
        session.begin_row(row)
        if row > 0:
            session.approach(position, feed)
        session.record_for(session.limits.settle_s + float(points.dwell_s[row]))
        session.point_done(row)
        if session.is_concluding and row + 1 < len(points):
            session.leave_out_rest()
            break
    session.finish()
