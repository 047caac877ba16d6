"""The way from Runs to the effects that their model lacks.

Where measured and simulated differ, which effects explain it, none or unnamed where
that is the answer, and how much of the gap is closed on lines not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.alignment.reduction import beam_frame
from app.discovery.base import GivenModel, Ground, grounds_of, renoised
from app.discovery.catalogue import families
from app.discovery.explaining import Explainer, Explanation
from app.discovery.scan import Offer
from app.discovery.scene import Scene, at_pose, scene_of
from app.discovery.search import Search
from app.discovery.view import View
from app.discovery.where import Shown, shown
from app.discovery.within import within_cells
from app.estimation.noise import floor_mm
from app.files.run import Run
from app.kinematics.conditions import Conditions
from app.kinematics.effects.catalogue import Candidate, Described, Family, Measured
from app.progress import ShareProgress, ignore_progress

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
    """One effect, how large it is, why it is believed, and what else it may be.

    rivals : effects that would explain the same as well
    """

    offer: Offer
    parameters: dict[str, Measured]
    theta: Float64[np.ndarray, " p"]
    covariance: Float64[np.ndarray, "p p"]
    evidence: Evidence
    rivals: tuple[Offer, ...]

    @property
    def alternatives(self) -> tuple[Candidate, ...]:
        """What else it may be."""
        return tuple(rival.candidate for rival in self.rivals)

    @property
    def family(self) -> Family:
        """The effect's family."""
        return self.offer.family

    @property
    def candidate(self) -> Candidate:
        """The effect."""
        return self.offer.candidate

    @property
    def structure(self) -> Described | None:
        """Its family, if it is structure without a catalogued cause."""
        return self.family if isinstance(self.family, Described) else None


@dataclass(frozen=True)
class Gap:
    """Weighted root mean square of measured minus simulated on lines not seen.

    expected_um : what a complete model would leave there, as the other lines tell it:
        noise and the fit's own uncertainty
    """

    before_um: float
    after_um: float
    noise_floor_um: float
    expected_um: float


@dataclass(frozen=True)
class Discovery:
    """What the model lacks.

    scenes, grounds : of each Run; explainer : to ask for other explanations
    plain : the Runs explained by the base alone
    findings : by evidence, greatest first; compared : effects that were looked for
    shown : of each Run, what base alone and explanation leave, and where
    """

    scenes: tuple[Scene, ...]
    grounds: tuple[Ground, ...]
    explainer: Explainer
    plain: Explanation
    explanation: Explanation
    findings: tuple[Finding, ...]
    gap: Gap
    shown: tuple[Shown, ...]
    compared: int

    @property
    def scene(self) -> Scene:
        """The first Run."""
        return self.scenes[0]

    @property
    def ground(self) -> Ground:
        """What the first Run is held against."""
        return self.grounds[0]

    @property
    def at(self) -> Conditions:
        """Conditions of the cells of the first Run."""
        return self.scene.at


def discover(
    runs: Sequence[Run],
    given: GivenModel | None = None,
    on_progress: ShareProgress = ignore_progress,
) -> Discovery:
    """Find what simulation lacks to be like the measurement.

    runs : of one machine, each with its own tracker pose, timing and noise
    given : the model that simulates; the rigid-body model fitted to the Runs if None

    Raises AlignmentError, EstimationError if the Runs cannot be fitted at all,
    BundleError if they are not of one machine.
    """
    scenes = tuple(scene_of(run, number) for number, run in enumerate(runs))
    on_progress(0.05)
    grounds = grounds_of(runs, given)
    on_progress(0.35)
    scenes, explainer = _prepared(scenes, grounds, given)
    best = Search(explainer).grown()
    on_progress(0.6)
    if best.chosen:
        # With the effects known, what they made is no noise any more.
        grounds = renoised(grounds, [o.effect for o in best.chosen])
        scenes, explainer = _prepared(scenes, grounds, given)
        best = Search(explainer).found(best.chosen)
    on_progress(0.8)
    plain = explainer.explained([]) if best.chosen else best
    findings = _findings(explainer, plain, best)
    on_progress(0.95)
    floor = _floor_um(scenes, grounds)
    left = zip(
        scenes, explainer.residuals(plain), explainer.residuals(best), strict=True
    )
    return Discovery(
        scenes,
        grounds,
        explainer,
        plain,
        best,
        findings,
        _gap(floor, plain, best),
        tuple(shown(s.seen, b.left_mm, a.left_mm) for s, b, a in left),
        explainer.compared,
    )


def _prepared(
    scenes: Sequence[Scene], grounds: Sequence[Ground], given: GivenModel | None
) -> tuple[tuple[Scene, ...], Explainer]:
    """Return the scenes where their trackers stand, and what explains them."""
    placed = tuple(
        Scene(scene.run, at_pose(scene.seen, ground.base.pose))
        for scene, ground in zip(scenes, grounds, strict=True)
    )
    views = [
        View(s.seen, g.base, within_cells(s.run, s.seen, g.base))
        for s, g in zip(placed, grounds, strict=True)
    ]
    return placed, Explainer(views, grounds[0].prior, _looked_for(given))


def _floor_um(scenes: Sequence[Scene], grounds: Sequence[Ground]) -> float:
    """Return the root mean square that noise alone leaves in a cell of all Runs."""
    square, cells = 0.0, 0
    for scene, ground in zip(scenes, grounds, strict=True):
        seen, base = scene.seen, ground.base
        frame = beam_frame(seen.tracker_mm) @ base.pose.rotation
        along = np.einsum("nij,nj->ni", frame, seen.direction)
        square += len(seen) * floor_mm(seen, base.noise, along) ** 2
        cells += len(seen)
    return 1e3 * float(np.sqrt(square / cells))


def _looked_for(given: GivenModel | None) -> tuple[Family, ...]:
    """Return all families; what the rigid-body model always has is not missing."""
    return tuple(f for f in families() if given is not None or f.name != "squareness")


def _gap(floor_um: float, plain: Explanation, best: Explanation) -> Gap:
    """Return the gap; a fast effect shows in the samples within cells as well."""
    once = np.zeros(1)
    fast = any(o.candidate.effect.in_time(once) is not None for o in best.chosen)
    return Gap(
        floor_um * plain.foretold.ratio(fast=fast),
        floor_um * best.foretold.ratio(fast=fast),
        floor_um,
        floor_um * best.foretold.expected(fast=fast),
    )


def _findings(
    explainer: Explainer, plain: Explanation, best: Explanation
) -> tuple[Finding, ...]:
    found = [
        _finding(explainer, plain, best, number) for number in range(len(best.chosen))
    ]
    return tuple(sorted(found, key=lambda f: -f.evidence.log_bayes))


def _finding(
    explainer: Explainer, plain: Explanation, best: Explanation, number: int
) -> Finding:
    offer = best.chosen[number]
    without = explainer.explained([o for o in best.chosen if o is not offer])
    own = explainer.ranked(without, [offer])[0]
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
        _rivals(explainer, without, offer, own.evidence),
    )


def _rivals(
    explainer: Explainer, without: Explanation, offer: Offer, evidence: float
) -> tuple[Offer, ...]:
    """Return the effects that would explain the same as well."""
    return tuple(
        r.offer
        for r in explainer.promising(without)
        if r.offer.label != offer.label
        and r.evidence > evidence - _EQUIVALENT
        and not isinstance(r.offer.family, Described)
    )
