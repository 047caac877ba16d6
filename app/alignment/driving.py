"""How the machine drove its path where that is not as commanded: feed, holds, ends.

A measurement rests on none of it, but who ran the program should know.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from truepath.app.alignment.nominal_path import NominalPath
from truepath.app.alignment.observations import Driving, Pass
from truepath.app.alignment.segmentation import Stream
from truepath.app.alignment.sequence import Matching
from truepath.app.alignment.stops import StopSequence

_OTHER_FEED = 0.03  # of the commanded one; controllers keep it far better
_STEADY_S = 0.5  # at least: a short line may not come to its feed
_HOLD_S = 0.3  # shorter standstills are no hold
_FROM_ENDS_MM = 1.0  # nearer to a waypoint it is the waypoint


def describe_driving(
    stream: Stream,
    stops: StopSequence,
    matching: Matching,
    nominal: NominalPath,
    passes: Sequence[Pass],
) -> Driving:
    """Compare what was driven with what was commanded."""
    place = matching.waypoint
    return Driving(
        min(int(nominal.first[place[0]]), passes[0].row),
        max(int(nominal.last[place[-1]]), passes[-1].row),
        len(nominal.end_mm),
        _find_other_feeds(stream, nominal, passes),
        _find_holds(stream, stops, matching, nominal),
    )


def _find_other_feeds(
    stream: Stream, nominal: NominalPath, passes: Sequence[Pass]
) -> dict[int, float]:
    """Return shares of the feed; how it is split over rotary axes is the control's."""
    found: dict[int, float] = {}
    for each in passes:
        if not each.is_steady or nominal.turn_deg[each.row] > 0.0:
            continue
        took_s = stream.time_s[each.last - 1] - stream.time_s[each.first]
        share = each.speed_mm_s / float(nominal.speed_mm_s[each.row])
        if took_s >= _STEADY_S and abs(share - 1.0) > _OTHER_FEED:
            found[each.row] = share
    return found


def _find_holds(
    stream: Stream, stops: StopSequence, matching: Matching, nominal: NominalPath
) -> tuple[tuple[int, float, float], ...]:
    found: list[tuple[int, float, float]] = []
    where_mm = matching.pose.invert().apply(stops.position_mm)
    matched = zip(matching.stop.tolist(), matching.waypoint.tolist(), strict=True)
    for (here, a), (there, b) in pairwise(matched):
        rows = range(int(nominal.last[a]) + 1, int(nominal.first[b]) + 1)
        for k in range(here + 1, there):
            begin_s = float(stream.time_s[stops.first[k]])
            stood_s = float(stream.time_s[stops.last[k] - 1]) - begin_s
            on = [r for r in rows if _is_on_line(nominal, r, where_mm[k], matching)]
            if on and stood_s >= _HOLD_S:
                found.append((on[0], begin_s, stood_s))
    return tuple(found)


def _is_on_line(
    nominal: NominalPath, row: int, place_mm: np.ndarray, matching: Matching
) -> bool:
    """Tell whether a place is on a line, and neither its beginning nor its end."""
    curve = nominal.curve(row)
    share, off_mm = curve.nearest(place_mm[None])
    way_mm = float(share[0]) * curve.length_mm
    is_between = _FROM_ENDS_MM < way_mm < curve.length_mm - _FROM_ENDS_MM
    return is_between and float(off_mm[0]) < matching.reach_mm
