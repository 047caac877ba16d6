"""What one straight line, measured on the fly, tells about a three-axis machine.

The criterion is the integrated variance J = tr(G C): C the covariance of the error
motions, G the Gram matrix of the volumetric error over the travel, rigid motions of the
whole volume left out. A measurement with rows H lowers J by
tr(S⁻¹ (H C) G (H C)ᵀ), S = σ² I + H C Hᵀ.

A line carries its two directions across, and the direction along it less a phase and a
speed, which no shared clock tells. On lines between corners the first two alone leave
positioning shapes that all axes share unseen; lines that end anywhere on the faces do
not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import standstill
from app.kinematics.effects.base import Role
from app.kinematics.effects.error_motion import error_motion, usual_size
from app.kinematics.effects.squareness import squareness_between
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.machine import LinearAxis, Machine, linear_part
from app.kinematics.model import MachineModel
from app.kinematics.symbols import error_motions
from app.numerics.design_criteria import Belief

SIGMA_MM = 0.004  # of a tracker at usual distance
EXPECTED_ERROR_MM = 0.02  # of a usual machine, at the tool
POINTS_A_LINE = 8  # error motions of four intervals bend less often
GRID = 5  # places of each axis that stand for the volume


@dataclass(frozen=True)
class Knowledge:
    """What is known of the machine so far.

    belief : covariance of the model's θ, mm and rad, and G, with θᵀ G θ the mean square
        of the volumetric error over the travel, mm²
    """

    model: MachineModel
    belief: Belief

    def rows(
        self, begin_mm: Float64[np.ndarray, "m 3"], end_mm: Float64[np.ndarray, "m 3"]
    ) -> Float64[np.ndarray, "m r p"]:
        """Return the rows of m lines, in units of the noise."""
        share = (np.arange(POINTS_A_LINE) + 0.5) / POINTS_A_LINE
        at = begin_mm[:, None] + share[None, :, None] * (end_mm - begin_mm)[:, None]
        columns = self.model.jacobian(standstill(self.model.machine, at.reshape(-1, 3)))
        columns = columns.reshape(len(begin_mm), POINTS_A_LINE, 3, -1)
        direction = end_mm - begin_mm
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        along = np.einsum("md,mndp->mnp", direction, columns)
        across = columns - np.einsum("md,mnp->mndp", direction, along)
        law = np.stack([np.ones(POINTS_A_LINE), share], axis=1)
        along = along - law @ (np.linalg.pinv(law) @ along)
        both = np.concatenate([across, along[:, :, None]], axis=2)
        return both.reshape(len(begin_mm), 4 * POINTS_A_LINE, -1) / SIGMA_MM

    def after(self, rows: Float64[np.ndarray, "r p"]) -> Knowledge:
        """Return what is known once these rows are measured."""
        return replace(self, belief=self.belief.after(rows))


def nothing_known(machine: Machine) -> Knowledge:
    """Return the state before the first line. Only the linear axes are looked at."""
    model = _model(linear_part(machine))
    return Knowledge(model, Belief(prior_covariance(model), _gram(model)))


def _model(machine: Machine) -> MachineModel:
    motions = tuple(
        error_motion(symbol, axis, 4)
        for axis in machine.linear_axes
        for symbol in error_motions(axis.name)
    )
    centre = _middle(machine.linear_axes)
    return MachineModel(
        machine,
        (
            *motions,
            *squareness_between(machine.axis_names),
            TrackerPose((float(centre[0]), float(centre[1]), float(centre[2]))),
        ),
    )


def _middle(axes: tuple[LinearAxis, ...]) -> Float64[np.ndarray, " a"]:
    return np.array([(axis.min_mm + axis.max_mm) / 2 for axis in axes])


def _size_mm(machine: Machine) -> float:
    return max(axis.max_mm - axis.min_mm for axis in machine.linear_axes)


def prior_covariance(model: MachineModel) -> Float64[np.ndarray, "p p"]:
    """Expect EXPECTED_ERROR_MM, bent as a wave over the travel, and any pose."""
    size_mm = _size_mm(model.machine)
    scale = [
        EXPECTED_ERROR_MM
        / (size_mm if p.unit == "rad" else 1.0)
        * (1e3 if effect.role is Role.NUISANCE else 1.0)
        for effect in model.effects
        for p in effect.parameters
    ]
    precision = np.diag(np.array(scale) ** -2)
    for effect in model.effects:
        charge = effect.prior()
        if charge is not None:
            at = model.slices[effect.name]
            larger = EXPECTED_ERROR_MM / usual_size("EXX")
            precision[at, at] += charge.form / (larger**2 * charge.usual)
    return np.linalg.inv(precision)


def _gram(model: MachineModel) -> Float64[np.ndarray, "p p"]:
    ticks = [np.linspace(a.min_mm, a.max_mm, GRID) for a in model.machine.linear_axes]
    grid = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    columns = model.jacobian(standstill(model.machine, grid)).reshape(3 * len(grid), -1)
    pose = columns[:, model.slices["tracker-pose"]]
    columns = columns - pose @ (np.linalg.pinv(pose) @ columns)
    return columns.T @ columns / len(grid)
