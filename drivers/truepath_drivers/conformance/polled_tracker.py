"""Requirements on every point-by-point tracker. A target is in its beam."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.conformance.checking import DEVICE_CHECKS, expect, require, soon
from truepath_drivers.interfaces.errors import ConnectionLost, Refused
from truepath_drivers.interfaces.tracker import PolledTracker
from truepath_drivers.interfaces.tracker_records import PointMeasurement

DWELL_S = 0.3
LATE_S = 10.0  # what an instrument may take for its last shot
NEAREST_MM, FARTHEST_MM = 100.0, 200e3  # metres or inches for mm show
SAME_MM = 1.0  # a target at rest, twice

MakePolled = Callable[[], PolledTracker]


def it_says_that_it_is_polled(make: MakePolled) -> None:
    """The capabilities exclude streaming."""
    with make() as tracker:
        require(not tracker.capabilities.streams, "a polled tracker says it streams")


def a_point_is_whole(make: MakePolled) -> None:
    """A point is finite, in mm, with a valid covariance."""
    with make() as tracker:
        point = tracker.measure(DWELL_S)
    place, covariance = point.position_mm, point.covariance_mm2
    require(place.shape == (3,), f"the position is {place.shape}, not (3,)")
    require(bool(np.isfinite(place).all()), "the position is not finite")
    distance = float(np.linalg.norm(place))
    near = NEAREST_MM <= distance <= FARTHEST_MM
    require(near, f"the target is {distance:g} mm away: is that mm?")
    require(covariance.shape == (3, 3), "the covariance is not (3, 3)")
    least = float(np.linalg.eigvalsh(covariance).min())
    scale = float(np.abs(covariance).max())
    require(np.allclose(covariance, covariance.T), "the covariance is not symmetric")
    require(least >= -1e-9 * scale, "the covariance has a negative variance")
    require(point.count >= 1, "a point of no shots")


def a_dwell_lasts(make: MakePolled) -> None:
    """`measure` takes the dwell, and one shot more at the most."""
    with make() as tracker, soon(f"measure({DWELL_S})", DWELL_S + LATE_S):
        begin_s = host_clock.now_s()
        point = tracker.measure(DWELL_S)
        took_s = host_clock.now_s() - begin_s
    enough = took_s >= 0.5 * DWELL_S or point.count == 1
    require(enough, f"a dwell of {DWELL_S} s took {took_s:.2f} s")


def points_rise_in_time_and_agree(make: MakePolled) -> None:
    """Points of a target at rest agree, each with a later time."""
    with make() as tracker:
        points = [tracker.measure(DWELL_S) for _ in range(2)]
    _require_agreement(points)
    require(points[1].time_s > points[0].time_s, "times do not rise")


def stop_is_idempotent_in_any_state(make: MakePolled) -> None:
    """`stop` may come before `connect`, twice, and a measurement follows it."""
    tracker = make()
    tracker.stop()
    with tracker:
        tracker.stop()
        tracker.stop()
        require(tracker.measure(DWELL_S).count >= 1, "nothing after a stop")
    tracker.stop()


def stop_from_another_thread_ends_a_measurement(make: MakePolled) -> None:
    """`stop` ends a long dwell at once; the next point is valid."""
    with make() as tracker:
        before = tracker.measure(DWELL_S)
        timer = threading.Timer(0.3, tracker.stop)
        timer.start()
        with soon("stop", LATE_S):
            expect(Refused, lambda: tracker.measure(60.0), "measure(60)")
        timer.join()
        _require_agreement([before, tracker.measure(DWELL_S)])


def impossible_dwells_are_refused(make: MakePolled) -> None:
    """A dwell below zero, or that is no number, is Refused."""
    with make() as tracker:
        for dwell_s in (-1.0, float("nan"), float("inf")):
            measure = f"measure({dwell_s:g})"
            expect(Refused, lambda dwell_s=dwell_s: tracker.measure(dwell_s), measure)


def a_closed_tracker_measures_nothing(make: MakePolled) -> None:
    """`measure` is ConnectionLost before `connect` and after `close`."""
    tracker = make()
    for _ in range(2):
        expect(ConnectionLost, lambda: tracker.measure(DWELL_S), "measure")
        tracker.connect()
        tracker.close()


POLLED_CHECKS: tuple[Callable[[MakePolled], None], ...] = (
    *DEVICE_CHECKS,
    it_says_that_it_is_polled,
    a_point_is_whole,
    a_dwell_lasts,
    points_rise_in_time_and_agree,
    stop_is_idempotent_in_any_state,
    stop_from_another_thread_ends_a_measurement,
    impossible_dwells_are_refused,
    a_closed_tracker_measures_nothing,
)


def _require_agreement(points: list[PointMeasurement]) -> None:
    apart = float(np.linalg.norm(points[1].position_mm - points[0].position_mm))
    require(apart <= SAME_MM, f"a target at rest moved by {apart:.3f} mm")
