"""Analysis as a job does it: Runs in; result file, tables and report out.

`analyse` reads and writes nothing; `write_analysis` puts each file down whole or not at
all. `predict_points` answers from a result file alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from app.alignment.align import align
from app.alignment.observations import Observations
from app.alignment.surroundings import with_surroundings
from app.errors import AlignmentError, BundleError
from app.estimation.batch import estimate
from app.estimation.estimate import Estimate
from app.files.one_machine import one_machine
from app.files.result_file import LARGEST_BYTES, read_result
from app.files.run import Run
from app.files.whole_files import read_whole, replace_file
from app.kinematics.machine import Machine
from app.numerics.adaptive_trials import Mapper, TrialPlan
from app.planning.grade import Grade, SetUp, grade_together
from app.progress import Progress, ignore_progress, scale_progress
from app.reporting.calibration_report import render_calibration_report
from app.results.effects_beside import ModelAccount
from app.results.error_tables_csv import error_tables_csv
from app.results.findings import Findings, Provenance, find
from app.results.held_trials import held_against_trials
from app.results.points_csv import predicted_csv, read_points
from app.results.prediction import Prediction, predict
from app.results.prior_model import PriorModel
from app.results.result_json import result_json
from app.results.run_account import RunAccount, account_of

RESULT, TABLES, REPORT = "result.json", "error_tables.csv", "report.html"


class _Shares(NamedTuple):
    """Share of the work that is done with each stage."""

    aligned: float
    solved: float
    tried: float


_SHARES = _Shares(0.1, 0.9, 0.9)
_SHARES_WITH_TRIALS = _Shares(0.01, 0.09, 0.98)


@dataclass(frozen=True, slots=True)
class Analysis:
    """What became of one Run, or of several together.

    result : content of `result.json`; the others are texts of the files of that name
    """

    found: Findings
    result: dict[str, Any]
    tables_csv: str
    report_html: str


def analyse(
    *runs: Run,
    model: PriorModel | None = None,
    perpendicular_only: bool = False,
    monte_carlo: TrialPlan | None = None,
    mapper: Mapper = map,
    on_progress: Progress = ignore_progress,
) -> Analysis:
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
    estimating = scale_progress(
        on_progress, shares.aligned, shares.solved, "estimating"
    )
    validating = scale_progress(on_progress, shares.solved, shares.tried, "validating")
    on_progress(0.0, "aligning")
    names = told_apart([run.name for run in runs])
    accounts = tuple(
        replace(account_of(run), name=name)
        for run, name in zip(runs, names, strict=True)
    )
    _require_different(accounts)
    machine = one_machine([run.machine for run in runs], names)  # before the work
    digests = [account.digest for account in accounts]
    known = None if model is None else model.select_effects(machine, digests)
    observed = [
        _aligned(run, name, len(runs)) for run, name in zip(runs, names, strict=True)
    ]
    estimating(0.0)
    estimated = estimate(
        *observed,
        names=names,
        known=known,
        perpendicular_only=perpendicular_only,
        keep_fit=monte_carlo is not None,
        on_progress=estimating,
    )
    trials = None
    if monte_carlo is not None:
        validating(0.0)
        trials = held_against_trials(estimated, monte_carlo, mapper, validating)
    on_progress(shares.tried, "reporting")
    told_model = None if model is None else _account(model, digests)
    provenance = Provenance(
        accounts, version("truepath"), datetime.now(UTC), told_model
    )
    graded = _graded(machine, runs, estimated)
    found = find(replace(estimated, fit=None), provenance, trials, graded)
    analysis = Analysis(
        found,
        result_json(found),
        error_tables_csv(found.tables),
        render_calibration_report(found),
    )
    on_progress(1.0, "reporting")
    return analysis


def _account(model: PriorModel, digests: Sequence[str]) -> ModelAccount:
    return ModelAccount(
        model.source,
        model.version,
        model.sha256,
        model.is_of(digests),
        model.runs,
    )


def told_apart(names: Sequence[str]) -> list[str]:
    """Return the names of Runs, numbered where some have the same."""
    if len(set(names)) == len(names):
        return list(names)
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def read_all(
    places: Sequence[str | Path], read: Callable[[Path], Run]
) -> tuple[Run, ...]:
    """Read Runs. Raises BundleError, of several with the place of the one meant."""
    return tuple(_read(Path(place), read, len(places)) for place in places)


def _read(place: Path, read: Callable[[Path], Run], count: int) -> Run:
    try:
        return read(place)
    except BundleError as error:
        if count == 1:
            raise
        raise BundleError(
            error.problem,
            file=f"{place.name}: {error.file}",
            row=error.row,
            column=error.column,
            remedy=error.remedy,
        ) from error


def _require_different(accounts: Sequence[RunAccount]) -> None:
    """Refuse a measurement given twice: its noise would count as that of two."""
    seen: dict[str, str] = {}
    for account in accounts:
        if account.digest in seen:
            raise BundleError(
                f"is the same measurement as {seen[account.digest]}",
                file=account.name,
                remedy="give each measurement once",
            )
        seen[account.digest] = account.name


def _aligned(run: Run, name: str, count: int) -> Observations:
    """Align a Run, and name it if it cannot be and there are others."""
    try:
        return with_surroundings(align(run), run.commanded, run.temperature)
    except AlignmentError as error:
        if count == 1:
            raise
        raise AlignmentError(f"{name}: {error}") from error


def _graded(machine: Machine, runs: Sequence[Run], estimated: Estimate) -> Grade:
    """Grade the set-up of all Runs together, from where the trackers stood."""
    set_ups = [
        SetUp(run.machine, run.commanded, found.pose.invert().translation_mm)
        for run, found in zip(runs, estimated.runs, strict=True)
    ]
    return grade_together(
        machine, set_ups, perpendicular_only=estimated.perpendicular_only
    )


def write_analysis(analysis: Analysis, folder: str | Path) -> None:
    """Write `result.json`, `error_tables.csv` and `report.html` into a folder."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    text = json.dumps(analysis.result, ensure_ascii=False, allow_nan=False)
    # The result last: where it stands, the others stand as well.
    replace_file(place / TABLES, analysis.tables_csv.encode())
    replace_file(place / REPORT, analysis.report_html.encode())
    replace_file(place / RESULT, f"{text}\n".encode())


def predict_points(
    result: str | Path, points: str | Path, output: str | Path
) -> Prediction:
    """Predict at the points of a CSV file from a result file, and write the answer.

    Raises BundleError with the place; `Prediction.warnings` is for the user.
    """
    loaded = read_result(result)
    data = read_whole(points, largest_bytes=LARGEST_BYTES)
    asked = read_points(data, loaded.machine, file=str(points))
    predicted = predict(loaded, asked.position, asked.target)
    replace_file(Path(output), predicted_csv(asked, predicted).encode())
    return predicted
