"""Seats of targets, as far as the standstills or points so far determine them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.stream.seating import Seating, Seats
from truepath.alignment.stream.sequence import seat_points


class KnownSeats:
    """Seats of targets while measurements come in. One thread.

    place_mm, seated_mm : waypoints with targets as stated, and with targets at their
        seats
    seats : targets that are far off their stated positions, and their shifts; another
        object once another target is known
    """

    def __init__(self) -> None:
        self._settled: frozenset[str] = frozenset()
        self.seats: Seats = {}

    def set_waypoints(
        self, place_mm: Float64[np.ndarray, "w 3"], seating: Seating | None
    ) -> None:
        """Sets the waypoints; `seating` is None where every target is as stated."""
        self.place_mm = self.seated_mm = place_mm
        self.seating = seating

    def refine(
        self, places_mm: Float64[np.ndarray, "k 3"], waypoints: Int64[np.ndarray, " k"]
    ) -> bool:
        """Estimates the seats from all points; True if one more is settled."""
        if self.seating is None:
            return False
        self.seated_mm, found = seat_points(
            places_mm, self.place_mm, waypoints, self.seating
        )
        settled = self.seating.list_settled(waypoints)
        if settled == self._settled:
            return False
        # All again with each target: the estimate is linear in the rest.
        self._settled = settled
        self.seats = {name: found[name] for name in found if name in settled}
        return True

    def is_known(self, waypoint: int) -> bool:
        """True if the seat of the target at a waypoint is settled."""
        if self.seating is None:
            return True
        return self.seating.names[self.seating.target[waypoint]] in self._settled

    def compute_reach_mm(self, waypoint: int) -> float:
        """Tolerance for a target whose seat is not settled yet; 0 for others."""
        if self.seating is None or self.is_known(waypoint):
            return 0.0
        return float(self.seating.reach_mm[waypoint])
