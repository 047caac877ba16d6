"""The planner's design state from the estimator: its model, prior, noise and criterion.

Planning comes before estimation, so the assumptions on a machine come from here: the
motions that the targets determine, with few knots, and their dependence on the
direction of approach, so that backlash is planned for as well. Undetermined effects are
included, but for turns that a displacement makes up for at every target.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from truepath.estimation.problem.information import Information, OwnParameters
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.prior import diagonal_precision
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.kinematics.coarse_model import add_half_widths
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.effects.speed_error import ServoMismatch
from truepath.kinematics.identifiable import (
    build_identifiable_model,
    list_confounded_effects,
)
from truepath.kinematics.machine.machine import Machine, remove_rotary_axes
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.motion_times import DEFAULT_FEED_MM_MIN, Drive
from truepath.motion.paths.default_points import corner_path
from truepath.motion.workspace import Workspace
from truepath.planning.design_state import DesignState, ExpectedNoise, inverse
from truepath.planning.forecast import Assumptions
from truepath.planning.simulated_cells import assume_stations_mm, predict_cells

INTERVALS = 6  # of the knots: enough for the choice; the forecast uses all
_ANY_POSE = {"mm": 1e2, "rad": 1e-1}  # the tracker's pose is unknown
_ANY_LAG_S = 1e-3  # of an axis behind its command
_JITTER_CELL_S = 0.2  # over which the feed's jitter is averaged


def predict_lag_sigmas_s(design: DesignState) -> dict[str, float]:
    """Standard uncertainty of each axis' lag against the mean of all, by axis.

    The common lag only makes a line late, which its unknown phase absorbs. Empty where
    the design has no lags.
    """
    model = design.model
    lags = {e.lag_axis: e.name for e in model.effects if e.lag_axis}
    if not lags:
        return {}
    at = [model.slices[name].start for name in lags.values()]
    own = inverse(design.precision)[np.ix_(at, at)]
    against_mean = np.eye(len(at)) - 1.0 / len(at)
    sigma = np.sqrt(np.diag(against_mean @ own @ against_mean.T))
    return {axis: float(v) for axis, v in zip(lags, sigma, strict=True)}


def choose_station(machine: Machine, workspace: Workspace) -> NDArray[np.float64]:
    """The given or a typical station, in the frame that it is mounted on."""
    if workspace.tracker_mm is not None:
        return np.array(workspace.tracker_mm, np.float64)
    return assume_stations_mm(machine)[2]


def start_design(
    kind: type[DesignState],
    machine: Machine,
    station_mm: NDArray[np.float64],
    drive: Drive,
    assumed: Assumptions | None = None,
    *,
    target: str | None = None,
    dynamic: bool = False,
) -> DesignState:
    """State before the first line or standstill of a machine.

    target : measured while all axes move; None for the first one while the rotary axes
        are at rest
    dynamic : each axis may lag behind its command by more than the others, which lines
        of several feeds distinguish from errors that do not depend on the feed
    """
    one, assumed = machine.target(target or ""), assumed or Assumptions()
    shown = machine.targets
    if target is None:
        machine, shown = remove_rotary_axes(machine), (one,)
    known, lags = assumed.known, tuple[ServoMismatch, ...]()
    if dynamic:
        has = {effect.lag_axis for effect in known.effects}
        missing = [axis for axis in machine.linear_axes if axis.name not in has]
        lags = tuple(map(ServoMismatch, missing))
    offsets_mm = np.array([t.offset_mm for t in shown], np.float64)
    motions, _ = build_identifiable_model(machine, offsets_mm, intervals=INTERVALS)
    motions = add_half_widths(motions.with_effects(*known.effects))
    confounded = list_confounded_effects(machine, offsets_mm)
    compensated_turns = motions.with_confounded(confounded).compensated_turns
    motions = motions.with_confounded(
        [e.coarsen(INTERVALS) for e in confounded if e.name not in compensated_turns]
    )
    model = motions.with_effects(*lags, _pose_of(machine))
    size = motions.size
    pose = diagonal_precision(_pose_of(machine).parameters, _ANY_POSE)
    prior = assumed.make_prior(motions)
    gram = np.zeros((model.size, model.size))
    gram[:size, :size] = compute_volumetric_gram(motions) + _motion_gram(motions, known)
    return kind(
        model=model,
        target=one,
        precision=block_diag(prior, np.eye(len(lags)) / _ANY_LAG_S**2, pose),
        gram=gram,
        station_mm=station_mm,
        noise=_expect_noise(assumed.used_noise, machine.tracker.rate_hz),
        drive=drive,
    )


def add_station(design: DesignState, before: DesignState) -> DesignState:
    """A design with the information on the machine from the stations before.

    design : of the new station, whose pose is unknown; before : after the last one
    """
    pose = _pose_of(design.model.machine)
    known = design.model.size - len(pose.parameters)
    own = OwnParameters.of(Information.of_matrix(before.precision), known)
    precision = design.precision.copy()
    precision[:known, :known] = own.eliminate().matrix
    return replace(design, precision=precision)


def _motion_gram(model: MachineModel, known: PriorEffects) -> NDArray[np.float64]:
    """Gram matrix of known effects that vanish at a standstill.

    The effect of lost motion, a lag or a spike on lines between the corners counts as
    the volumetric error does: else no line would be chosen to determine it.
    """
    gram = np.zeros((model.size, model.size))
    if not known.effects:
        return gram
    machine = model.machine
    path = corner_path(machine, DEFAULT_FEED_MM_MIN, 0.0)
    at = predict_cells(machine, path, assume_stations_mm(machine)[0]).at
    still = make_standstill(machine, at.position_mm, at.offset_mm)
    for effect in known.effects:
        if not effect.jacobian(still).any():
            part = model.slices[effect.name]
            columns = effect.jacobian(at)
            gram[part, part] = np.einsum("nip,niq->pq", columns, columns) / len(at)
    return gram


def _pose_of(machine: Machine) -> TrackerPose:
    """Its turn is about the middle of the volume."""
    middle = np.array([[0.5 * (axis.low + axis.high) for axis in machine.axes]])
    x, y, z = (float(v) for v in make_standstill(machine, middle).point_mm[0])
    return TrackerPose((x, y, z))


def _expect_noise(noise: NoiseModel, rate_hz: float) -> ExpectedNoise:
    """All noise as white: over seconds the correlated part averages too."""
    beam, across = (
        white**2 / rate_hz + 2.0 * noise.ou_time_s * ou**2
        for white, ou in zip(noise.white, noise.ou_along_and_across, strict=True)
    )
    return ExpectedNoise((beam, across), noise.along_sigma_mm**2 * _JITTER_CELL_S)
