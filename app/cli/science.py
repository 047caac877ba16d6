"""From measurements to tables and from tables to points, on files."""

from __future__ import annotations

from pathlib import Path

from app.cli.summary import print_result, summarised
from app.cli.terminal import print_json, progress
from app.jobs.analysis import analyse, write_analysis
from app.measurement.bundle import read_bundle


def analyse_bundle(
    bundle: Path, output: Path, perpendicular_only: bool, *, as_json: bool
) -> None:
    """Analyse a measurement bundle and write the three files of a result."""
    with progress("analyse") as report:
        report(0.0, "reading")
        run = read_bundle(bundle)
        analysis = analyse(run, perpendicular_only=perpendicular_only, progress=report)
        report(1.0, "writing")
        write_analysis(analysis, output)
    if as_json:
        print_json(summarised(analysis.result, output))
    else:
        print_result(analysis.result, output)
