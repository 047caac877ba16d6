"""From Runs to what is stated of their machine, each room entered in the order of data.

The facts of the Runs, their alignment, one estimate of all, the grade of the set-up,
trials that its uncertainty is held against, and what follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import NamedTuple

from app.alignment.align import align
from app.alignment.observations import Observations, add_surroundings
from app.errors import AlignmentError, BundleError
from app.estimation.batch import Estimate, estimate
from app.estimation.prior_model import PriorModel
from app.files.one_machine import one_machine
from app.files.run import Run
from app.files.run_summary import RunSummary, summarize_run
from app.kinematics.machine import Machine
from app.numerics.adaptive_trials import Mapper, TrialPlan
from app.planning.grade import Grade, SetUp, grade_together
from app.progress import Progress, ignore_progress, scale_progress
from app.results.findings import Findings, Provenance, state_findings
from app.results.trial_results import run_trials
from app.results.updated_effects import UsedModel


class _Shares(NamedTuple):
    """Share of the work that is done with each stage."""

    aligned: float
    solved: float
    tried: float


_SHARES = _Shares(0.1, 0.9, 0.9)
_SHARES_WITH_TRIALS = _Shares(0.01, 0.09, 0.98)


def analyse(
    *runs: Run,
    model: PriorModel | None = None,
    perpendicular_only: bool = False,
    monte_carlo: TrialPlan | None = None,
    mapper: Mapper = map,
    on_progress: Progress = ignore_progress,
) -> Findings:
    """Analyse Runs of one machine, of either mode, in one estimate.

    model : whose effects are estimated beside the error motions, as well as it knows
        them
    perpendicular_only : leave out what is measured along the travel
    monte_carlo : the trials that the uncertainty is held against, if it is to be
    mapper : computes blocks of trials, here or elsewhere
    on_progress : receives the share done and the stage: aligning, estimating,
        validating where trials are run, reporting

    Raises EstimationError if the data do not carry the answer, BundleError if the Runs
    are not of one machine, or the model is of another.
    """
    shares = _SHARES if monte_carlo is None else _SHARES_WITH_TRIALS
    on_progress(0.0, "aligning")
    summaries = _summarize(runs)
    names = [summary.name for summary in summaries]
    digests = [summary.digest for summary in summaries]
    machine = one_machine([run.machine for run in runs], names)  # before the work
    known = None if model is None else model.select_effects(machine, digests)
    observed = [
        _align(run, name, len(runs)) for run, name in zip(runs, names, strict=True)
    ]
    estimating = scale_progress(
        on_progress, shares.aligned, shares.solved, "estimating"
    )
    estimating(0.0)
    estimated = estimate(
        *observed,
        names=names,
        known=known,
        perpendicular_only=perpendicular_only,
        keep_fit=monte_carlo is not None,
        on_progress=estimating,
    )
    grade = _grade(machine, runs, estimated)
    trials = None
    if monte_carlo is not None:
        validating = scale_progress(
            on_progress, shares.solved, shares.tried, "validating"
        )
        validating(0.0)
        trials = run_trials(estimated, monte_carlo, mapper, validating)
    on_progress(shares.tried, "reporting")
    provenance = Provenance(
        summaries,
        version("truepath"),
        datetime.now(UTC),
        None if model is None else _state_use(model, digests),
    )
    return state_findings(replace(estimated, fit=None), provenance, trials, grade)


def number_names(names: Sequence[str]) -> list[str]:
    """Return the names of Runs, numbered where some have the same."""
    if len(set(names)) == len(names):
        return list(names)
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def _summarize(runs: Sequence[Run]) -> tuple[RunSummary, ...]:
    """Return the facts of the Runs, each with a name of its own.

    A measurement given twice is refused: its noise would count as that of two.
    """
    names = number_names([run.name for run in runs])
    known: dict[str, str] = {}
    summaries: list[RunSummary] = []
    for run, name in zip(runs, names, strict=True):
        summary = replace(summarize_run(run), name=name)
        if summary.digest in known:
            raise BundleError(
                f"is the same measurement as {known[summary.digest]}",
                file=name,
                remedy="give each measurement once",
            )
        known[summary.digest] = name
        summaries.append(summary)
    return tuple(summaries)


def _align(run: Run, name: str, count: int) -> Observations:
    """Align a Run, and name it if it cannot be and there are others."""
    try:
        return add_surroundings(align(run), run.commanded, run.temperature)
    except AlignmentError as error:
        if count == 1:
            raise
        raise AlignmentError(f"{name}: {error}") from error


def _grade(machine: Machine, runs: Sequence[Run], estimated: Estimate) -> Grade:
    """Grade the set-up of all Runs together, from where the trackers stood."""
    set_ups = [
        SetUp(run.machine, run.commanded, found.pose.invert().translation_mm)
        for run, found in zip(runs, estimated.runs, strict=True)
    ]
    return grade_together(
        machine, set_ups, perpendicular_only=estimated.perpendicular_only
    )


def _state_use(model: PriorModel, digests: Sequence[str]) -> UsedModel:
    return UsedModel(
        model.source, model.version, model.sha256, model.is_of(digests), model.runs
    )
