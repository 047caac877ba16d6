"""From Runs to the effects missing in their model: prepare, search, report.

The model extended by the findings has their joint covariance. Effects of the machine
become part of it. Effects of the measurement (drift, a step, the tracker's own errors)
were removed from the numbers and stay with their Run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

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
from truepath.discovery.line_blocks import build_lines
from truepath.discovery.name_trial import NameTrial, TriedNames, is_open
from truepath.discovery.residual_location import RunResidual, locate_residual
from truepath.discovery.term_search import TermFit, TermFitter, TermSearch
from truepath.discovery.undetermined import Undetermined, list_undetermined
from truepath.estimation.noise.baseline import (
    Baseline,
    fit_baseline,
    refit_noise,
)
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.run import Run, list_locks_s
from truepath.kinematics.coarse_model import build_baseline_models
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.effects.family import list_families, propose_terms
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import EstimatedModel, MachineModel, restore_effect
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


def _add_surroundings(
    run: Run, observations: Observations, number: int
) -> Observations:
    """Ramps are excluded, unless the Run has nothing else: effects of acceleration
    would pass for effects of position and speed. So is the first point of a standstill
    Run, and the standstill before a path: its direction of approach is unknown, and an
    axis with play stops elsewhere from either side.
    """
    if run.mode == "standstill":
        is_kept = observations.row > 0
    else:
        if any(each.is_steady for each in observations.passes):
            observations = observations.exclude_ramps()
        is_kept = (observations.at.approach != 0.0).any(axis=1)
    observations = observations.select(np.flatnonzero(is_kept))
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
    undetermined : names that the Runs would not determine, clearest first
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
        return ", ".join(aligned.run.name for aligned in self.aligned)

    @property
    def leaves_gap(self) -> bool:
        """True if held-out lines are predicted worse than by a complete model."""
        return is_open(self.fit)

    @property
    def compared(self) -> int:
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
    # An effect that the model lacks makes places differ: less noise is assumed.
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
    undetermined = list_undetermined(fitter, best, named)
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


@dataclass(frozen=True)
class ExtendedModel(EstimatedModel):
    """A model of the machine with its parameters and their covariance.

    added : the findings that are part of it, with their effects
    """

    added: tuple[tuple[Finding, Effect], ...]

    def holds(self, finding: Finding) -> bool:
        """True if the finding is part of the model; compared by identity."""
        return any(finding is one for one, _ in self.added)


def extend_model(found: Discovery) -> ExtendedModel:
    """Includes the findings that persist with the machine."""
    base, fit = found.baseline.model, found.fit
    covariance = fit.posterior.covariance.copy()
    added: list[tuple[Finding, Effect]] = []
    columns = _list_columns(base)
    for number, term in enumerate(fit.terms):
        finding = next(f for f in found.findings if f.term is term)
        part = fit.part(number)
        covariance[part, part] += _spread_beyond(
            finding.covariance, covariance[part, part]
        )
        family, candidate = finding.family, finding.candidate
        numbers = family.list_numbers(candidate)
        effect = restore_effect(family, base.machine, candidate.keys, numbers)
        if effect is not None:  # else it ends with its Run
            added.append((finding, effect))
            columns.append((effect, part))
    model = _join([effect for effect, _ in columns], base)
    select = np.zeros((model.size, len(covariance)))
    for effect, part in columns:
        rows = np.arange(model.size)[model.slices[effect.name]]
        select[rows, np.arange(part.start, part.stop)] += 1.0
    theta = fit.posterior.theta.copy()
    theta[: base.size] += found.baseline.theta
    return ExtendedModel(
        model, select @ theta, select @ covariance @ select.T, tuple(added)
    )


def baseline_model(found: Discovery) -> ExtendedModel:
    base, fit = found.baseline.model, found.baseline_fit.posterior
    columns = _list_columns(base)
    keep = np.concatenate([np.r_[part] for _, part in columns])
    model = replace(base, effects=tuple(effect for effect, _ in columns))
    theta = found.baseline.theta[keep] + fit.theta[keep]
    return ExtendedModel(model, theta, fit.covariance[np.ix_(keep, keep)], ())


def _list_columns(base: MachineModel) -> list[tuple[Effect, slice]]:
    of_machine = [e for e in base.effects if not is_tracker_error(e)]
    return [(effect, base.slices[effect.name]) for effect in of_machine]


def _join(effects: list[Effect], base: MachineModel) -> MachineModel:
    once = {effect.name: effect for effect in reversed(effects)}
    names = dict.fromkeys(effect.name for effect in effects)
    return replace(base, effects=tuple(once[name] for name in names))


def _spread_beyond(
    stated: Float64[np.ndarray, "k k"], fitted: Float64[np.ndarray, "k k"]
) -> Float64[np.ndarray, "k k"]:
    """Addition to a covariance by scanned values; never negative."""
    value, vector = np.linalg.eigh(stated - fitted)
    return (vector * np.maximum(value, 0.0)) @ vector.T
