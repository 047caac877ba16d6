"""When a stream counts as damaged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from truepath.measurement.monitors.stream_reader import StreamDamage
from truepath_drivers.interfaces.records import TrackerSamples

RATE_HZ = 500.0


def samples(number: np.ndarray) -> TrackerSamples:
    n = len(number)
    return TrackerSamples(
        number, number / RATE_HZ, np.zeros((n, 3)), np.zeros(n, np.int64)
    )


@pytest.fixture
def judge() -> Callable[..., bool]:
    """Tell whether a stream of these numbers was ever damaged, in blocks of ten."""

    def judge(number: np.ndarray, crc_errors: int = 0) -> bool:
        damage = StreamDamage(RATE_HZ, 0.01)
        found = False
        for i, block in enumerate(np.array_split(number, len(number) // 10)):
            damage.note(samples(block), 7 + (crc_errors * i) // 50)
            found = found or damage.is_over_limit
        return found

    return judge


@pytest.mark.parametrize(
    ("lost", "is_damaged"),
    [(0, False), (5, False), (8, True), (380, True)],
)
def test_more_than_a_hundredth_of_a_second_is_damage(judge, rng, lost, is_damaged):
    number = np.arange(2000)
    keep = np.ones(2000, bool)
    keep[1000 + rng.choice(400, lost, replace=False)] = False
    assert judge(number[keep]) == is_damaged


def test_one_gap_is_a_silence_and_no_damage(judge):
    number = np.arange(2000)
    assert not judge(number[(number < 800) | (number > 1100)])


@pytest.mark.parametrize(("crc_errors", "is_damaged"), [(3, False), (12, True)])
def test_frames_that_do_not_check_are_damage(judge, crc_errors, is_damaged):
    assert judge(np.arange(1000), crc_errors) == is_damaged


def test_damage_is_over_after_a_good_second():
    damage = StreamDamage(RATE_HZ, 0.01)
    damage.note(samples(np.arange(0, 1000, 20)), 0)
    assert damage.is_over_limit
    damage.note(samples(np.arange(1000, 1600)), 0)
    assert not damage.is_over_limit
