"""How long a measurement waits for what."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class StreamTimeouts:
    """For how long, in seconds that the host has run, a stream may be less than good.

    late_s : what counts at most of a time in which the host did not run: a suspended or
        starved process reads nothing, and finds all data waiting afterwards
    """

    silent_s: float = 0.5
    dead_s: float = 5.0
    beam_s: float = 0.25
    late_s: float = 0.25


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Times of the host in seconds where nothing else is said.

    confirm_s : a hold, a cycle start or a resume is confirmed by then
    link_s : the controller may be out of reach for so long
    lead_s : stream before the first and after the last motion, tracker's clock
    settle_s : between the end of a move and the dwell at a point, tracker's clock
    arrival : how far from a commanded position an axis may stand, mm or deg
    axes_rows : controller positions that are written together
    """

    poll_s: float = 0.1
    confirm_s: float = 5.0
    link_s: float = 2.0
    first_sample_s: float = 5.0
    lead_s: float = 1.0
    settle_s: float = 0.3
    arrival: float = 0.02
    progress_s: float = 0.2
    axes_rows: int = 10
    timeouts: StreamTimeouts = field(default_factory=StreamTimeouts)
