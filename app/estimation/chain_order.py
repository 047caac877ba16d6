"""Whether the data fit another order of the linear axes than the chain declares.

The order moves no nominal point, only the levers of turns: alignment cannot see it, and
the fit bends, or takes it for an error of the tracker. Only white noise counts here:
correlated noise would take what is wrong for the air's.
"""

from __future__ import annotations

from dataclasses import replace

from truepath.app.estimation.confounded_prior import guess_whole_prior
from truepath.app.estimation.direction import Fit
from truepath.app.estimation.runs import RunInput, collect_information, combine_runs
from truepath.app.kinematics.identifiable import build_identifiable_model
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.other_chains import list_orders

_WHITE = (1.0, 1.0), (1e-3, 1e-3)  # white and correlated, of the tracker's stated noise


def find_better_order(fit: Fit) -> tuple[str, float]:
    """Return the chain that fits best, and by which factor χ² is less than declared."""
    declared = fit.model.machine
    names = [axis.name for axis in declared.linear_axes]
    left = {m.chain: _fit_order(fit, m) for m in list_orders(declared, names)}
    best = min(left, key=lambda chain: left[chain])
    return best, left[declared.chain] / left[best]


def _fit_order(fit: Fit, machine: Machine) -> float:
    inputs: list[RunInput] = []
    for run in fit.runs:
        seen, (white, ou) = run.observations, _WHITE
        seen = replace(seen, at=replace(seen.at, machine=machine))
        noise = replace(run.noise, white=white, ou=ou)
        inputs.append(RunInput(seen, run.linearisation.pose, noise))
    offsets_mm = [each.observations.at.offset_mm for each in inputs]
    model, _ = build_identifiable_model(machine, *offsets_mm)
    data = combine_runs(collect_information(inputs, model))
    return guess_whole_prior(model).fit(data)[1].misfit
