"""A recording is known again by any part of it, and taken for no other."""

import numpy as np
import pytest

from truepath.files.bundle.run import share_samples, sketch_samples
from truepath_drivers.interfaces.records import TrackerSamples

N = 60_000


def stream(position_mm, status=None):
    n = len(position_mm)
    status = np.zeros(n, int) if status is None else status
    return TrackerSamples(np.arange(n), np.arange(n) / 500.0, position_mm, status)


def place(rng, noise_mm, step_mm=0.0):
    """Stand at twenty places, the same in every recording; read by steps."""
    stands = np.repeat(np.random.default_rng(7).uniform(-900, 900, (20, 3)), N // 20, 0)
    seen = stands + rng.normal(size=(N, 3)) * noise_mm
    return np.round(seen / step_mm) * step_mm if step_mm else seen


@pytest.fixture
def recorded(rng):
    return place(rng, 0.002)


@pytest.mark.parametrize("part", [slice(200, N), slice(N // 2), slice(20_000, 22_400)])
def test_a_part_is_known_whatever_its_clock_and_its_losses_say(recorded, rng, part):
    whole = sketch_samples(stream(recorded))
    cut = recorded[part]
    lost = rng.uniform(size=len(cut)) < 0.01
    cut = np.where(lost[:, None], np.nan, cut)
    assert share_samples(whole, sketch_samples(stream(cut, lost.astype(int))))


def test_recordings_that_overlap_are_known_from_either(recorded):
    parts = recorded[:40_000], recorded[10_000:50_000]
    one, other = (sketch_samples(stream(part)) for part in parts)
    assert share_samples(one, other)
    assert share_samples(other, one)


def test_a_beginning_that_a_simulated_tracker_repeats_is_no_sign(recorded, rng):
    again = place(rng, 0.002)
    again[: N // 10] = recorded[: N // 10]
    one, other = (sketch_samples(stream(each)) for each in (recorded, again))
    assert not share_samples(one, other)


@pytest.mark.parametrize("step_mm", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("noise_mm", [0.0005, 0.01])
def test_another_recording_of_the_same_places_has_nothing_of_it(rng, noise_mm, step_mm):
    seen = (place(rng, noise_mm, step_mm) for _ in range(2))
    one, other = (sketch_samples(stream(each)) for each in seen)
    assert not share_samples(one, other)


def test_one_value_all_the_time_and_few_samples_are_no_sign_of_anything(recorded):
    still = stream(np.full((N, 3), 1.5))
    assert not share_samples(sketch_samples(still), sketch_samples(still))
    for short in (still, stream(recorded[:11]), TrackerSamples.empty()):
        assert sketch_samples(short) == ""


def test_a_zero_has_no_sign(rng):
    position_mm = rng.normal(size=(50, 3)).round()
    negative_mm = np.where(position_mm == 0.0, -0.0, position_mm)
    one, other = (sketch_samples(stream(p)) for p in (position_mm, negative_mm))
    assert one == other
