"""The estimate while the machine moves: it tightens, and ends where the batch does."""

import time

import numpy as np
import pytest

from app.alignment.align import align
from app.estimation.live import LiveEstimator
from app.kinematics.volumetric_map import compute_volumetric_gram
from app.results.error_tables import build_error_tables
from drivers.interfaces.records import TrackerSamples
from tests.estimation.estimating import estimate


def blocks_of(run, size=50):
    tracker = run.tracker
    for begin in range(0, len(tracker), size):
        rows = slice(begin, begin + size)
        yield TrackerSamples(
            tracker.sequence[rows],
            tracker.device_time_s[rows],
            tracker.position_mm[rows],
            tracker.status[rows],
        )


def followed(run):
    """Return the estimates on the way and the last, with the time each took."""
    live, on_the_way = LiveEstimator(run.machine, run.commanded), []
    for block in blocks_of(run):
        begun = time.process_time()
        if live.take(block):
            on_the_way.append((live.estimate(), time.process_time() - begun))
    live.finish()
    return on_the_way, live.estimate()


@pytest.fixture(scope="module")
def moving(record):
    run, _ = record(31, rows=32)
    return run, *followed(run)


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_the_last_live_tables_are_those_of_the_batch(record, mode):
    run, _ = record(31, mode, rows=32 if mode == "otf" else 60)
    _, last = followed(run)
    batch = estimate(align(run))
    live = build_error_tables(last)
    off = [
        (live.table(table.symbol).value - table.value)
        / np.maximum(table.uncertainty, 0.05)
        for table in build_error_tables(batch).tables
    ]
    assert np.abs(np.concatenate(off)).max() < 1.0
    assert np.sqrt(np.mean(np.concatenate(off) ** 2)) < 0.3


def test_the_volumetric_uncertainty_falls_line_by_line(moving):
    _, on_the_way, last = moving
    sigma = [now.volumetric_sigma_mm for now, _ in on_the_way]
    assert sigma[0] > 5 * sigma[-1]
    assert last.volumetric_sigma_mm < 0.003
    # It may rise a little where noise or precisions were found larger than guessed.
    assert np.mean(np.diff(sigma) < 1e-6) > 0.7


def test_the_volumetric_uncertainty_is_that_of_the_map(moving):
    _, _, last = moving
    expected = np.sqrt(np.sum(compute_volumetric_gram(last.model) * last.covariance))
    assert last.volumetric_sigma_mm == pytest.approx(expected)


def test_lines_are_counted_as_they_are_finished(moving):
    run, on_the_way, last = moving
    done = [now.done for now, _ in on_the_way]
    assert done == sorted(done)
    assert last.done == len(run.commanded) - 1


def test_nothing_is_said_before_the_pose_is_known(record):
    run, _ = record(31, rows=32)
    live = LiveEstimator(run.machine, run.commanded)
    assert live.estimate() is None
    assert not live.finish()
