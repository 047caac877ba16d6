"""All lines of a measurement in progress examined together, as after it.

Cells and lines that the rest contradicts are excluded, and at a step of the set-up the
Run is split (`run_segments`). Data between both sides of a known step are not
used: its moment is not known to the cell, and one wrong cell at a large step would bend
all the rest.

Each part, and each Run of the measurement that this one continues, has a separate pose,
which is integrated out; the rest is information on the machine, and adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np
from jaxtyping import Float64

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.errors import Unidentifiable
from truepath.estimation.checks.lack_of_fit import LackOfFit, assess_lack_of_fit
from truepath.estimation.checks.run_segments import (
    RunSegment,
    SetupShift,
    add_range_step,
    list_new_offsets,
    list_range_steps,
    measure_setup_shift,
    remove_plainest,
    split_at_step,
)
from truepath.estimation.checks.setup_shifts import RANGE
from truepath.estimation.live.innovation_gate import LineGate, LiveCheck
from truepath.estimation.noise.noise_fit import (
    estimate_residual_noise,
    guess_noise,
    refine_runs,
)
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import (
    Information,
    Posterior,
    add_information,
    compute_posterior,
)
from truepath.estimation.problem.knots import merge_cells
from truepath.estimation.problem.noise import (
    NoiseModel,
    assume_typical_noise,
    compute_places_um,
    expected_rms_mm,
)
from truepath.estimation.problem.normal_equations import (
    RunInformation,
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior import BendingPrior
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.files.bundle.run import Run
from truepath.kinematics.coarse_model import build_coarse_model
from truepath.kinematics.effects.base import QuadraticPrior
from truepath.kinematics.effects.instrument import RangeStep, list_instrument_errors
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Commanded, select_rows
from truepath.numerics.rigid import RigidTransform

_ROUNDS = 3


@dataclass(frozen=True)
class SegmentCheck:
    """Parts of a Run between steps of the set-up, as far as noise explains them.

    runs : information from the retained cells of each part; result : of the machine
    """

    parts: tuple[RunSegment, ...]
    runs: tuple[RunInformation, ...]
    result: Posterior
    misfits: tuple[LackOfFit, ...]

    @property
    def main(self) -> int:
        return max(range(len(self.parts)), key=lambda k: len(self.parts[k].seen))

    def restore(self, part: int) -> Float64[np.ndarray, " p"]:
        return self.runs[part].own.restore(self.result)[0]

    def find_pose(self, part: int) -> RigidTransform:
        return self.runs[part].linearisation.correct_pose(self.restore(part))

    def _list_setup_shifts(self) -> tuple[SetupShift, ...]:
        poses = [self.find_pose(k) for k in range(len(self.parts))]
        centres = [part.seen.at.point_mm.mean(axis=0) for part in self.parts]
        setup_shifts = [
            measure_setup_shift(
                (self.parts[k - 1], self.parts[k]),
                (poses[k - 1], poses[k]),
                0.5 * (centres[k - 1] + centres[k]),
            )
            for k in range(1, len(self.parts))
        ]
        model = self.runs[0].linearisation.machine_model
        setup_shifts += list_new_offsets(self.parts, model, self.result.theta)
        return tuple(sorted(setup_shifts, key=lambda shift: shift.time_s))

    def estimate_noise(self, start: NoiseModel) -> NoiseModel:
        run = self.runs[self.main]
        about = replace(run.linearisation, noise=start)
        return estimate_residual_noise(run.observations, about, self.restore(self.main))

    def sum_up_earlier(
        self, model: MachineModel, noise: NoiseModel, weak: Float64[np.ndarray, "6"]
    ) -> Information:
        inputs = [
            RunInput(part.seen, self.find_pose(k), noise)
            for k, part in enumerate(self.parts[:-1])
        ]
        return sum_up_runs(inputs, model, weak)

    def to_live_check(self, noise: NoiseModel) -> LiveCheck:
        """Exclusions, steps and residuals; `noise` is the estimated one."""
        run, misfit = self.runs[self.main], self.misfits[self.main]
        seen = run.observations
        travel = run.travel
        counted = misfit.off_mm[~seen.is_ramp]
        rms_mm = float(np.sqrt(np.mean(counted**2) / 3.0)) if len(counted) else 0.0
        usual_mm = expected_rms_mm(seen, noise.typical_with_places, travel)
        distance_mm = float(np.linalg.norm(seen.tracker_mm, axis=1).mean())
        place_um = compute_places_um(seen.at.machine.tracker, distance_mm, noise)
        return LiveCheck(
            tuple(each for part in self.parts for each in part.seen.left_out),
            self._list_setup_shifts(),
            residual=max(rms_mm, expected_rms_mm(seen, noise, travel)) / usual_mm,
            white=max(noise.white),
            place=max(noise.place),
            place_um=tuple(place_um),
        )

    def start_gate(self, given: Observations) -> LineGate:
        """Gate for the next lines.

        given : all lines; the newest ones that were excluded entirely count as held
        """
        kept = {int(row) for part in self.parts for row in part.seen.row}
        rows = [int(given.row[first]) for first, _ in given.lines]
        held = list(takewhile(lambda row: row not in kept, reversed(rows)))
        off_mm = [
            each.off_mm
            for part in self.parts
            for each in part.seen.left_out
            if each.row in held
        ]
        return LineGate(
            tuple(self.misfits[self.main].line.tolist()),
            len(given),
            tuple(sorted(set(held))),
            max(off_mm, default=0.0),
        )


def check_parts(
    seen: Observations,
    setup_shifts: Sequence[SetupShift],
    pose: RigidTransform,
    noise: NoiseModel,
    prior: BendingPrior,
    known: PriorEffects,
    weak: Float64[np.ndarray, "6"],
) -> SegmentCheck:
    """Parts of a Run without what the rest of it contradicts.

    setup_shifts : steps known so far
    prior : proper, of the machine's model; known : effects in it
    weak : precision of the pose that keeps it finite
    """
    noise = assume_typical_noise(noise)

    def solve(parts: Sequence[RunSegment]) -> SegmentCheck:
        extended = _extend_prior(prior, list_range_steps(parts))
        model = extended.model
        inputs = [RunInput(part.seen, pose, noise) for part in parts]
        runs = collect_parts(inputs, model, weak)
        data = known.add_to(combine_runs(runs), model)
        result = compute_posterior(data, extended.precision_matrix(model.size))
        fit = Fit("constant", model, runs, runs, known, extended, result, 0.0)
        misfits = tuple(
            assess_lack_of_fit(fit, k, names=True) for k in range(len(runs))
        )
        return SegmentCheck(tuple(parts), runs, result, misfits)

    found = solve(split_at(seen, setup_shifts))
    for _ in range(_ROUNDS):
        fewer = remove_plainest(
            found.parts, [part.seen for part in found.parts], found.misfits
        )
        if fewer is None or not all(len(part.seen) for part in fewer):
            break  # nothing contradicts, or nothing would be left
        try:
            found = solve(fewer)
        except Unidentifiable:
            break  # too little would be left
    return found


def _extend_prior(prior: BendingPrior, steps: Sequence[RangeStep]) -> BendingPrior:
    return replace(
        prior,
        model=prior.model.with_effects(*steps),
        penalties={**prior.penalties, **{step.name: step.prior() for step in steps}},
        precision={**prior.precision, **{step.name: 1.0 for step in steps}},
    )


def list_at_setup_shifts(
    excluded: Sequence[LeftOut], check: LiveCheck
) -> list[LeftOut]:
    """Earlier exclusions within a step's interval, not examined again."""
    return [
        each
        for each in excluded
        for first_s, last_s in (shift.between_s for shift in check.setup_shifts)
        if first_s < each.begin_s < last_s and each not in check.left_out
    ]


def weaken_prior(prior: BendingPrior, weak: Float64[np.ndarray, " p"]) -> BendingPrior:
    """Prior plus weak precisions, all of them fixed."""
    penalties, precision = dict(prior.penalties), dict(prior.precision)
    for effect in prior.model.effects:
        form = np.diag(weak[prior.model.slices[effect.name]])
        if own := prior.penalties.get(effect.name):
            form = form + prior.precision[effect.name] * own.form
        penalties[effect.name] = QuadraticPrior(form, len(form), 1.0, is_known=True)
        precision[effect.name] = 1.0
    return replace(prior, penalties=penalties, precision=precision)


def split_at(
    seen: Observations, setup_shifts: Sequence[SetupShift]
) -> list[RunSegment]:
    parts = [RunSegment(0, seen)]
    for shift in setup_shifts:
        time_s = parts[-1].seen.at.time_s
        before = int(np.searchsorted(time_s, shift.between_s[0], side="right"))
        after = int(np.searchsorted(time_s, shift.between_s[1]))
        if not 0 < before <= after < len(time_s):
            continue
        if shift.kind == RANGE:
            parts[-1] = add_range_step(parts[-1], before, after, shift.time_s)
        else:
            first, second = split_at_step(parts[-1], before, after, shift.time_s)
            parts[-1:] = [first, replace(second, kind=shift.kind)]
    return parts


def collect_parts(
    inputs: Sequence[RunInput], model: MachineModel, weak: Float64[np.ndarray, "6"]
) -> tuple[RunInformation, ...]:
    """Information from parts of a Run, with a weak prior on their poses."""
    own = np.concatenate([np.zeros(model.size), weak])
    return tuple(
        replace(
            run,
            data=replace(run.data, matrix=run.data.matrix + np.diag(own)),
            weak=weak,
        )
        for run in collect_information(inputs, model)
    )


@dataclass(frozen=True, slots=True)
class PreviousRun:
    """A Run that was closed or interrupted before the current one.

    executed : its rows up to the last that was measured; rows : those measured
    """

    executed: Commanded
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
    nothing = Information.nothing(model.size)
    found = collect_parts(inputs, model, weak)
    return add_information([nothing, *(run.own.eliminate() for run in found)])


def refine_previous_run(
    seen: Observations,
    model: MachineModel,
    known: PriorEffects,
    *,
    perpendicular_only: bool,
) -> RunInput:
    """Cells merged for the model, with refined pose and noise."""
    (cells,) = merge_cells([seen], model)
    guess = guess_noise(cells, perpendicular_only=perpendicular_only)
    start = RunInput(cells, cells.pose, guess)
    at, errors = cells.at, list_instrument_errors([cells.at])
    coarse = build_coarse_model(at.machine, [at.offset_mm], known.effects, errors)
    try:
        return refine_runs(coarse, (start,), known)[0]
    except Unidentifiable:  # too few lines to determine it: typical noise
        return RunInput(cells, cells.pose, assume_typical_noise(guess))
