"""What a measurement cannot tell, by name: singular values of the whitened problem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from app.estimation.estimate import Observability
from app.estimation.poorly_observable import (
    find_poorly_observable,
    usual_precision_matrix,
)
from app.estimation.runs import RunInput, collect_information, combine_runs
from app.estimation.separation import describe_confounded
from app.estimation.volumetric_map import compute_volumetric_gram
from app.kinematics.effects.error_motion import make_error_motion
from app.kinematics.identifiable import build_identifiable_model
from app.kinematics.machine import Machine
from app.kinematics.model import MachineModel

_INTERVALS = 5  # shapes down to a fifth of the travel; finer ones the prior bridges
_UNSEEN = 1e-6  # singular value relative to the largest, columns scaled to one


def assess_observability(machine: Machine, runs: Sequence[RunInput]) -> Observability:
    """Return rank, the named null space, and poorly observable shapes."""
    offsets_mm = [run.observations.at.offset_mm for run in runs]
    model, merged = build_identifiable_model(machine, *offsets_mm, intervals=_INTERVALS)
    found = collect_information(runs, model)
    information = combine_runs(found).matrix
    alone = np.sum([np.diag(run.data.matrix)[: model.size] for run in found], 0)
    scale = 1.0 / np.sqrt(np.maximum(alone, 1e-300))
    value, vector = np.linalg.eigh(information * scale[:, None] * scale)
    blind = value < _UNSEEN**2 * value[-1] + 1e-13
    covariance = np.linalg.inv(information + usual_precision_matrix(model))
    every = np.concatenate(offsets_mm)
    said = describe_confounded(machine, every, merged, model, covariance)
    said += _blind_shapes(model, vector[:, blind] * scale[:, None])
    poor = find_poorly_observable(
        information, model, compute_volumetric_gram(model), blind=False
    )
    return Observability(
        model.size + sum(_shapes(m.symbol, model.machine) for m in merged),
        int(model.size - blind.sum()),
        said,
        tuple(str(shape) for shape in poor),
    )


def _blind_shapes(
    model: MachineModel, shapes: Float64[np.ndarray, "p b"]
) -> tuple[str, ...]:
    """Say which motions take part in shapes that the measured places do not show."""
    count = shapes.shape[1]
    if not count:
        return ()
    usual = np.linalg.norm(shapes) / np.sqrt(len(model.effects))
    part = [
        effect.name
        for effect in model.effects
        if np.linalg.norm(shapes[model.slices[effect.name]]) > 0.1 * usual
    ]
    many = f"{count} common shapes are" if count > 1 else "a common shape is"
    return (
        f"{', '.join(part)}: {many} not seen at the measured places; more lines or "
        "points that are not corner to corner show them",
    )


def _shapes(symbol: str, machine: Machine) -> int:
    """Count the shapes that the gauge leaves to an error motion, or one of an angle."""
    if not symbol.startswith("E"):
        return 1
    axis = machine.axes[machine.axis_names.index(symbol[2])]
    return len(make_error_motion(symbol, axis, _INTERVALS).parameters)
