"""The estimate of a measurement that is still in progress.

Every finished line or standstill is added to the normal equations, which hold for one
linearisation and one noise model. Both are updated whenever the number of lines has
doubled, and at the end: then all cells are added again, so that the mean cost is at
most a second addition of each.

Lines that contradict the rest are held back (`innovation_gate`, `segment_check`). Where
the set-up has moved, the earlier data remain as information on the machine, their pose
integrated out.

A weak prior keeps tables finite before the lines determine them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.cell_blocks import CellBlock
from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.alignment.streaming import PointAlignment, StreamingAlignment
from truepath.errors import Unidentifiable
from truepath.estimation.checks.change_detection import ChangeWatch, Notice
from truepath.estimation.checks.run_segments import RunSegment, list_range_steps
from truepath.estimation.live.innovation_gate import LineGate, LiveCheck
from truepath.estimation.live.live_model import (
    LiveEstimate,
    LiveFindings,
    LiveModel,
    list_live_errors,
)
from truepath.estimation.live.segment_check import (
    PreviousRun,
    check_parts,
    list_at_setup_shifts,
    refine_previous_run,
    sum_up_runs,
    weaken_prior,
)
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.estimation.problem.information import (
    Information,
    Posterior,
    add_information,
)
from truepath.estimation.problem.knots import add_hidden_variance, merge_cells
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.normal_equations import RecursiveEstimator, RunInput
from truepath.estimation.problem.prior import widen_by_unknown_precision
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.files.bundle.run import PointBlock, list_locks_s
from truepath.kinematics.coarse_model import build_coarse_model
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.numerics.rigid import RigidTransform
from truepath_drivers.interfaces.records import Path, TrackerSamples

_FIRST_EXAMINATION = 4  # stretches before pose and noise are first refined
_FEWEST_TO_PREDICT = 8  # lines or points; fewer predict the next too poorly
_HELD = 3  # lines in a row that do not fit, or 6, 12 …: examine all lines together


class LiveEstimator:
    """Consumes samples or points in blocks, gives the estimate so far. One thread.

    known : effects known from an earlier measurement, estimated too; those that depend
        on temperatures wait for the analysis of the Run, which has them
    earlier : Runs of the measurement that it continues
    """

    def __init__(
        self,
        machine: Machine,
        commanded: Commanded,
        *,
        perpendicular_only: bool = False,
        known: PriorEffects | None = None,
        earlier: Sequence[PreviousRun] = (),
    ) -> None:
        self._machine, self._commanded = machine, commanded
        self._known = known or PriorEffects()
        self._alignment: StreamingAlignment | PointAlignment
        self._alignment = StreamingAlignment(machine, commanded)
        self._perpendicular_only = perpendicular_only
        self._model = LiveModel.start(machine, commanded, self._known)
        self._prior = self._model.guess_prior()
        self._earlier = self._runs = self._model.zero_information
        self._seats = self._alignment.seats  # of the linearisation
        self._parts: list[CellBlock] = []
        self._sums: RecursiveEstimator | None = None
        self._watch = ChangeWatch(has_lines=isinstance(commanded, Path))
        self._inputs = [
            refine_previous_run(
                each.seen,
                self._model.full_model,
                self._known,
                perpendicular_only=perpendicular_only,
            )
            for each in earlier
        ]
        self._tail, self._locks_s = TrackerSamples.empty(), list[float]()
        self._pose: RigidTransform | None = None  # at the last refinement
        self._predicted: Posterior | None = None  # from the present sums
        self._rows: frozenset[int] = frozenset()
        self._check, self._gate = LiveCheck(), LineGate()
        self._unmatched_s = -np.inf  # time of the last standstill off the path
        self._next_examination = _FIRST_EXAMINATION  # at so many stretches

    def extend(self, commanded: Commanded) -> None:
        """Further rows; the earlier ones are among them, unchanged."""
        self._commanded = commanded
        self._alignment.extend(commanded)

    def findings(self) -> LiveFindings | None:
        """Inputs of a plan of further rows, None before the pose is known.

        Call `estimate` first: it finds the precisions of the prior.
        """
        if self._sums is None:
            return None
        about = self._sums.linearisation
        station_mm = about.pose.invert().translation_mm
        tracker = {e.name for e in self._model.added if is_tracker_error(e)}
        known = self._prior.determined.precision
        precision = {name: known[name] for name in known.keys() - tracker}
        return LiveFindings(self._rows, station_mm, about.noise, precision)

    def find_commanded_mm(self) -> Float64[np.ndarray, "w 3"] | None:
        """Expected position of each row of a path, tracker's frame.

        From the standstills so far; after a step of the set-up, from those since then.
        None for points, and where `locate_rows` has none.
        """
        seen = self._alignment
        if not isinstance(self._commanded, Path):
            return None
        if not isinstance(seen, StreamingAlignment):
            return None
        since_s = max(
            (shift.time_s for shift in self._check.setup_shifts),
            default=-np.inf,
        )
        return seen.locate_rows(since_s)

    def add_block(self, block: TrackerSamples | PointBlock) -> bool:
        """Next samples or points; True if they finished a line or point.

        Also True if the target was at rest at a further point that matches none. All
        blocks of a measurement are of one kind.
        """
        is_stream = isinstance(block, TrackerSamples)
        samples = block if is_stream else block.samples
        tail = TrackerSamples.join([self._tail, samples])
        self._locks_s += list_locks_s(tail)
        seen = np.flatnonzero(tail.status == 0)
        self._tail = tail.select(slice(seen[-1] if len(seen) else len(tail), None))
        if is_stream:
            assert isinstance(self._alignment, StreamingAlignment)  # noqa: S101
            return self._add(self._alignment.add(block)) or self._is_off_path()
        if not isinstance(self._alignment, PointAlignment):
            self._alignment = PointAlignment(self._machine, self._commanded)
            self._seats = self._alignment.seats
        return self._add(self._alignment.add(block)) or self._is_off_path()

    def finish(self) -> bool:
        """End of data: pose and noise are refined with all of it.

        False without any line.
        """
        self._add(self._alignment.finish())
        if not self._parts:
            return False
        self._reexamine(thoroughly=True)
        return True

    def estimate(self) -> LiveEstimate | None:
        """Estimate from the lines so far, None before the pose is known."""
        if self._sums is None:
            return None
        model = self._model.full_model
        size = model.size
        data = self._add_known(self._sums.information())
        self._prior, result = self._prior.fit(data)
        prior = self._prior.full
        widened = widen_by_unknown_precision(prior, result)
        hidden = add_hidden_variance(widened, model, prior.precision)
        self._predicted, covariance = hidden, hidden.covariance[:size, :size]
        mean_square = self._model.mean_square_mm2(covariance)
        unmatched = self._alignment.list_unmatched()
        return LiveEstimate(
            model,
            result.theta[:size],
            covariance,
            float(np.sqrt(max(mean_square, 0.0))),
            len(self._rows),
            self._check.cells,
            float(self._parts[-1].cells.time_s[-1]),
            replace(self._check, left_out=(*self._check.left_out, *unmatched)),
        )

    def _is_off_path(self) -> bool:
        before_s = self._unmatched_s
        for each in self._alignment.list_unmatched()[-1:]:
            self._unmatched_s = each.end_s
        return self._unmatched_s > before_s and self._sums is not None

    def list_notices(self) -> tuple[Notice, ...]:
        if self._sums is None:
            return ()
        model, weak = self._model, self._model.weak
        prior = self._prior.precision_matrix(len(weak)) + np.diag(weak)
        known = self._known.add_to(Information.of_matrix(prior), model.full_model)
        known = known.select(self._sums.linearisation.select_columns(model.watched))
        time_s = float(self._parts[-1].cells.time_s[-1])
        return self._watch.list_notices(known, time_s)

    def _find_rows(self, seen: Observations) -> frozenset[int]:
        """The standstill at the end of a lost line is no line."""
        is_path = isinstance(self._commanded, Path)
        counted = (seen.at.line >= 0) | (not is_path)
        return frozenset(seen.row[counted].tolist())

    def _add(self, parts: list[CellBlock]) -> bool:
        if not parts:
            return False
        self._parts += parts
        held, moved = len(self._gate.held), self._seats is not self._alignment.seats
        moved = moved or len(self._locks_s) > self._model.most_locks
        if self._sums is None or moved or len(self._parts) >= self._next_examination:
            self._reexamine()
        else:
            self._add_gated_lines(self._sums, self._observations(parts))
            rounds, rest = divmod(len(self._gate.held), _HELD)
            if len(self._gate.held) > held and not rest and rounds.bit_count() == 1:
                self._reexamine()
        return True

    def _add_gated_lines(self, sums: RecursiveEstimator, seen: Observations) -> None:
        if self._predicted is None:
            self.estimate()
        assert self._predicted is not None  # noqa: S101 (the estimate has set it)
        excluded, used, cells = [*self._check.left_out, *seen.left_out], 0, 0
        for first, last in seen.lines:
            whole = line = replace(seen.select(np.arange(first, last)), left_out=())
            if len(self._rows) >= _FEWEST_TO_PREDICT:
                about = sums.linearisation
                self._gate, line = self._gate.check(about, self._predicted, line)
            excluded += line.left_out
            self._watch.add(line if len(line) else whole)
            if len(line):
                sums = sums.add(line)
                self._rows |= self._find_rows(line)
                used, cells = used + int(line.count.sum()), cells + len(line)
        self._sums = sums
        self._check = replace(
            self._check,
            left_out=tuple(excluded),
            used_samples=self._check.used_samples + used,
            cells=self._check.cells + cells,
            held=self._gate.held,
            held_mm=self._gate.held_mm,
        )

    def _observations(self, parts: list[CellBlock]) -> Observations:
        seen = self._alignment.observations(parts)
        seen = replace(seen, pose=self._pose or seen.pose)
        seen = add_surroundings(seen, self._commanded, locks_s=self._locks_s)
        (cells,) = merge_cells([seen], self._model.full_model)
        return cells

    def _set_instrument_errors(self, *errors: Effect) -> None:
        self._model = replace(self._model, added=errors)
        self._prior = self._model.guess_prior(self._prior)
        self._earlier = self._model.zero_information
        whole, weak = self._model.full_model, self._model.weak
        self._runs = sum_up_runs(self._inputs, whole, weak[-6:])

    def _add_known(self, data: Information) -> Information:
        size, weak = self._model.full_model.size, self._model.weak
        matrix, vector = data.matrix + np.diag(weak), data.vector.copy()
        before = add_information([self._earlier, self._runs])
        matrix[:size, :size] += before.matrix
        vector[:size] += before.vector
        square = data.square + before.square
        data = replace(data, matrix=matrix, vector=vector, square=square)
        return self._known.add_to(data, self._model.full_model)

    def _reexamine(self, *, thoroughly: bool = False) -> None:
        """Relinearises about the newest pose and noise, and adds all cells again.

        thoroughly : estimate the noise as the batch does, which is slow
        """
        self._seats, self._pose = self._alignment.seats, self._alignment.pose
        seen = self._observations(self._parts)
        others = [each.observations.at for each in self._inputs]
        errors = [*list_live_errors(seen.at, others)]
        self._set_instrument_errors(*errors)
        noise = guess_noise(seen, perpendicular_only=self._perpendicular_only)
        known = self._check.setup_shifts
        parts, pose = [RunSegment(0, seen)], seen.pose
        check, self._gate = LiveCheck(left_out=seen.left_out), LineGate()
        if len(self._parts) >= _FIRST_EXAMINATION:
            if self._sums is not None:
                noise = replace(self._sums.linearisation.noise, white=noise.white)
            between_places = any(noise.place)
            if between_places:  # before anything is called an outlier
                noise = _refine_noise(seen, pose, noise, self._known, errors)
            prior = weaken_prior(self._prior.determined, self._model.weak)
            weak = self._model.weak[-6:]
            found = check_parts(seen, known, pose, noise, prior, self._known, weak)
            parts = [*found.parts]
            if not between_places:  # few places: what the estimate absorbs counts
                noise = found.estimate_noise(noise)
            if steps := list_range_steps(parts):
                errors += steps
                self._set_instrument_errors(*errors)
            if thoroughly or between_places:
                main = found.parts[found.main].seen
                own = found.find_pose(found.main)
                noise = _refine_noise(main, own, noise, self._known, errors)
            pose = found.find_pose(len(parts) - 1)
            check, self._gate = found.to_live_check(noise), found.start_gate(seen)
            excluded = list_at_setup_shifts(self._check.left_out, check)
            check = replace(check, left_out=(*check.left_out, *excluded))
            self._earlier = found.sum_up_earlier(self._model.full_model, noise, weak)
            newest = int(parts[-1].seen.row.min())
            fresh = sum(part.row >= newest for part in self._parts)
            self._next_examination = len(self._parts) + max(fresh, _FIRST_EXAMINATION)
        model = self._model
        about = Linearisation(model.full_model, model.tracker, pose, noise)
        self._sums = RecursiveEstimator.start(about).add(parts[-1].seen)
        withheld = seen.select(np.flatnonzero(np.isin(seen.row, self._gate.held)))
        watched = about.restrict(model.watched)
        self._watch.start_again(watched, [*(part.seen for part in parts), withheld])
        self._rows = frozenset[int]().union(*(self._find_rows(p.seen) for p in parts))
        self._predicted = None  # it referred to the previous pose
        self._check = replace(
            check,
            used_samples=sum(int(part.seen.count.sum()) for part in parts),
            cells=sum(len(part.seen) for part in parts),
            held=self._gate.held,
            held_mm=self._gate.held_mm,
        )


def _refine_noise(
    observations: Observations,
    pose: RigidTransform,
    noise: NoiseModel,
    known: PriorEffects,
    errors: Sequence[Effect],
) -> NoiseModel:
    run, at = RunInput(observations, pose, noise), observations.at
    model = build_coarse_model(at.machine, [at.offset_mm], known.effects, errors)
    try:
        return refine_runs(model, (run,), known)[0].noise
    except Unidentifiable:
        return noise  # too few lines to judge it better
