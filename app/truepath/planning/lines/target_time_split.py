"""Shares of a plan's time among targets, by their information per second.

Some legs of each target, chosen at random, give its information per second. The time is
then shared for the least integrated variance, which is convex in the shares (the
multiplicative algorithm of Silvey, Titterington and Torsney, 1978). A target whose
share is not worth turning the tracker to is dropped. Of several, the first is measured
again at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.motion.motion_times import Legs
from truepath.planning.design_state import inverse
from truepath.planning.lines.planner import Planner
from truepath.planning.lines.target_blocks import PlanShare

_LEGS = 40  # of each target, before those that cannot be measured are dropped
_LEAST_S = 10.0  # of a block of legs of one target: a few
_ROUNDS = 20


def share_among_targets(
    planners: Sequence[Planner], budget_s: float, change_s: float, seed: int
) -> list[PlanShare]:
    """Time of each target that is worth it, in their order.

    planners : of one model, each of one target; change_s : from a target to the next
    """
    if len(planners) == 1:
        return [PlanShare(planners[0], budget_s)]
    drawn = [ExpectedLegs.draw(planner, seed) for planner in planners]
    rates = [legs.rate for legs in drawn]
    kept = list(range(len(planners)))
    while True:
        changes = len(kept) if len(kept) > 1 else 0
        time_s = max(budget_s - change_s * changes, 0.0)
        share = _share(planners[0], [rates[k] for k in kept], time_s)
        blocks = np.where(np.arange(len(kept)) == 0, 2, 1)  # the first one comes again
        least = int(np.argmin(share / blocks))
        if len(kept) == 1 or share[least] * time_s >= _LEAST_S * blocks[least]:
            break
        del kept[least]
    return [
        PlanShare(
            planners[k],
            part * time_s,
            expected=drawn[k].inform(part * time_s / drawn[k].leg_s),
        )
        for k, part in zip(kept, share.tolist(), strict=True)
    ]


@dataclass(frozen=True, slots=True)
class ExpectedLegs:
    """Random legs of one target, as a sample of its information.

    rows : of each leg, as the design has them; leg_s : mean time of one
    """

    rows: Float64[np.ndarray, "n r p"]
    leg_s: float

    @classmethod
    def draw(cls, planner: Planner, seed: int) -> ExpectedLegs:
        """Random legs, without those that cannot be measured."""
        rng, region = np.random.default_rng(seed), planner.region()
        design, feed = planner.design, np.full(_LEGS, planner.feeds_mm_min[0])
        begin, end = rng.uniform(region.low, region.high, (2, _LEGS, len(region.low)))
        legs = Legs(begin, design.restrict_axes(end, begin), feed)
        ok = region.allows(legs)
        if not ok.any():
            return cls(np.zeros((1, 1, len(design.precision))), 1.0)
        legs = Legs(legs.begin[ok], legs.end[ok], feed[ok])
        return cls(design.rows(legs), float(design.drive.times_s(legs).mean()))

    @property
    def rate(self) -> Float64[np.ndarray, "p p"]:
        """Information per second."""
        count = len(self.rows)
        return self.inform(count) / (count * self.leg_s)

    def inform(self, count: float) -> Float64[np.ndarray, "p p"]:
        """Information of a number of them; few leave many directions undetermined."""
        some = max(1, min(round(count), len(self.rows)))
        flat = self.rows[:some].reshape(-1, self.rows.shape[2])
        return count / some * (flat.T @ flat)


def _share(
    planner: Planner, rates: Sequence[Float64[np.ndarray, "p p"]], time_s: float
) -> Float64[np.ndarray, " t"]:
    design = planner.design
    share = np.full(len(rates), 1.0 / len(rates))
    for _ in range(_ROUNDS):
        told = np.tensordot(share, np.array(rates), axes=1)
        C = inverse(design.precision + time_s * told)
        falls = C @ design.gram @ C
        share *= np.sqrt([np.sum(falls * rate) for rate in rates])
        share /= max(float(share.sum()), 1e-300)
    return share
