"""From measurements to tables and from tables to points, on files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np

from app.cli.summary import print_result, summarised
from app.cli.terminal import print_json, progress, say
from app.errors import BadInput
from app.files.bundle import read_bundle
from app.numerics.adaptive_trials import Mapper, TrialPlan
from app.reporting.analysis_files import (
    analyse,
    predict_points,
    read_all,
    write_analysis,
)
from app.results.prediction import Prediction
from app.results.prior_model import read_prior_model


def analyse_bundles(
    bundles: Sequence[Path],
    output: Path,
    perpendicular_only: bool,
    *,
    model: Path | None,
    monte_carlo: TrialPlan | None,
    as_json: bool,
) -> None:
    """Analyse measurement bundles together and write the three files of a result.

    model : a model or result file, whose effects are estimated beside
    monte_carlo : trials to hold the uncertainty against; the settings say who computes
    """
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for the results")
    workers = nullcontext(map) if monte_carlo is None else _workers()
    with progress("analyse") as report, workers as mapper:
        report(0.0, "reading")
        earlier = None if model is None else read_prior_model(model)
        runs = read_all(bundles, read_bundle)
        analysis = analyse(
            *runs,
            model=earlier,
            perpendicular_only=perpendicular_only,
            monte_carlo=monte_carlo,
            mapper=mapper,
            on_progress=report,
        )
        report(1.0, "writing")
        write_analysis(analysis, output)
    if as_json:
        print_json(summarised(analysis.result, output))
    else:
        print_result(analysis.result, output)


def _workers() -> AbstractContextManager[Mapper]:
    # Only trials ask who computes: settings and workers need not come up for others.
    from app.jobs.workers import opened, workers_of
    from app.settings import load_settings

    return opened(workers_of(load_settings()))


def predict_file(result: Path, points: Path, output: Path, *, as_json: bool) -> None:
    """Predict the volumetric error at the points of a file, in another file."""
    predicted = predict_points(result, points, output)
    for warning in predicted.warnings:
        say(f"note: {warning}")
    if as_json:
        print_json(_predicted(predicted, output))
    else:
        print(f"{len(predicted.error_um)} points in {output}")


def _predicted(predicted: Prediction, output: Path) -> dict[str, object]:
    length = np.linalg.norm(predicted.error_um, axis=1)
    return {
        "schema": "prediction-summary/1",
        "points": len(length),
        "mean_error_um": float(length.mean()),
        "largest_error_um": float(length.max()),
        "largest_uncertainty_um": float(predicted.uncertainty_um.max()),
        "warnings": list(predicted.warnings),
        "files": [str(output)],
    }
