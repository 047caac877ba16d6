"""From measurements to tables and from tables to points, on files."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from app.cli.summary import print_result, summarised
from app.cli.terminal import print_json, progress, say
from app.errors import BadInput
from app.estimation.monte_carlo import Mapper
from app.jobs.analysis import analyse, predict_points, write_analysis
from app.measurement.bundle import read_bundle
from app.reporting.prediction import Prediction


def analyse_bundle(
    bundle: Path,
    output: Path,
    perpendicular_only: bool,
    *,
    monte_carlo: bool,
    as_json: bool,
) -> None:
    """Analyse a measurement bundle and write the three files of a result."""
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for the results")
    with progress("analyse") as report, _trials(monte_carlo) as mapper:
        report(0.0, "reading")
        run = read_bundle(bundle)
        analysis = analyse(
            run,
            perpendicular_only=perpendicular_only,
            monte_carlo=mapper,
            progress=report,
        )
        report(1.0, "writing")
        write_analysis(analysis, output)
    if as_json:
        print_json(summarised(analysis.result, output))
    else:
        print_result(analysis.result, output)


@contextmanager
def _trials(wanted: bool) -> Iterator[Mapper | None]:
    """Give blocks of trials to a process a core."""
    if not wanted:
        yield None
        return
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        yield pool.map


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
