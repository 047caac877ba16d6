"""Hears the tracker while nothing is measured."""

from __future__ import annotations

import structlog

from truepath.app.errors import MeasurementFailed
from truepath.app.jobs.errors import CellDown
from truepath.app.jobs.stream_watch import StreamWatch
from truepath.app.measurement.cell import Cell
from truepath.app.measurement.messages import TrackerTrial
from truepath.drivers.interfaces.errors import DeviceError, NotHomed

log = structlog.get_logger(__name__)

HEAR_S, HEAR_SAMPLES = 0.2, 20  # of a tracker at rest, the longer of both


def hear_at_rest(
    cell: Cell, stream: StreamWatch, rate_hz: float, *, aims: bool
) -> None:
    """Have a cell hear its tracker for a moment, and `stream` tell of it.

    aims : the measurement points the beam itself. Raises CellDown.
    """
    try:
        duration_s = max(HEAR_S, HEAR_SAMPLES / rate_hz)
        trial = TrackerTrial(rate_hz, duration_s, streams_only=True)
        stream.hear(cell.try_tracker(trial), rate_hz, aims=aims)
    except NotHomed:
        log.debug("the tracker is heard once the measurement has homed it")
    except DeviceError as error:
        stream.hear_failure(str(error))
    except MeasurementFailed as error:
        raise CellDown(str(error)) from error
