"""Information from earlier Runs for a measurement that continues them.

Each has a separate pose, which is integrated out; the rest is information on the
machine, and adds to that of the current Run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.errors import Unidentifiable
from truepath.estimation.live.segment_check import collect_parts
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.knots import join_cells
from truepath.estimation.problem.noise import assume_typical_noise
from truepath.estimation.problem.prior_effects import PriorEffects
from truepath.estimation.problem.runs import RunInput
from truepath.files.bundle.run import Run
from truepath.kinematics.coarse_model import build_coarse_model
from truepath.kinematics.effects.instrument import list_instrument_errors
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Commanded, select_rows


@dataclass(frozen=True, slots=True)
class PreviousRun:
    """A Run that was closed or interrupted before the current one.

    driven : its rows up to the last that was measured; rows : those measured
    """

    driven: Commanded
    rows: frozenset[int]
    seen: Observations


def align_earlier(runs: Sequence[Run]) -> tuple[PreviousRun, ...]:
    """Aligned together, in the order given. Raises AlignmentError."""
    return tuple(
        PreviousRun(
            select_rows(run.commanded, slice(max(seen.measured_rows) + 1)),
            seen.measured_rows,
            seen,
        )
        for run, seen in zip(
            runs, align_all(runs, [run.name for run in runs]), strict=True
        )
    )


def sum_up_runs(
    inputs: Sequence[RunInput], model: MachineModel, weak: Float64[np.ndarray, "6"]
) -> Information:
    """Information on a model, summed over Runs, poses integrated out.

    weak : precision of a pose before it is measured
    """
    nothing = Information.of_matrix(np.zeros((model.size, model.size)))
    found = collect_parts(inputs, model, weak)
    return add_information([nothing, *(run.own.eliminate() for run in found)])


def refine_run(
    seen: Observations,
    model: MachineModel,
    known: PriorEffects,
    *,
    perpendicular_only: bool,
) -> RunInput:
    """Cells merged for the model, with refined pose and noise."""
    (cells,) = join_cells([seen], model)
    guess = guess_noise(cells, perpendicular_only=perpendicular_only)
    start = RunInput(cells, cells.pose, guess)
    at, errors = cells.at, list_instrument_errors([cells.at])
    coarse = build_coarse_model(at.machine, [at.offset_mm], known.effects, errors)
    try:
        return refine_runs(coarse, (start,), known)[0]
    except Unidentifiable:  # too few lines to determine it: typical noise
        return RunInput(cells, cells.pose, assume_typical_noise(guess))
