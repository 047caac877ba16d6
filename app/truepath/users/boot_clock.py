"""How long ago something was, although the wall clock jumps."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from truepath_drivers import host_clock

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True, slots=True)
class Moment:
    """One moment on both clocks.

    wall_s : seconds of the epoch, as the wall clock had it
    boot_s : seconds since the computer was started, those asleep among them
    boot_id : which start that was
    """

    wall_s: float
    boot_s: float
    boot_id: str

    def age_s(self, now: Moment) -> float:
        """Return how long ago it was; across a reboot the wall clock has to do."""
        if self.boot_id and self.boot_id == now.boot_id:
            return now.boot_s - self.boot_s
        return max(0.0, now.wall_s - self.wall_s)


def read_moment() -> Moment:
    """Return the present moment."""
    try:
        boot_id = _BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        boot_id = ""
    boot_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    return Moment(host_clock.wall_s(), boot_s, boot_id)
