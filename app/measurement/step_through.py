"""Measures at standstill points: move, wait, settle, dwell."""

from __future__ import annotations

from app.measurement.parts import More
from app.measurement.session import Session
from app.motion.configurations import Commanded, Configurations


def step_through(
    session: Session, points: Configurations, more: More, *, rate_hz: float, feed: float
) -> None:
    """Stand at every point in turn while the stream runs, then at those of more parts.

    Dwells are counted on the tracker's clock. A pause prolongs the standstill.
    """
    session.approach(points.position[0], feed)
    session.open_stream(rate_hz)
    part: Commanded | None = points
    while isinstance(part, Configurations):
        if not _stand_at_each(session, part, feed, is_there=part is points):
            break
        part = more()
    session.finish()


def _stand_at_each(
    session: Session, points: Configurations, feed: float, *, is_there: bool
) -> bool:
    """Stand at every point; tell whether none was left out.

    is_there : the machine stands at the first one already
    """
    for row, position in enumerate(points.position):
        session.begin_row(row)
        if row > 0 or not is_there:
            session.approach(position, feed)
        session.record_for(session.limits.settle_s + float(points.dwell_s[row]))
        session.point_done(row)
        if session.is_concluding and row + 1 < len(points):
            session.leave_out_rest()
            return False
    return True
