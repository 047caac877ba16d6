"""Blocks of legs of several targets, one after another, and the first target again.

The seats of targets are estimated. A shift of the set-up while the tracker turns to the
next target would pass for the seat of that one, so half of the first target's
measurement comes at the end. It ends with the first legs of all, repeated: these show a
shift whatever the errors of the machine are.

A plan's time is shared by the information per second of each target, from some legs
chosen at random, for the least integrated variance, which is convex in the shares (the
multiplicative algorithm of Silvey, Titterington and Torsney, 1978). A target whose
share is not worth turning the tracker to is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.motion.configurations import Commanded, join_rows, select_rows
from truepath.motion.motion_times import Legs
from truepath.planning.design_state import inverse
from truepath.planning.planner import Planner, SearchEffort

CHANGE_S = 5.0  # for the tracker to turn to another target
_REPEATED = 3  # legs, which determine the pose of a rigid body


@dataclass(frozen=True, slots=True)
class PlanShare:
    """Share of one of several planners: a time, or a number of legs.

    expected : information expected of its legs
    """

    planner: Planner
    budget_s: float = np.inf
    legs: int | None = None
    expected: float | Float64[np.ndarray, "p p"] = 0.0

    def halve(self) -> tuple[PlanShare, PlanShare]:
        """Two halves, the larger first."""
        half = replace(self, budget_s=0.5 * self.budget_s, expected=0.5 * self.expected)
        if self.legs is None:
            return half, half
        later = self.legs // 2
        return replace(half, legs=self.legs - later), replace(half, legs=later)


def plan_in_turn(
    shares: Sequence[PlanShare], *, seed: int, effort: SearchEffort | None = None
) -> list[Commanded]:
    """Plans of planners of one model, each from where the last one ends.

    Each includes the information of those before it, and expects that of those after
    it. Of several, the first one's comes in two parts, the second one last.

    shares : of one target each
    Raises PlanningError if a share is too small for any motion.
    """
    turns = list(shares)
    if len(shares) > 1:
        first, again = shares[0].halve()
        turns = [first, *shares[1:], *([] if again.legs == 0 else [again])]
    blocks: list[Commanded] = []
    measured, start = 0.0, None
    for number, share in enumerate(turns):
        expected = sum(one.expected for one in turns[number + 1 :])
        own = replace(share, planner=share.planner.expect(measured + expected))
        if number < len(shares):
            block = _plan(own, start, seed, effort)
        else:
            block = _return_to(blocks[0], blocks[-1].position[-1], own, seed, effort)
        measured = measured + share.planner.inform(block)
        start = block.position[-1]
        blocks.append(block)
    return blocks


def _plan(
    share: PlanShare,
    start: Float64[np.ndarray, " a"] | None,
    seed: int,
    effort: SearchEffort | None,
) -> Commanded:
    return share.planner.plan(
        share.budget_s, legs=share.legs, start=start, seed=seed, effort=effort
    )


def _return_to(
    first: Commanded,
    start: Float64[np.ndarray, " a"],
    share: PlanShare,
    seed: int,
    effort: SearchEffort | None,
) -> Commanded:
    """The last block: new legs, and the first ones again as far as they fit. first :
    block of the same target; start : position of the machine
    """
    again = _choose_repeated(first, share)
    here = select_rows(first, slice(1))
    block: Commanded = replace(here, position=start[None])
    rest = replace(
        share,
        budget_s=share.budget_s - _duration_s(share.planner, again),
        legs=None if share.legs is None else share.legs - len(again),
    )
    if rest.legs is None or rest.legs > 0:
        try:
            block = _plan(rest, start, seed, effort)
        except PlanningError:
            if not len(again):
                raise
    if not _leads_to(share.planner, block.position[-1], first.position[0]):
        return block
    return join_rows([block, again])


def _choose_repeated(first: Commanded, share: PlanShare) -> Commanded:
    for legs in range(min(_REPEATED, len(first) - 1), 0, -1):
        rows = select_rows(first, slice(legs + 1))
        in_time = _duration_s(share.planner, rows) <= share.budget_s
        if in_time and (share.legs is None or len(rows) <= share.legs):
            return rows
    return select_rows(first, slice(0))


def _duration_s(planner: Planner, again: Commanded) -> float:
    """Includes a move to the first row from the far end of the travel."""
    if not len(again):
        return 0.0
    region, feed = planner.region(), np.array([max(planner.feeds_mm_min)])
    farthest = Legs(region.low[None], region.high[None], feed)
    way_s = float(planner.design.drive.times_s(farthest)[0])
    return way_s + planner.duration_s(again)


def _leads_to(
    planner: Planner,
    here: Float64[np.ndarray, " a"],
    there: Float64[np.ndarray, " a"],
) -> bool:
    machine = planner.design.model.machine
    columns = len(machine.axes)
    begin, end = here[None, :columns], there[None, :columns]
    is_free = bool(planner.workspace.allows(machine, begin, end)[0])
    return is_free and bool(np.any(begin != end))


def wait_for_tracker(blocks: Sequence[Commanded]) -> None:
    """Sets the first dwell of each block but the first to `CHANGE_S`, in place."""
    for block in blocks[1:]:
        block.dwell_s[0] = CHANGE_S


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
        total = np.tensordot(share, np.array(rates), axes=1)
        C = inverse(design.precision + time_s * total)
        falls = C @ design.gram @ C
        share *= np.sqrt([np.sum(falls * rate) for rate in rates])
        share /= max(float(share.sum()), 1e-300)
    return share
