"""What an estimator of machines with rotary axes finds that is told noise and prior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from information_bound import true_noise

from app.alignment.observations import Observations
from app.estimation.batch import Estimate
from app.estimation.design_matrix import linearise
from app.estimation.information import compute_posterior
from app.estimation.normal_equations import compute_information
from app.files.model_file import EstimatedModel
from app.kinematics.coarse_model import build_run_models
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel
from simulators import synthetic
from simulators.machine_file import MachineFile
from simulators.truth_machine import TruthMachine, random_machine

SHAPES = 8  # of an error motion here: four harmonics, a sine and a cosine each
DRAWS = 200  # of machines of the same make, for what the ideal estimator knows


def estimate_ideally(
    seen: Observations, found: Estimate, machine: MachineFile, truth: TruthMachine
) -> tuple[EstimatedModel, EstimatedModel]:
    """Return what estimators find that are told noise and prior.

    How large slopes, angles and places of axes are on machines of this make, and how
    strongly each error motion bends: the first on this machine, the second on those.
    """
    nested = build_run_models(seen.at.machine, [seen.at.offset_mm]).nested
    model = nested.alone.with_confounded(nested.confounded)
    about = linearise(seen, model, found.runs[0].pose, true_noise(synthetic.Air()))
    data = compute_information(seen, about)
    drawn = [random_machine(machine, 10_000 + k) for k in range(DRAWS)]
    size, told = model.size, []
    for known in (truth, None):
        precision = np.zeros((len(data.vector),) * 2)
        precision[:size, :size] = know_prior(model, drawn, known)
        best = compute_posterior(data, precision)
        parts = best.theta[:size], best.covariance[:size, :size]
        told.append(EstimatedModel(model, *parts))
    return told[0], told[1]


def know_prior(
    model: MachineModel, drawn: Sequence[TruthMachine], known: TruthMachine | None
) -> np.ndarray:
    """Return the prior precision of machines like those drawn.

    known : machine whose own bends are known; those of the make where it is None
    """
    precision = np.zeros((model.size, model.size))
    motions = [m.error_motions() for m in drawn]
    numbers = [read_numbers(m) for m in drawn]
    for effect in model.effects:
        part = model.slices[effect.name]
        charge = effect.prior()
        if isinstance(effect, ErrorMotion):
            s = np.linspace(effect.axis.low, effect.axis.high, 101)
            shapes = np.linalg.pinv(effect.rows(s))
            form = charge.form
            free = np.diag(form) < 1e-9 * np.diag(form).max()
            square = np.mean([(shapes @ m[effect.name].at(s)) ** 2 for m in motions], 0)
            own = square
            if known is not None:
                own = (shapes @ known.error_motions()[effect.name].at(s)) ** 2
            energy = np.sort(own * np.diag(form))[-SHAPES:].mean()
            precision[part, part] = form / energy
            precision[part, part] += np.diag(np.where(free, 1.0 / square, 0.0))
        elif charge:
            precision[part, part] = charge.form
        else:
            square = np.mean([n[effect.name] ** 2 for n in numbers])
            precision[part, part] = 1.0 / square
    return precision


def read_numbers(truth: TruthMachine) -> dict[str, float]:
    """Return squarenesses and places of rotary axes."""
    return {**truth.squareness_rad, **truth.locations()}
