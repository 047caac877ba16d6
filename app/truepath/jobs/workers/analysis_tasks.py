"""Worker tasks of analysis jobs: read Run files, write result files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from truepath.catalogue.job import Json
from truepath.documents.whole_files import sync_to_disk, write_files
from truepath.errors import AlignmentError, BundleError, TruepathError
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.earlier.verdict import State
from truepath.files.units import UM_PER_MM
from truepath.jobs.workers.reanalysis import RunOrder, figures_of, store_outcome
from truepath.jobs.workers.workers import Workers, open_workers
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.progress import Progress
from truepath_drivers import host_clock

log = structlog.get_logger(__name__)


def analyse_recorded(
    run_files: Sequence[str],
    folder: str,
    perpendicular_only: bool,
    monte_carlo: TrialPlan | None,
    workers: Workers,
    model_file: str | None = None,
    model_id: str | None = None,
    *,
    on_progress: Progress,
) -> State:
    """Analyse Runs together and write the result into `folder`, all or nothing.

    Gives the state of its verdict.

    monte_carlo : trials that test the uncertainty, cut into blocks for `workers`
    model_file, model_id : the model whose effects are estimated too, if any
    """
    # Imported where it computes: the service itself carries no science and no plots.
    from truepath.answers.calibration_report import (
        read_runs,
        render_analysis,
        write_analysis,
    )
    from truepath.estimation.problem.prior_model import read_prior_model
    from truepath.results.analysis import analyse

    model = read_prior_model(model_file, model_id or "") if model_file else None
    runs = read_runs(run_files, open_recorded)
    shared = nullcontext(map) if monte_carlo is None else open_workers(workers)
    with shared as mapper:
        findings = analyse(
            *runs,
            model=model,
            perpendicular_only=perpendicular_only,
            monte_carlo=monte_carlo,
            mapper=mapper,
            on_progress=on_progress,
        )
    analysis = render_analysis(findings)
    _replace(Path(folder), lambda part: write_analysis(analysis, part))
    on_progress(1.0, "reporting")
    return findings.verdict.state


def reanalyse_run(
    order: RunOrder, perpendicular_only: bool, *, on_progress: Progress
) -> None:
    """Analyse one Run; store its result or its failure with its outcome."""
    # Imported where it computes: the service itself carries no science and no plots.
    from truepath.documents.file_model import encode_json
    from truepath.results.analysis import analyse
    from truepath.results.error_tables import error_tables_csv
    from truepath.results.result_json import result_json

    begun_s = host_clock.now_s()
    try:
        findings = analyse(
            open_recorded(Path(order.file)), perpendicular_only=perpendicular_only
        )
        result = result_json(findings)
        tables = error_tables_csv(findings.tables, findings.verdict)
    except TruepathError as error:
        store_outcome(order, failure=(type(error).__name__, str(error)))
        return
    files = {"error_tables.csv": tables.encode(), "result.json": encode_json(result)}
    write_files(Path(order.folder), files)
    took_s = host_clock.now_s() - begun_s
    store_outcome(order, after=figures_of(result), took_s=took_s)
    on_progress(1.0, "reporting")


def discover_recorded(
    run_files: Sequence[str],
    folder: str,
    model_file: str | None,
    model_id: str | None,
    *,
    on_progress: Progress,
) -> State:
    """Find what a model of Runs lacks and write the answer, all or nothing.

    Gives the state of its verdict.

    model_file, model_id : the model; the rigid-body model fitted to the Runs if None
    """
    # Imported where it computes: the service itself carries no science and no plots.
    from truepath.answers.calibration_report import read_runs
    from truepath.answers.discovery import discover_runs
    from truepath.answers.discovery_report import write_discovery
    from truepath.estimation.problem.prior_model import read_prior_model

    model = read_prior_model(model_file, model_id or "") if model_file else None
    runs = read_runs(run_files, open_recorded)
    found = discover_runs(runs, model, on_progress)
    _replace(Path(folder), lambda part: write_discovery(found, part))
    return found.model.verdict.state


def follow_recorded(
    run_files: Sequence[str],
    names: Sequence[str],
    folder: str,
    asked: Json,
    *,
    on_progress: Progress,
) -> State:
    """Trend of a machine over Runs, written all or nothing.

    Gives the state of its verdict.

    names : labels of the Runs in the answer
    asked : as `Question.of` reads it
    """
    # Imported where it computes: the service itself carries no science and no plots.
    from truepath.answers.calibration_report import read_runs
    from truepath.answers.trend import TrendRequest, follow_machine
    from truepath.answers.trend_report import write_trend

    runs = [
        replace(run, name=name)
        for run, name in zip(read_runs(run_files, open_recorded), names, strict=True)
    ]
    found = follow_machine(runs, TrendRequest.of(asked), on_progress=on_progress)
    _replace(Path(folder), lambda part: write_trend(found, part))
    return found.verdict.state


def verify_recorded(
    run_files: Sequence[str],
    first_row: Sequence[int],
    folder: str,
    result_file: str,
    compensation: str | None,
    asked: Json,
    *,
    on_progress: Progress,
) -> State:
    """Compare a result with the parts of a Run; write the answer, all or nothing.

    Gives the state of the result's verdict.

    first_row : row of the plan where each part begins
    compensation : folder of the files that the controller applied, if any
    asked : `tolerance_um`, and request fields that the answer repeats
    """
    # Imported where it computes: the service itself carries no science and no plots.
    from truepath.answers.verification.verification import verify
    from truepath.answers.verification.verification_report import write_verification
    from truepath.compensation.order import read_stored_files
    from truepath.files.earlier.result_file import read_result

    result = read_result(result_file)
    active = compensation and read_stored_files(Path(compensation), result.machine)
    found = verify(
        result,
        *(open_recorded(Path(file)) for file in run_files),
        first_row=first_row,
        tolerance_um=asked.get("tolerance_um"),
        correction=active.additional_correction_at if active else None,
        on_progress=on_progress,
    )
    named = active.describe() if active else None
    _replace(
        Path(folder),
        lambda part: write_verification(found, part, asked, compensation=named),
    )
    on_progress(1.0, "reporting")
    return result.verdict.state


def check_station(
    file: str,
    before: str | None,
    planned_mm: Sequence[float],
    asked_mm: float,
    specification: Json,
    *,
    on_progress: Progress,
) -> dict[str, Any]:
    """Agreement of a station with the one before, as fields of `StationCheck`.

    file, before : of the Runs of the known points from here, and from the last station
    planned_mm : position in the plan, compared with the first station
    asked_mm : planned distance from the first station to the next
    specification : of the tracker, for the tolerance
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.alignment.repeated_points import (
        compare_stations,
        compare_with_plan,
        measure_points,
    )
    from truepath.kinematics.machine.tracker_noise import TrackerSpecification

    # A plan that an earlier version made has other names.
    names = {one.name for one in fields(TrackerSpecification)} & specification.keys()
    within = TrackerSpecification(**{name: specification[name] for name in names})
    try:
        now = measure_points(open_recorded(Path(file)), within)
    except AlignmentError as error:
        return {"problem": "not-seen", "text": str(error)}
    finally:
        on_progress(1.0, "aligning")
    place_mm = tuple(now.place_mm.round(1).tolist())
    if before is None:
        at = compare_with_plan(now, np.array(planned_mm), asked_mm)
        return {"place_mm": place_mm, "problem": at.problem, "text": at.text}
    last = measure_points(open_recorded(Path(before)), within)
    found = compare_stations(last, now, asked_mm)
    return {
        "place_mm": place_mm,
        "moved_mm": found.moved_mm,
        "residual_um": UM_PER_MM * found.residual_mm,
        "allowed_um": UM_PER_MM * found.allowed_mm,
        "problem": found.problem,
        "text": found.text,
    }


def find_committed_rows(
    files: Sequence[str], machine: Machine, *, on_progress: Progress
) -> list[dict[str, Any] | None]:
    """Progress of each Run, as `Committed`; None where it gives no information.

    With `commanded`, all rows that it was commanded, as the plan keeps rows.

    machine : as it is now. Raises BundleError where a Run is of another machine file.
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.alignment.repeated_points import measure_progress
    from truepath.files.bundle.one_machine import list_differences

    found: list[dict[str, Any] | None] = []
    for file in files:
        run = open_recorded(Path(file))
        if changed := list_differences(run.machine, machine):
            raise BundleError(
                f"is of another machine file than there is now: {'; '.join(changed)}",
                file=run.name,
                remedy="put back the machine file that it was measured with",
            )
        try:
            at = measure_progress(run)
        except AlignmentError as error:
            log.info("a Run tells nothing to go on from", file=file, reason=str(error))
            found.append(None)
            continue
        place_mm = at.place_mm.tolist()
        reached = {"next_row": at.next_row, "row": at.row, "place_mm": place_mm}
        found.append(reached | {"commanded": encode_commanded_json(run.commanded)})
    on_progress(1.0, "planning")
    return found


def check_closure(
    file: str, place_mm: Sequence[Sequence[float]], *, on_progress: Progress
) -> dict[str, Any]:
    """Distance of the target from its previous position, and a problem text if far.

    file : of the Run of the closure; place_mm : as in `Committed`
    """
    # Imported where it computes: the service itself carries no science.
    from truepath.alignment.repeated_points import compare_points, locate_after_return

    run, before_mm = open_recorded(Path(file)), np.array(place_mm)
    try:
        found = compare_points(
            before_mm, locate_after_return(run, before_mm), run.machine.tracker
        )
    except AlignmentError as error:
        return {"step_um": None, "allowed_um": None, "problem": str(error)}
    finally:
        on_progress(1.0, "measuring")
    step_um, allowed_um = UM_PER_MM * found.step_mm, UM_PER_MM * found.allowed_mm
    problem = (
        ""
        if found.agrees
        else (
            f"the target is {step_um:.0f} µm from where it was measured before the "
            f"interruption, {allowed_um:.0f} µm are allowed"
        )
    )
    return {"step_um": step_um, "allowed_um": allowed_um, "problem": problem}


def prepare() -> None:
    """Import the science, so that the first job does not wait for it."""
    import truepath.answers.calibration_report
    import truepath.answers.discovery_report  # noqa: F401


def _replace(final: Path, write: Callable[[Path], object]) -> None:
    part = final.with_name(f"{final.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    write(part)
    for place in (*part.iterdir(), part):
        sync_to_disk(place)
    shutil.rmtree(final, ignore_errors=True)
    os.replace(part, final)
