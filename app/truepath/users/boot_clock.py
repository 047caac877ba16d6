"""Age of a moment, independent of jumps of the wall clock."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from truepath_drivers import host_clock

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment on both clocks.

    wall_s : seconds of the epoch, by the wall clock
    boot_s : seconds since the computer was started, those asleep among them
    boot_id : identifies the boot; empty where unknown
    """

    wall_s: float
    boot_s: float
    boot_id: str

    def age_s(self, now: Moment) -> float:
        """By the clock of the boot; across a reboot by the wall clock."""
        if self.boot_id and self.boot_id == now.boot_id:
            return now.boot_s - self.boot_s
        return max(0.0, now.wall_s - self.wall_s)


def read_moment() -> Moment:
    """The present moment on both clocks."""
    try:
        boot_id = _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        boot_id = ""
    boot_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    return Moment(host_clock.wall_s(), boot_s, boot_id)
