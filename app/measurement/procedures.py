"""The two ways to measure: drive a path under a running stream, or stand at points."""

from __future__ import annotations

from app.measurement.measurement_steps import MeasurementSteps
from app.measurement.parts import RequestPart
from app.motion.configurations import Commanded, Configurations
from drivers.interfaces.records import Path


def stream_path(
    steps: MeasurementSteps,
    path: Path,
    request_part: RequestPart,
    *,
    rate_hz: float,
    feed: float,
) -> None:
    """Stand at the first row, load the path, stream from before it to after it.

    The controller keeps time. The stream begins and ends at a standstill: segmentation
    counts on both. It goes on while further parts are loaded and driven.
    """
    steps.approach(path.position[0], feed)
    steps.motion.load(path)
    steps.open_stream(rate_hz)
    steps.run_path(path)
    while isinstance(part := request_part(), Path):
        steps.motion.load(part)
        steps.run_path(part)
    steps.finish()


def step_through(
    steps: MeasurementSteps,
    points: Configurations,
    request_part: RequestPart,
    *,
    rate_hz: float,
    feed: float,
) -> None:
    """Stand at every point in turn while the stream runs, then at those of more parts.

    Dwells are counted on the tracker's clock. A pause prolongs the standstill.
    """
    steps.approach(points.position[0], feed)
    steps.open_stream(rate_hz)
    part: Commanded | None = points
    while isinstance(part, Configurations):
        if not _stand_at_each(steps, part, feed, is_there=part is points):
            break
        part = request_part()
    steps.finish()


def _stand_at_each(
    steps: MeasurementSteps, points: Configurations, feed: float, *, is_there: bool
) -> bool:
    """Stand at every point; tell whether none was left out.

    is_there : the machine stands at the first one already
    """
    for row, position in enumerate(points.position):
        steps.begin_row(row)
        if row > 0 or not is_there:
            steps.approach(position, feed)
        steps.record_for(steps.settings.settle_s + float(points.dwell_s[row]))
        steps.record_point(row)
        if steps.is_concluding and row + 1 < len(points):
            steps.leave_out_rest()
            return False
    return True
