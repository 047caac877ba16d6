"""Requirements on every tracker: streams, silence, numbers, rates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.conformance.checking import (
    DEVICE_CHECKS,
    TERMS,
    NotConforming,
    expect,
    require,
    running,
    soon,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    Refused,
)
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker import Tracker

NEAREST_MM, FARTHEST_MM = 100.0, 200e3  # metres or inches for mm show
_HIDDEN = 0.005  # share of the steps; a link that loses so few is no evidence
_DAMAGED = 0.1  # share of the samples
_REPEATED = 0.3, 0.02, 3.0  # at most; by itself, and by the share alike farther apart
_APART = range(5, 15)  # samples: far enough that neither is sent in place of the other
LEAST = 50  # samples for the check of rate and times, for a second

MakeTracker = Callable[[], Tracker]


def stop_is_idempotent_in_any_state(make: MakeTracker) -> None:
    """`stop` before `connect`, twice, without a stream, in a stream, after `close`."""
    tracker = make()
    tracker.stop()
    with tracker:
        tracker.stop()
        tracker.start(TERMS.get().rate_hz)
        tracker.stop()
        tracker.stop()
    tracker.stop()


def stop_from_another_thread_ends_the_stream(make: MakeTracker) -> None:
    """`stop` needs no agreement with the thread that reads."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
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
    """A stream has whole blocks with rising numbers and times."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        samples = _read(tracker, 100)
    _require_shapes(samples)
    _require_rising(samples)
    finite = np.isfinite(samples.position_mm).all()
    require(bool(finite), "a position is not finite")


def times_are_those_of_the_samples(make: MakeTracker) -> None:
    """Numbers and times advance at the requested rate, in seconds, evenly.

    Fails for a driver that stamps by arrival, in ms, or streams at another rate; a
    driver whose device cannot do the rate refuses it. Fails, where the link loses
    something, for one that counts received samples.
    """
    period_s = 1.0 / TERMS.get().rate_hz
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        samples = _read(tracker, max(LEAST, round(TERMS.get().rate_hz)))
    steps, times = np.diff(samples.sequence), np.diff(samples.device_time_s)
    mean_s = float(times.sum() / steps.sum())
    found = f"a sample each {mean_s:.3g} s, {period_s:.3g} s was asked for"
    require(abs(mean_s - period_s) <= 0.05 * period_s, found)
    uneven = np.quantile(np.abs(times - steps * period_s), 0.95) / period_s
    stamped = "times do not follow the numbers: are they those of arrival?"
    require(bool(uneven <= 0.3), stamped)
    hidden = float((np.rint(times / period_s) > steps).mean())
    counted = "times leave gaps that the numbers hide: do these count what has come?"
    require(hidden <= _HIDDEN, counted)


def a_target_at_rest_is_valid_and_in_mm(make: MakeTracker) -> None:
    """Of a target in the beam most samples are valid, some metres away, in mm."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        samples = _read(tracker, 100)
    valid = samples.status == 0
    require(float(valid.mean()) > 0.5, "of a target in the beam no status is valid")
    distances_mm = np.linalg.norm(samples.position_mm[valid], axis=1)
    for distance_mm in (float(distances_mm.min()), float(distances_mm.max())):
        near = NEAREST_MM <= distance_mm <= FARTHEST_MM
        require(near, f"a valid sample is {distance_mm:g} mm away: is that mm?")


def each_sample_is_measured_anew(make: MakeTracker) -> None:
    """No coordinates repeat: not one number is frozen, none sent twice."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        samples = _read(tracker, 100)
    place = samples.position_mm[samples.status == 0]
    require(len(place) > 1, "of a target in the beam no status is valid")
    # The resolution of a text lets some be alike, neighbours or not.
    again, *apart = (
        float((place[k:] == place[:-k]).all(axis=1).mean()) if len(place) > k else 0.0
        for k in (1, *_APART)
    )
    most, few, times = _REPEATED
    said = f"{100 * again:.0f} % of the samples repeat the one before: frozen, doubled?"
    require(again <= min(most, few + times * float(np.mean(apart))), said)


def health_counts_damage_alone(make: MakeTracker) -> None:
    """Over a good link the damage is nothing, or close to it; losses are not damage."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        before = tracker.health.crc_errors
        count = len(_read(tracker, 100))
        damaged = tracker.health.crc_errors - before
    said = f"{damaged} damaged frames are counted beside {count} good ones"
    require(0 <= damaged <= _DAMAGED * count, said)


def start_twice_is_one_stream(make: MakeTracker) -> None:
    """`start` at the active rate changes nothing."""
    with make() as tracker:
        tracker.start(TERMS.get().rate_hz)
        before = _read(tracker, 20)
        tracker.start(TERMS.get().rate_hz)
        after = _read(tracker, 20)
        tracker.stop()
    rising = after.sequence[0] > before.sequence[-1]
    require(bool(rising), "a second start began the numbers anew")


def numbers_go_on_after_a_pause(make: MakeTracker) -> None:
    """Numbers and times of one connection rise over `stop` and `start`."""
    with make() as tracker:
        blocks: list[TrackerSamples] = []
        for _ in range(2):
            tracker.start(TERMS.get().rate_hz)
            blocks.append(_read(tracker, 20))
            host_clock.sleep_s(20 / TERMS.get().rate_hz)
            tracker.stop()
            blocks.append(tracker.read(0.05))
        samples = TrackerSamples.join(blocks)
    _require_rising(samples, " over a pause")


def impossible_rates_are_refused(make: MakeTracker) -> None:
    """`start` at a rate of nothing or of a gigahertz is Refused."""
    with make() as tracker:
        for rate_hz in (0.0, -1.0, 1e9):
            start = f"start({rate_hz:g})"
            expect(Refused, lambda rate_hz=rate_hz: tracker.start(rate_hz), start)


def a_closed_tracker_has_no_samples(make: MakeTracker) -> None:
    """`start` and `read` are ConnectionLost before `connect` and after `close`."""
    tracker = make()
    for _ in range(2):
        expect(ConnectionLost, lambda: tracker.start(TERMS.get().rate_hz), "start")
        expect(ConnectionLost, lambda: tracker.read(0.1), "read")
        tracker.connect()
        tracker.close()


TRACKER_CHECKS: tuple[Callable[[MakeTracker], None], ...] = (
    *DEVICE_CHECKS,
    stop_is_idempotent_in_any_state,
    stop_from_another_thread_ends_the_stream,
    silence_is_an_empty_block_in_time,
    samples_have_rising_numbers_and_times,
    times_are_those_of_the_samples,
    a_target_at_rest_is_valid_and_in_mm,
    each_sample_is_measured_anew,
    health_counts_damage_alone,
    start_twice_is_one_stream,
    numbers_go_on_after_a_pause,
    impossible_rates_are_refused,
    a_closed_tracker_has_no_samples,
)


def _read(tracker: Tracker, count: int) -> TrackerSamples:
    deadline_s = (
        host_clock.now_s() + count / TERMS.get().rate_hz + 5 * TERMS.get().patience_s
    )
    blocks: list[TrackerSamples] = []
    while sum(map(len, blocks)) < count:
        require(host_clock.now_s() < deadline_s, f"{count} samples did not come")
        blocks.append(tracker.read(0.2))
    return TrackerSamples.join(blocks)


def _require_rising(samples: TrackerSamples, when: str = "") -> None:
    columns = {"number": samples.sequence, "time": samples.device_time_s}
    for name, values in columns.items():
        for k in np.flatnonzero(~(np.diff(values) > 0)):
            before, this = values[k : k + 2]
            how = (
                "is doubled" if this == before else f"after {before:.12g}: out of order"
            )
            told = (
                f"{name}s do not rise{when}: {name} {this:.12g} at index {k + 1} {how}"
            )
            raise NotConforming(told)


def _require_shapes(block: TrackerSamples) -> None:
    n = len(block)
    shapes = [a.shape for a in (block.sequence, block.device_time_s, block.status)]
    require(shapes == [(n,)] * 3, f"columns of unequal length: {shapes}")
    require(block.position_mm.shape == (n, 3), "positions are not (n, 3)")
    types = [block.sequence.dtype, block.status.dtype]
    require(types == [np.int64, np.int64], f"numbers and status are {types}")
