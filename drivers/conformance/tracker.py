"""What every tracker keeps: streams, silence, numbers, rates."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from drivers.conformance.checking import PATIENCE_S, expect, require, running, soon
from drivers.conformance.device import DEVICE_CHECKS
from drivers.interfaces.errors import (
    ConnectionLost,
    Refused,
)
from drivers.interfaces.records import TrackerSamples
from drivers.interfaces.tracker import Tracker

RATE_HZ = 500.0

MakeTracker = Callable[[], Tracker]


def stop_is_idempotent_in_any_state(make: MakeTracker) -> None:
    """`stop` before `connect`, twice, without a stream, in a stream, after `close`."""
    tracker = make()
    tracker.stop()
    with tracker:
        tracker.stop()
        tracker.start(RATE_HZ)
        tracker.stop()
        tracker.stop()
    tracker.stop()


def stop_from_another_thread_ends_the_stream(make: MakeTracker) -> None:
    """`stop` needs no agreement with the thread that reads."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        _read(tracker, 10)
        with running(tracker.stop):
            tracker.read(0.2)
        tracker.read(0.2)
        require(len(tracker.read(0.2)) == 0, "samples come after stop")


def silence_is_an_empty_block_in_time(make: MakeTracker) -> None:
    """`read` without a stream returns an empty block within its timeout."""
    with make() as tracker:
        for timeout_s in (0.0, 0.05, 0.3):
            with soon(f"read({timeout_s})", timeout_s):
                block = tracker.read(timeout_s)
            require(len(block) == 0, "samples came without a start")
            _require_shapes(block)


def samples_have_rising_numbers_and_times(make: MakeTracker) -> None:
    """A stream has whole blocks, rising numbers and times, losses that are counted."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        samples = _read(tracker, 100)
        health = tracker.health
    _require_shapes(samples)
    require(bool((np.diff(samples.sequence) > 0).all()), "numbers do not rise")
    require(bool((np.diff(samples.device_time_s) > 0).all()), "times do not rise")
    finite = np.isfinite(samples.position_mm).all()
    require(bool(finite), "a position is not finite")
    gaps = int(samples.sequence[-1] - samples.sequence[0]) + 1 - len(samples)
    require(health.lost_samples >= gaps, "a gap in the numbers is not in the health")


def start_twice_is_one_stream(make: MakeTracker) -> None:
    """`start` at the rate that runs changes nothing."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        before = _read(tracker, 20)
        tracker.start(RATE_HZ)
        after = _read(tracker, 20)
        tracker.stop()
    rising = after.sequence[0] > before.sequence[-1]
    require(bool(rising), "a second start began the numbers anew")


def numbers_go_on_after_a_pause(make: MakeTracker) -> None:
    """Numbers and times of one connection rise over `stop` and `start`."""
    with make() as tracker:
        blocks: list[TrackerSamples] = []
        for _ in range(2):
            tracker.start(RATE_HZ)
            blocks.append(_read(tracker, 20))
            tracker.stop()
            blocks.append(tracker.read(0.05))
        samples = TrackerSamples.join(blocks)
        lost = tracker.health.lost_samples
    sequence, time_s = samples.sequence, samples.device_time_s
    require(bool((np.diff(sequence) > 0).all()), "numbers do not rise over a pause")
    require(bool((np.diff(time_s) > 0).all()), "times do not rise over a pause")
    gaps = int(sequence[-1] - sequence[0]) + 1 - len(sequence)
    require(lost == gaps, f"{lost} samples are counted lost, {gaps} are missing")


def impossible_rates_are_refused(make: MakeTracker) -> None:
    """`start` at a rate of nothing or of a gigahertz is Refused."""
    with make() as tracker:
        for rate_hz in (0.0, -1.0, 1e9):
            expect(Refused, lambda rate_hz=rate_hz: tracker.start(rate_hz))


def a_closed_tracker_has_no_samples(make: MakeTracker) -> None:
    """`start` and `read` are ConnectionLost before `connect` and after `close`."""
    tracker = make()
    for _ in range(2):
        expect(ConnectionLost, lambda: tracker.start(RATE_HZ))
        expect(ConnectionLost, lambda: tracker.read(0.1))
        tracker.connect()
        tracker.close()


TRACKER_CHECKS: tuple[Callable[[MakeTracker], None], ...] = (
    *DEVICE_CHECKS,
    stop_is_idempotent_in_any_state,
    stop_from_another_thread_ends_the_stream,
    silence_is_an_empty_block_in_time,
    samples_have_rising_numbers_and_times,
    start_twice_is_one_stream,
    numbers_go_on_after_a_pause,
    impossible_rates_are_refused,
    a_closed_tracker_has_no_samples,
)


def _read(tracker: Tracker, count: int) -> TrackerSamples:
    deadline_s = time.monotonic() + count / RATE_HZ + 5 * PATIENCE_S
    blocks: list[TrackerSamples] = []
    while sum(map(len, blocks)) < count:
        require(time.monotonic() < deadline_s, f"{count} samples did not come")
        blocks.append(tracker.read(0.2))
    return TrackerSamples.join(blocks)


def _require_shapes(block: TrackerSamples) -> None:
    n = len(block)
    shapes = [a.shape for a in (block.sequence, block.device_time_s, block.status)]
    require(shapes == [(n,)] * 3, f"columns of unequal length: {shapes}")
    require(block.position_mm.shape == (n, 3), "positions are not (n, 3)")
    types = [block.sequence.dtype, block.status.dtype]
    require(types == [np.int64, np.int64], f"numbers and status are {types}")
