"""From Runs to the effects that their model lacks: prepare, search, state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from app.alignment.surroundings import with_pose
from app.discovery.aligned_run import AlignedRun, align_runs
from app.discovery.findings import Finding, state_findings
from app.discovery.gap import Gap, measure_gap
from app.discovery.residual_location import RunResidual, locate_residuals
from app.discovery.run_data import RunData
from app.discovery.term_fitter import TermFit, TermFitter
from app.discovery.term_search import TermSearch
from app.discovery.within import within_cells
from app.estimation.baseline import (
    Baseline,
    ReferenceModel,
    fit_baseline,
    refit_noise,
)
from app.estimation.design_matrix import Linearisation, middle_of
from app.files.one_machine import one_machine
from app.files.run import Run
from app.kinematics.effects.installed import list_families
from app.kinematics.effects.tracker_pose import TrackerPose
from app.progress import ShareProgress, ignore_progress


@dataclass(frozen=True)
class Discovery:
    """What the model lacks.

    aligned : each Run, where the baseline places its tracker
    fitter : fits other terms to the Runs
    baseline_fit, fit : of the baseline alone, and with the terms found
    findings : by evidence, greatest first
    residuals : of each Run, before and after, and where they are
    """

    aligned: tuple[AlignedRun, ...]
    baseline: Baseline
    fitter: TermFitter
    baseline_fit: TermFit
    fit: TermFit
    findings: tuple[Finding, ...]
    gap: Gap
    residuals: tuple[RunResidual, ...]

    @property
    def run_names(self) -> str:
        """Names of the Runs in one line."""
        return ", ".join(aligned.run.name for aligned in self.aligned)

    @property
    def compared(self) -> int:
        """How many effects were looked for."""
        return self.fitter.catalogue_size


def discover(
    runs: Sequence[Run],
    reference: ReferenceModel | None = None,
    on_progress: ShareProgress = ignore_progress,
) -> Discovery:
    """Find the effects that the model of Runs lacks.

    runs : of one machine, each with its own tracker pose, timing and noise
    reference : the model; the rigid-body model fitted to the Runs if None

    Raises AlignmentError, EstimationError if the Runs cannot be fitted at all,
    BundleError if they are not of one machine.
    """
    machine = one_machine([run.machine for run in runs], [run.name for run in runs])
    aligned = align_runs(runs)
    on_progress(0.05)
    baseline = fit_baseline(machine, [a.coarse for a in aligned], reference)
    on_progress(0.35)
    # A fitted baseline has every squareness already.
    families = [
        family
        for family in list_families()
        if reference is not None or not family.is_rigid_body
    ]
    fitter = TermFitter(_run_data(aligned, baseline), baseline.prior, families)
    best = TermSearch(fitter).add_terms()
    on_progress(0.6)
    if best.terms:
        # What the effects caused is no longer counted as noise.
        baseline = refit_noise(baseline, [t.effect for t in best.terms])
        fitter = TermFitter(_run_data(aligned, baseline), baseline.prior, families)
        best = TermSearch(fitter).select_terms(best.terms)
    on_progress(0.8)
    return _state(_place(aligned, baseline), baseline, fitter, best)


def _place(aligned: Sequence[AlignedRun], baseline: Baseline) -> tuple[AlignedRun, ...]:
    """Return the Runs where the baseline places their trackers."""
    return tuple(
        replace(a, observations=with_pose(a.observations, run.pose))
        for a, run in zip(aligned, baseline.runs, strict=True)
    )


def _run_data(aligned: Sequence[AlignedRun], baseline: Baseline) -> list[RunData]:
    """Return the data of each Run with its pose and noise in the baseline."""
    run_data: list[RunData] = []
    for one, fitted in zip(_place(aligned, baseline), baseline.runs, strict=True):
        base = Linearisation(
            baseline.model,
            TrackerPose(middle_of(fitted.observations)),
            fitted.pose,
            fitted.noise,
            baseline.theta,
            len(baseline.runs),
        )
        within = within_cells(one.run, one.observations, base)
        run_data.append(RunData(one.observations, base, within))
    return run_data


def _state(
    aligned: tuple[AlignedRun, ...],
    baseline: Baseline,
    fitter: TermFitter,
    best: TermFit,
) -> Discovery:
    without = fitter.fit([]) if best.terms else best
    findings = state_findings(fitter, without, best)
    residuals = locate_residuals(
        [a.observations for a in aligned],
        fitter.residuals(without),
        fitter.residuals(best),
    )
    gap = measure_gap(fitter.run_data, without, best)
    return Discovery(aligned, baseline, fitter, without, best, findings, gap, residuals)
