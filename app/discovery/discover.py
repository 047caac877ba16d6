"""The way from a Run to the effects that its model lacks.

Where measured and simulated differ, which effects explain it, none or unnamed where
that is the answer, and how much of the gap is closed on lines not seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.alignment.reduction import beam_frame
from app.discovery.base import GivenModel, Ground, ground_of, renoised
from app.discovery.catalogue import DESCRIBED, families
from app.discovery.scan import Offer
from app.discovery.scene import Scene, at_pose, scene_of
from app.discovery.search import Explanation, Search
from app.discovery.where import Where, where
from app.estimation.noise import floor_mm
from app.kinematics.effects.base import Conditions
from app.kinematics.effects.catalogue import Candidate, Family, Measured
from app.measurement.run import Run

_EQUIVALENT = 3.0


@dataclass(frozen=True)
class Evidence:
    """Why an effect is believed.

    log_bayes : of the effect given the others, less the price of the search
    held_out : gain in log score on lines that the fit did not see
    share : of the gap that it closes
    """

    log_bayes: float
    held_out: float
    share: float


@dataclass(frozen=True)
class Finding:
    """One effect, how large it is, why it is believed, and what else it may be."""

    offer: Offer
    parameters: dict[str, Measured]
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    evidence: Evidence
    alternatives: tuple[Candidate, ...]

    @property
    def family(self) -> Family:
        """The effect's family."""
        return self.offer.family

    @property
    def candidate(self) -> Candidate:
        """The effect."""
        return self.offer.candidate

    @property
    def is_described(self) -> bool:
        """Whether it is structure without a catalogued cause."""
        return self.family.name in DESCRIBED


@dataclass(frozen=True)
class Gap:
    """Weighted root mean square of measured minus simulated on lines not seen."""

    before_um: float
    after_um: float
    noise_floor_um: float


@dataclass(frozen=True)
class Discovery:
    """What the model lacks.

    plain : the Run explained by the base alone
    findings : by evidence, greatest first; compared : effects that were looked for
    left_before_mm, left_after_mm : (n, 3) what base alone and explanation leave, where
        the tracker stands
    """

    scene: Scene
    ground: Ground
    plain: Explanation
    explanation: Explanation
    findings: tuple[Finding, ...]
    gap: Gap
    before: Where
    after: Where
    left_before_mm: Float64[np.ndarray, "n 3"]
    left_after_mm: Float64[np.ndarray, "n 3"]
    compared: int

    @property
    def at(self) -> Conditions:
        """Conditions of the cells."""
        return self.scene.at


def discover(
    run: Run,
    given: GivenModel | None = None,
    progress: Callable[[float], None] | None = None,
) -> Discovery:
    """Find what simulation lacks to be like the measurement.

    given : the model that simulates; the rigid-body model fitted to the Run if None

    Raises AlignmentError, EstimationError if the Run cannot be fitted at all.
    """
    told = progress or _untold
    scene = scene_of(run)
    told(0.05)
    ground = ground_of(run, given)
    scene = Scene(run, at_pose(scene.seen, ground.base.pose))
    told(0.35)
    search = Search(scene.seen, ground.base, ground.prior, _looked_for(given))
    best = search.found()
    told(0.6)
    if best.chosen:
        # With the effects known, what they made is no noise any more.
        ground = renoised(ground, [o.candidate.effect for o in best.chosen])
        scene = Scene(run, at_pose(scene.seen, ground.base.pose))
        search = Search(scene.seen, ground.base, ground.prior, _looked_for(given))
        best = search.found(best.chosen)
    told(0.8)
    plain = search.explained([])
    findings = _findings(search, plain, best)
    told(0.95)
    frame = beam_frame(scene.seen.tracker_mm) @ ground.base.pose.rotation
    along = np.einsum("nij,nj->ni", frame, scene.seen.direction)
    floor = floor_mm(scene.seen, ground.base.noise, along) * 1e3
    before, after = (search.residual(e).left_mm for e in (plain, best))
    return Discovery(
        scene,
        ground,
        plain,
        best,
        findings,
        Gap(floor * plain.foretold.ratio, floor * best.foretold.ratio, floor),
        where(scene.seen, before),
        where(scene.seen, after),
        before,
        after,
        search.compared,
    )


def _looked_for(given: GivenModel | None) -> tuple[Family, ...]:
    """Return all families; what the rigid-body model always has is not missing."""
    return tuple(f for f in families() if given is not None or f.name != "squareness")


def _untold(share: float) -> None:
    """Tell nobody."""


def _findings(
    search: Search, plain: Explanation, best: Explanation
) -> tuple[Finding, ...]:
    found = [
        _finding(search, plain, best, number) for number in range(len(best.chosen))
    ]
    return tuple(sorted(found, key=lambda f: -f.evidence.log_bayes))


def _finding(
    search: Search, plain: Explanation, best: Explanation, number: int
) -> Finding:
    offer = best.chosen[number]
    without = search.explained([o for o in best.chosen if o is not offer])
    (own,), _ = search.ranked(without, [offer])
    theta, covariance = best.effect(number)
    if offer.covariance is not None:
        covariance = offer.covariance
    gap = plain.foretold.square.sum() - best.foretold.square.sum()
    lost = without.foretold.square.sum() - best.foretold.square.sum()
    return Finding(
        offer,
        offer.family.parameters(offer.candidate, theta, covariance, offer.value_sigma),
        theta,
        covariance,
        Evidence(own.evidence, 0.5 * float(lost), float(lost / max(gap, 1e-12))),
        _alternatives(search, without, offer, own.evidence),
    )


def _alternatives(
    search: Search, without: Explanation, offer: Offer, evidence: float
) -> tuple[Candidate, ...]:
    """Return the effects that would explain the same as well."""
    others, _ = search.ranked(without)
    return tuple(
        r.offer.candidate
        for r in others
        if not r.offer.candidate.same_as(offer.candidate)
        and r.evidence > evidence - _EQUIVALENT
        and r.offer.family.name not in DESCRIBED
    )
