"""What an ideal test could see of a hidden effect.

The ideal test is told what no real one knows: the noise, how strongly error motions of
each kind bend in this machine, and the effect's very shape, so that only its size is
asked for. What machine, pose, timing and a tracker within its specification can absorb
is taken out first: a sag that looks like a usual angular motion of the guide is one.
The expected log-likelihood ratio between the effect and none is then half the squared
signal-to-noise ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from information_bound import true_noise
from judging import true_parameters
from recordings import run_of

from truepath.alignment.align import align
from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.normal_equations import compute_information
from truepath.files.bundle.run import list_locks_s
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Parameter
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.effects.instrument import (
    is_tracker_error,
    list_instrument_errors,
)
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.worlds.recording import Recording

CELL_MM = 3.0


@dataclass(frozen=True)
class Shape(Effect):
    """What an effect did in each cell of one recording; its size is 1.

    time_s : (n,) of the cells, in order; shift_mm : (n, 3)
    """

    number: int
    time_s: np.ndarray
    shift_mm: np.ndarray

    @property
    def name(self) -> str:
        return f"shape-{self.number}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(self.name, "1"),)

    def jacobian(self, at: Conditions) -> np.ndarray:
        """Return the shift of the cells, which their times tell."""
        return self.shift_mm[np.searchsorted(self.time_s, at.time_s), :, None]


def signal_to_noise(
    recording: Recording, shifts_mm: Sequence[np.ndarray], air: Air
) -> np.ndarray:
    """Return how many standard deviations each effect is away from none.

    recording : with its effects; shifts_mm : what each did to the samples, (m, 3), in
    the tracker's frame. The others are known to be there, but not their sizes.
    """
    run = run_of(recording)
    seen = add_surroundings(
        align(run, cell_mm=CELL_MM),
        run.commanded,
        run.temperature,
        locks_s=list_locks_s(run.tracker),
    )
    motions, _ = build_identifiable_model(run.machine, seen.at.offset_mm)
    model = motions.with_effects(*list_instrument_errors([seen.at]))
    shapes = [
        Shape(k, *_in_cells(recording, seen, shift))
        for k, shift in enumerate(shifts_mm)
    ]
    machine = model.with_effects(*shapes)
    about = linearise(seen, machine, seen.pose, true_noise(air))
    data = compute_information(seen, about).matrix
    truth = true_parameters(model, recording.truth)
    total = data + _usual_precision(model, truth, len(data))
    return np.array(
        [_compute_root_information(total, k) for k in range(model.size, machine.size)]
    )


def _usual_precision(model: MachineModel, truth: np.ndarray, size: int) -> np.ndarray:
    """Return the prior precision of the precision that is usual for each kind."""
    motions = [e for e in model.effects if isinstance(e, ErrorMotion)]
    form = {e.name: e.gauge.T @ e.spline.bending() @ e.gauge for e in motions}
    energy: dict[str, list[float]] = {}
    for motion in motions:
        part = truth[model.slices[motion.name]]
        each = float(part @ form[motion.name] @ part) / (motion.spline.size - 2)
        energy.setdefault(motion.prior().kind, []).append(each)
    total = np.zeros((size, size))
    for effect in filter(is_tracker_error, model.effects):
        part = model.slices[effect.name]
        total[part, part] = np.eye(part.stop - part.start)
    for motion in motions:
        part = model.slices[motion.name]
        usual = float(np.mean(energy[motion.prior().kind]))
        total[part, part] = form[motion.name] / usual
    return total


def _compute_root_information(total: np.ndarray, k: int) -> float:
    """Return the square root of the information on one parameter, all others free."""
    others = np.arange(len(total)) != k
    scale = 1.0 / np.sqrt(np.diag(total)[others])
    known = total[np.ix_(others, others)] * scale[:, None] * scale
    cross = total[others, k] * scale
    return float(np.sqrt(max(total[k, k] - cross @ np.linalg.solve(known, cross), 0.0)))


def _in_cells(
    recording: Recording, seen: Observations, shift_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return times of the cells and mean shifts, in the frame the tracker stands on."""
    table_mm = shift_mm @ recording.pose.rotation.T
    sums = np.vstack([np.zeros(3), np.cumsum(table_mm, axis=0)])
    middle = np.searchsorted(recording.time_s, seen.at.time_s)
    count = seen.count.astype(np.int64)
    first = np.clip(middle - count // 2, 0, len(table_mm) - count)
    mean = (sums[first + count] - sums[first]) / count[:, None]
    order = np.argsort(seen.at.time_s)
    return seen.at.time_s[order], mean[order]
