"""From Runs to the findings on their machine, each room entered in the order of data.

The facts of the Runs, their alignment, one estimate of all, the grade of the set-up,
trials of its uncertainty, and what follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import combinations

from truepath.alignment.align import align_all
from truepath.errors import BundleError
from truepath.estimation.checks.intra_cell_motion import add_short_wave_variance
from truepath.estimation.checks.robust_estimate import estimate_checked
from truepath.estimation.problem.prior_model import PriorEffects, PriorModel
from truepath.estimation.solve.budget import compute_contributions, split_uncertainty
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.run import (
    Run,
    RunSummary,
    number_names,
    share_samples,
    summarize_run,
)
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.coarse_model import build_run_models
from truepath.numerics.adaptive_trials import Mapper, TrialPlan
from truepath.planning.grade import SetUp, grade_together
from truepath.progress import Progress, ignore_progress, scale_progress
from truepath.results.monte_carlo_results import run_trials
from truepath.results.result_assessment import (
    assess_air,
    assess_chain,
    assess_driving,
    assess_range,
    assess_sensors,
)
from truepath.results.result_summary import (
    Findings,
    Provenance,
    apply_length_scale,
    state_checked_findings,
)

# Share of the work that is done after alignment, estimation and trials.
_SHARES, _SHARES_WITH_TRIALS = (0.1, 0.9, 0.9), (0.01, 0.09, 0.98)


def analyse(
    *runs: Run,
    model: PriorModel | None = None,
    perpendicular_only: bool = False,
    monte_carlo: TrialPlan | None = None,
    mapper: Mapper = map,
    on_progress: Progress = ignore_progress,
) -> Findings:
    """Analyse Runs of one machine, of either mode, in one estimate.

    model : whose effects are estimated together with the error motions, with its
        covariance as prior
    perpendicular_only : leave out components along the travel
    monte_carlo : the trials that the uncertainty is tested against, if any
    mapper : computes blocks of trials, here or elsewhere
    on_progress : receives the share done and the stage: aligning, estimating,
        validating where trials are run, reporting

    Raises EstimationError if the data do not determine the answer, BundleError if the
    Runs are not of one machine, or the model is of another.
    """
    aligned, solved, tried = _SHARES if monte_carlo is None else _SHARES_WITH_TRIALS
    on_progress(0.0, "aligning")
    summaries = _summarize(runs)
    names = [summary.name for summary in summaries]
    machine = one_machine([run.machine for run in runs], names)
    _reject_twice(summaries)
    known = model.select_effects(machine, summaries) if model else PriorEffects()
    observed = align_all(runs, names)
    estimating = scale_progress(on_progress, aligned, solved, "estimating")
    estimating(0.0)
    checked = estimate_checked(
        build_run_models(machine, [each.at for each in observed], known.effects),
        observed,
        known=known,
        perpendicular_only=perpendicular_only,
        on_progress=estimating,
    )
    estimated = add_short_wave_variance(
        checked.estimate, [runs[number] for number in checked.given]
    )
    set_ups = [
        SetUp(run.machine, run.commanded, found.pose.invert().translation_mm)
        for run, found in zip(runs, checked.first_parts, strict=True)
    ]
    grade = grade_together(machine, set_ups, perpendicular_only=perpendicular_only)
    trials = None
    if monte_carlo is not None:
        validating = scale_progress(on_progress, solved, tried, "validating")
        validating(0.0)
        trials = run_trials(estimated, monte_carlo, mapper, validating)
    on_progress(tried, "reporting")
    provenance = Provenance(summaries, version("truepath"), datetime.now(UTC), model)
    settled, _, _ = apply_length_scale(estimated, provenance, checked.given)
    brought = compute_contributions(estimated, checked.given, settled)
    budget = split_uncertainty(estimated, settled)
    scores = [misfit.range_offset for misfit in checked.misfits]
    ranges = assess_range(scores, checked.given, names)
    fit = checked.estimate.fit
    checked = replace(checked, estimate=replace(estimated, fit=None))
    found = state_checked_findings(checked, provenance, trials, grade)
    driven = assess_driving([each.driving for each in observed], names)
    air = assess_air([run.refraction for run in runs], names)
    verdict = Verdict.merge([found.verdict, ranges])
    if verdict.state != "usable" and fit is not None:
        # Another order bends the volume as a wrong home distance does.
        chain = assess_chain(fit, scores)
        verdict = Verdict.merge([chain, found.verdict] if chain.reasons else [verdict])
    verdict = Verdict.merge([verdict, driven, air, assess_sensors(summaries)])
    return replace(found, contributions=brought, budget=budget, verdict=verdict)


def _summarize(runs: Sequence[Run]) -> tuple[RunSummary, ...]:
    names = number_names([run.name for run in runs])
    return tuple(
        replace(summarize_run(run), name=name)
        for run, name in zip(runs, names, strict=True)
    )


def _reject_twice(summaries: Sequence[RunSummary]) -> None:
    """Raise BundleError for a measurement given twice: its noise would count as two."""
    for known, given in combinations(summaries, 2):
        if known.digest == given.digest:
            problem = f"is the same measurement as {known.name}"
        elif share_samples(known.sketch, given.sketch):
            problem = f"has samples of {known.name} in it"
        else:
            continue
        remedy = "give each measurement once"
        raise BundleError(problem, file=given.name, remedy=remedy)
