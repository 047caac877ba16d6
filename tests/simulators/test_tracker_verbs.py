"""A tracker that aims, seeks and chooses its target, over a pseudo-terminal."""

from __future__ import annotations

import time

import numpy as np
import pytest

from truepath_drivers.interfaces.errors import BeamLost, NotHomed, Refused
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker_records import Air
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench

APART_MM = 150.0


@pytest.fixture(scope="module")
def tracker(two_target_content):
    with (
        Bench(two_target_content, seed=3) as bench,
        StreamingTracker(**bench.tracker_options) as connected,
    ):
        connected.start(500.0)
        yield connected


def read_valid(tracker: StreamingTracker) -> np.ndarray:
    """Return where the target is, by samples that were taken after the call."""
    tracker.read(0.0)
    time.sleep(0.1)
    tracker.read(0.0)
    time.sleep(0.1)
    samples: TrackerSamples = tracker.read(1.0)
    return samples.position_mm[samples.status == 0]


def to_direction(place_mm: np.ndarray) -> tuple[float, float]:
    x, y, z = place_mm
    return float(np.arctan2(y, x)), float(np.arctan2(z, np.hypot(x, y)))


def test_it_measures_the_target_that_was_selected(tracker) -> None:
    tracker.select_target("T1")
    first = read_valid(tracker).mean(axis=0)
    tracker.select_target("T2")
    second = read_valid(tracker).mean(axis=0)
    assert np.linalg.norm(second - first) == pytest.approx(APART_MM, abs=1.0)


def test_a_target_that_is_not_there_is_refused_and_nothing_changes(tracker) -> None:
    tracker.select_target("T1")
    before = read_valid(tracker).mean(axis=0)
    with pytest.raises(Refused, match="knows T1, T2"):
        tracker.select_target("T9")
    after = read_valid(tracker).mean(axis=0)
    assert np.linalg.norm(after - before) < 0.1


def test_it_finds_the_target_near_the_beam_and_none_elsewhere(tracker) -> None:
    tracker.select_target("T2")
    place = read_valid(tracker).mean(axis=0)
    azimuth, elevation = to_direction(place)
    tracker.aim(azimuth + 0.002, elevation)
    assert not len(read_valid(tracker))
    tracker.search()
    np.testing.assert_allclose(read_valid(tracker).mean(axis=0), place, atol=0.1)
    tracker.aim(azimuth + np.pi, elevation)
    with pytest.raises(BeamLost, match="no target near the beam"):
        tracker.search()
    tracker.select_target("T1")


def test_the_air_that_is_pushed_is_the_air_in_use(tracker) -> None:
    tracker.push_air(Air(21.5, 990.0, 40.0))
    assert tracker.read_air() == Air(21.5, 990.0, 40.0)


def test_one_that_is_not_initialised_measures_once_it_is_homed(
    two_target_content,
) -> None:
    faults = ["tracker:unhomed"]
    with (
        Bench(two_target_content, seed=3, faults=faults) as bench,
        StreamingTracker(**bench.tracker_options) as tracker,
    ):
        with pytest.raises(NotHomed, match="not initialised"):
            tracker.start(500.0)
        with pytest.raises(NotHomed, match="not initialised"):
            tracker.select_target("T1")
        tracker.home()
        tracker.select_target("T1")
        tracker.start(500.0)
        assert len(read_valid(tracker))
