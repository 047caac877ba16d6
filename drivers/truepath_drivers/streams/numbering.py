"""Numbers of samples that rise over a whole connection."""

from __future__ import annotations

_FOLLOW = 0.1  # share of a deviation from the nominal rate that each sample corrects


class SampleNumbers:
    """Numbers from a counter of the device, or from times where it has none.

    rate_hz : nominal, for numbers from times; a clock that deviates is followed
    wraps : samples after which the counter starts again at 0; 0 if it never does
    late : samples that one may come late by
    last : newest number that was accepted, -1 before the first
    """

    def __init__(self, rate_hz: float = 0.0, wraps: int = 0, late: int = 0) -> None:
        self._rate_hz, self._wraps, self._late = rate_hz, wraps, late
        self._zero = 0  # number at which the counter is 0
        self._counted = 0  # number by time
        self._grid_s: float | None = None  # its nominal time
        self.last = -1

    def restart_counter(self) -> None:
        """The device counts from 0 again: 0 is the number after the last one."""
        self._zero = self.last + 1

    def from_counter(self, counter: int) -> int:
        """Number at a reading of the counter."""
        number = self._zero + counter
        if not self._wraps or self.last < 0:
            return number
        earliest = self.last - 2 * self._late  # late ones are no turn ahead
        return earliest + (number - earliest) % self._wraps

    def from_time(self, time_s: float) -> int:
        """Number at a time of the device's clock; the first is 0."""
        grid_s = time_s if self._grid_s is None else self._grid_s
        steps = round((time_s - grid_s) * self._rate_hz)
        self._counted += steps
        grid_s += steps / self._rate_hz
        self._grid_s = grid_s + _FOLLOW * (time_s - grid_s)
        return self._counted

    def accept(self, number: int) -> bool:
        """Whether a number is newer than all before; `last` from now on."""
        is_newer = number > self.last
        self.last = number if is_newer else self.last
        return is_newer
