"""From Runs to the effects missing in their model: prepare, search, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truepath.alignment.align import align
from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import CELL_MM
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.discovery.findings import (
    Finding,
    Gap,
    measure_gap,
    state_findings,
    state_possible,
)
from truepath.discovery.name_trial import NameTrial, TriedNames, is_open
from truepath.discovery.residual_location import RunResidual, locate_residual
from truepath.discovery.term_fitter import TermFit, TermFitter
from truepath.discovery.term_search import TermSearch
from truepath.discovery.terms.cross_validation import build_lines
from truepath.discovery.undetermined import Undetermined, find_undetermined
from truepath.estimation.noise.baseline import (
    Baseline,
    fit_baseline,
    refit_noise,
)
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.run import Run, list_locks_s
from truepath.kinematics.coarse_model import build_baseline_models
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.candidate_term import propose_terms
from truepath.kinematics.effects.family import list_families
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.progress import ShareProgress, ignore_progress

FINE_CELL_MM = 3.0  # a wave of 6 mm keeps two thirds of its height
_MOST_CELLS = 12_000  # of all Runs: memory and time grow with them


@dataclass(frozen=True)
class AlignedRun:
    """A Run in fine and coarse cells, both with their surroundings."""

    run: Run
    observations: Observations
    coarse: Observations

    @property
    def at(self) -> Conditions:
        """Conditions of the fine cells."""
        return self.observations.at


def align_runs(runs: Sequence[Run]) -> tuple[AlignedRun, ...]:
    """Align Runs in fine and in coarse cells.

    Raises AlignmentError if stream and path of a Run do not belong together.
    """
    cell_mm = max(FINE_CELL_MM, sum(map(_measure_way, runs)) / _MOST_CELLS)
    return tuple(
        AlignedRun(
            run,
            _add_surroundings(run, align(run, cell_mm=cell_mm), number),
            _add_surroundings(run, align(run, cell_mm=max(CELL_MM, cell_mm)), number),
        )
        for number, run in enumerate(runs)
    )


def _measure_way(run: Run) -> float:
    linear = {axis.name for axis in run.machine.linear_axes}
    columns = [name in linear for name in run.commanded.axes]
    steps = np.diff(run.commanded.position[:, columns], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _exclude_unlike(run: Run, observations: Observations) -> Observations:
    """Ramps are excluded, unless the Run has nothing else: effects of acceleration
    would pass for effects of position and speed. So is the first point of a standstill
    Run, and the standstill before a path: its direction of approach is unknown, and an
    axis with play stops elsewhere from either side.
    """
    if run.mode == "standstill":
        return observations.select(np.flatnonzero(observations.row > 0))
    if any(each.is_steady for each in observations.passes):
        observations = observations.exclude_ramps()
    has_moved = (observations.at.approach != 0.0).any(axis=1)
    return observations.select(np.flatnonzero(has_moved))


def _add_surroundings(
    run: Run, observations: Observations, number: int
) -> Observations:
    observations = _exclude_unlike(run, observations)
    return add_surroundings(
        observations,
        run.commanded,
        run.temperature,
        number,
        list_locks_s(run.tracker),
    )


@dataclass(frozen=True)
class Discovery:
    """Effects missing in the model, with their evidence and residuals.

    aligned : each Run, with the tracker's pose of the baseline
    fitter : fits other terms to the Runs
    baseline_fit, fit : of the baseline alone, and with the terms found
    findings : accepted, greatest evidence first; possible : names that are not
    tried : the decision between these
    undetermined : names that the Runs would not tell, clearest first
    residuals : of each Run, before and after, and where they are
    """

    aligned: tuple[AlignedRun, ...]
    baseline: Baseline
    fitter: TermFitter
    baseline_fit: TermFit
    fit: TermFit
    findings: tuple[Finding, ...]
    possible: tuple[Finding, ...]
    tried: TriedNames
    gap: Gap
    residuals: tuple[RunResidual, ...]
    undetermined: tuple[Undetermined, ...] = ()

    @property
    def run_names(self) -> str:
        """Names of the Runs in one line."""
        return ", ".join(aligned.run.name for aligned in self.aligned)

    @property
    def leaves_gap(self) -> bool:
        """True if held-out lines are predicted worse than by a complete model."""
        return is_open(self.fit)

    @property
    def compared(self) -> int:
        """Number of effects in the catalogue searched."""
        return len(self.fitter.catalogue)


def discover(
    runs: Sequence[Run],
    reference: EstimatedModel | None = None,
    on_progress: ShareProgress = ignore_progress,
) -> Discovery:
    """Search for the effects missing in the model of Runs.

    runs : of one machine, each with separate tracker pose, timing and noise
    reference : the model; None fits the rigid-body model to the Runs

    Raises AlignmentError, EstimationError if the Runs cannot be fitted at all,
    BundleError if they are not of one machine.
    """
    aligned = align_runs(runs)
    on_progress(0.05)
    machine = one_machine([run.machine for run in runs], [run.name for run in runs])
    fine = [one.observations for one in aligned]
    coarse = [one.coarse for one in aligned]
    at = [one.at for one in fine]
    families = [f for f in list_families(at) if reference or not f.is_rigid_body]
    terms = tuple(propose_terms(families, at))
    nested, noise_model = build_baseline_models(
        machine, [one.at for one in coarse], reference and reference.model
    )
    baseline = fit_baseline(nested, noise_model, coarse, reference)
    on_progress(0.35)
    # An effect that the model lacks makes places differ: it is looked for beside less.
    quiet = baseline.limit_place_noise()
    lines = build_lines(runs, fine, quiet)
    fitter = TermFitter(lines, quiet.prior, terms)
    search = TermSearch(fitter)
    best = search.find_largest()
    on_progress(0.6)
    if best.terms or quiet is not baseline:
        # What the effects caused is no longer counted as noise.
        if best.terms:
            baseline = refit_noise(baseline, [t.effect for t in best.terms])
        lines = build_lines(runs, fine, baseline)
        fitter = fitter.use_lines(lines, baseline.prior)
        search = TermSearch(fitter)
        best = search.select_terms(best.terms)
    on_progress(0.8)
    return _state(aligned, baseline, fitter, NameTrial(fitter, search).assess(best))


def _state(
    aligned: tuple[AlignedRun, ...],
    baseline: Baseline,
    fitter: TermFitter,
    tried: TriedNames,
) -> Discovery:
    best = tried.fit
    without = fitter.fit([])
    findings = state_findings(fitter, without, tried)
    possible = state_possible(fitter, without, tried)
    each = zip(
        fitter.run_data, fitter.residuals(without), fitter.residuals(best), strict=True
    )
    residuals = tuple(
        RunResidual(
            run.observations,
            locate_residual(run.observations, before.residual_mm),
            locate_residual(run.observations, after.residual_mm),
        )
        for run, before, after in each
    )
    named = {
        candidate.label
        for one in (*findings, *possible)
        for candidate in (one.candidate, *one.alternatives)
    }
    undetermined = find_undetermined(fitter, best, named)
    gap = measure_gap(fitter.run_data, without, best)
    aligned = tuple(
        replace(one, observations=run.observations)
        for one, run in zip(aligned, fitter.run_data, strict=True)
    )
    return Discovery(
        aligned,
        baseline,
        fitter,
        without,
        best,
        findings,
        possible,
        tried,
        gap,
        residuals,
        undetermined,
    )
