"""Parameters and results of a measurement in progress: machine, tracker, its pose.

The instrument errors depend on where the tracker looks, how long, and how often its
beam was lost: they are listed again whenever all lines are examined together.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from truepath.estimation.live.innovation_gate import LiveCheck
from truepath.estimation.problem.confounded_prior import FullPrior
from truepath.estimation.problem.information import Information
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.prior import BendingPrior
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.kinematics.coarse_model import add_bends, add_half_widths
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.instrument import (
    RangeStep,
    SetUpErrors,
    list_instrument_errors,
)
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.identifiable import (
    build_identifiable_model,
    list_absorbed_effects,
    list_partly_determined_effects,
)
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import EstimatedModel, MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.configurations import Commanded
from truepath_drivers.interfaces.records import Path

# A hundred times what errors are known to at the end.
_WEAK = {"mm": 0.1, "rad": 1e-3}
# Pose, placement and timing, in mm, rad, mm/s: as good as nothing, yet not so little
# that it drowns in the rounding of what is known.
_WEAK_NUISANCE = {"mm": 10.0, "rad": 1e-2}
_WEAK_SPEED = 10.0
_LOCKS_AHEAD = 4  # of the beam, at the least: as many as before where that is more


@dataclass(frozen=True)
class LiveModel:
    """The parameters of a measurement in progress.

    machine : effects that the targets determine; undetermined : those that they do not
    gram : of the volumetric error, in both
    added : instrument errors and new range offsets
    """

    machine: MachineModel
    undetermined: tuple[Effect, ...]
    tracker: TrackerPose
    gram: Float64[np.ndarray, "m m"]
    added: tuple[Effect, ...] = ()

    @staticmethod
    def start(machine: Machine, commanded: Commanded, known: PriorEffects) -> LiveModel:
        targets = [machine.target(name) for name in commanded.target or ("",)]
        offsets = np.array([target.offset_mm for target in targets], np.float64)
        model, _ = build_identifiable_model(machine, offsets)
        partly = list_partly_determined_effects(machine, offsets)
        model = model.with_effects(*known.effects).with_confounded(partly)
        determined = add_half_widths(model)
        if isinstance(commanded, Path):
            determined = add_bends(determined)
        undetermined = tuple(list_absorbed_effects(machine, offsets))
        middle = [0.5 * (a.low + a.high) for a in machine.linear_axes]
        x, y, z = (*middle, 0.0, 0.0)[:3]
        gram = compute_volumetric_gram(determined.with_confounded(undetermined))
        return LiveModel(determined, undetermined, TrackerPose((x, y, z)), gram)

    @cached_property
    def full_model(self) -> MachineModel:
        """All effects but the pose."""
        determined = self.machine.with_effects(*self.added)
        return determined.with_confounded(self.undetermined)

    def mean_square_mm2(self, covariance: Float64[np.ndarray, "p p"]) -> float:
        first = self.machine.size
        added = sum(len(effect.parameters) for effect in self.added)
        own = np.delete(np.arange(len(covariance)), np.s_[first : first + added])
        return float(np.sum(self.gram * covariance[np.ix_(own, own)]))

    @cached_property
    def weak(self) -> Float64[np.ndarray, " q"]:
        """Precision that keeps each parameter finite, the pose last.

        1/mm², 1/rad² and so on, in the unit of the parameter.
        """
        sigmas: list[float] = []
        for effect in (*self.full_model.effects, self.tracker):
            sizes, other = _WEAK, 1.0
            if effect.role is Role.NUISANCE:
                sizes, other = _WEAK_NUISANCE, _WEAK_SPEED
            sigmas += [sizes.get(each.unit, other) for each in effect.parameters]
        return np.array([sigma**-2 for sigma in sigmas])

    @property
    def zero_information(self) -> Information:
        return Information.nothing(self.full_model.size)

    @property
    def watched(self) -> list[Effect]:
        """Without range steps, which would hide a change already found."""
        return [e for e in self.full_model.effects if not isinstance(e, RangeStep)]

    @property
    def most_locks(self) -> int:
        """Number of beam losses after which the model has to be rebuilt."""
        found = [e.locks for e in self.added if isinstance(e, SetUpErrors)]
        return found[0][-1] if found else sys.maxsize  # the first is that of this Run

    def guess_prior(self, before: FullPrior | None = None) -> FullPrior:
        determined = self.machine.with_effects(*self.added)
        prior = FullPrior.guess(determined, self.undetermined)
        if before is None:
            return prior
        return FullPrior(
            _learn(prior.determined, before.determined), _learn(prior.full, before.full)
        )


def _learn(prior: BendingPrior, before: BendingPrior) -> BendingPrior:
    learnt = {n: v for n, v in before.precision.items() if n in prior.precision}
    return replace(prior, precision={**prior.precision, **learnt})


def list_live_errors(at: Conditions, earlier: Sequence[Conditions]) -> Iterator[Effect]:
    """Instrument errors, with range offsets in reserve for future locks.

    at : of the current Run; earlier : of others
    """
    assert at.recorded is not None  # noqa: S101 (a live Run knows its surroundings)
    own = at.recorded.set_up
    for each in list_instrument_errors([at, *earlier]):
        if isinstance(each, SetUpErrors) and each.set_up == own:
            first = each.locks[-1] + 1
            ahead = range(first, first + max(_LOCKS_AHEAD, len(each.locks)))
            yield replace(each, locks=(*each.locks, *ahead))
        else:
            yield each


@dataclass(frozen=True, slots=True)
class LiveEstimate(EstimatedModel):
    """The estimate from the lines so far.

    volumetric_sigma_mm : root mean square over the axis travel of the standard
        uncertainty (k = 1) of the volumetric error vector of the first target, without
        the rigid motion of the whole volume; `volumetric_uncertainty_um` outside
    done : finished lines or points; cells : of them; time_s : tracker's clock
    check : exclusions, steps and residuals
    """

    volumetric_sigma_mm: float
    done: int
    cells: int
    time_s: float
    check: LiveCheck = field(default_factory=LiveCheck)


@dataclass(frozen=True, slots=True)
class LiveFindings:
    """What the plan of further rows needs from a measurement in progress.

    rows : whose line or standstill has been recognised
    station_mm : (3,) of the tracker, in the frame that it is mounted on
    prior_precision : by the effect's name
    """

    rows: frozenset[int]
    station_mm: Float64[np.ndarray, "3"]
    noise: NoiseModel
    prior_precision: Mapping[str, float]
