"""Makes wrapped counters whole: u16 sequence numbers and device clocks, over any gap.

The sequence alone cannot tell a loss of n samples from one of n + 65 536 (131 s at
500 Hz); the device clock can. With period T, clock step Δt, sequence step d (mod 2¹⁶)

    step = d + 2¹⁶ · round((Δt / T − d) / 2¹⁶)

A step below 1, or a clock that runs backwards, is a repeated or late frame: left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TURN = 1 << 16


class Unwrapper:
    """Continues sequence numbers and microseconds from block to block of one stream.

    lost : samples that the numbers say were taken and that never came
    """

    def __init__(self) -> None:
        self.lost = 0
        self._sequence = -1  # last one, whole
        self._wrapped: int | None = None  # last one, as on the wire
        self._clock_us = 0
        self._period_us = 0.0
        self._fresh = True

    def begin(self, next_sequence: int, rate_hz: float, clock_us: int) -> None:
        """Take what the device says at a START: next number, rate, clock."""
        missed = 0
        if self._wrapped is not None and clock_us >= self._clock_us:
            missed = (next_sequence - self._wrapped - 1) % _TURN
        # An earlier clock is that of a device switched off and on: nothing was missed.
        self.lost += missed
        self._sequence += missed
        self._wrapped = (next_sequence - 1) % _TURN
        self._clock_us = clock_us
        self._period_us = 1e6 / rate_hz
        self._fresh = True

    def advance(
        self, wrapped: NDArray[np.int64], clock_us: NDArray[np.uint64], clock_bits: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Return whole numbers, whole microseconds, which samples to keep, (n,) each.

        wrapped, clock_us : (n,), n >= 1, as on the wire
        """
        if self._wrapped is None:
            self._wrapped = (int(wrapped[0]) - 1) % _TURN
            self._clock_us = int(clock_us[0])
        steps = np.diff(wrapped, prepend=self._wrapped) % _TURN
        ticks = _signed_steps(clock_us, self._clock_us, clock_bits)
        if not self._period_us:
            self._learn_period(steps, ticks)
        if self._is_plain(steps, ticks):
            sequence = self._sequence + np.arange(1, len(steps) + 1)
            clock = self._clock_us + np.cumsum(ticks)
            keep = np.ones(len(steps), np.bool_)
        else:
            sequence, clock, keep = self._one_by_one(steps, ticks)
        self._remember(wrapped, sequence, clock, keep)
        return sequence, clock, keep

    def _learn_period(self, steps: NDArray[np.int64], ticks: NDArray[np.int64]) -> None:
        """Take the usual clock step of neighbours where no START has told the rate."""
        neighbours = ticks[(steps == 1) & (ticks > 0)]
        if len(neighbours):
            self._period_us = float(np.median(neighbours))

    def _is_plain(self, steps: NDArray[np.int64], ticks: NDArray[np.int64]) -> bool:
        """Tell whether every sample follows its predecessor: the usual case."""
        first = 1 if self._fresh else 0
        shortest_turn_us = self._period_us * _TURN / 2
        return bool(
            np.all(steps == 1)
            and np.all(ticks[first:] > 0)
            and (not shortest_turn_us or np.all(ticks < shortest_turn_us))
        )

    def _one_by_one(
        self, steps: NDArray[np.int64], ticks: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        sequence = np.empty(len(steps), np.int64)
        clock = self._clock_us + np.cumsum(ticks)
        keep = np.zeros(len(steps), np.bool_)
        # Since the last one kept: steps and ticks of frames left out still count.
        step, tick = 0, 0
        for i in range(len(steps)):
            step, tick = (step + int(steps[i])) % _TURN, tick + int(ticks[i])
            whole = self._whole_step(step, tick)
            sequence[i] = self._sequence + whole
            if whole < 1 or (tick < 0 and not self._fresh):
                continue
            keep[i], self._fresh = True, False
            self.lost += whole - 1
            self._sequence += whole
            step, tick = 0, 0
        return sequence, clock, keep

    def _whole_step(self, step: int, tick_us: int) -> int:
        if not self._period_us:
            return step
        return step + _TURN * round((tick_us / self._period_us - step) / _TURN)

    def _remember(
        self,
        wrapped: NDArray[np.int64],
        sequence: NDArray[np.int64],
        clock: NDArray[np.int64],
        keep: NDArray[np.bool_],
    ) -> None:
        kept = np.flatnonzero(keep)
        if len(kept):
            last = kept[-1]
            self._sequence = int(sequence[last])
            self._wrapped = int(wrapped[last])
            self._clock_us = int(clock[last])
            self._fresh = False


def _signed_steps(
    clock_us: NDArray[np.uint64], before_us: int, bits: int
) -> NDArray[np.int64]:
    """Return clock steps in the half turn either side of zero, (n,)."""
    before = np.uint64(before_us % (1 << 64))
    steps = np.diff(clock_us, prepend=before)
    if bits == 64:
        return steps.view(np.int64)
    turn = np.uint64(1 << bits)
    half = np.uint64(1 << (bits - 1))
    return ((steps + half) % turn).astype(np.int64) - int(half)
