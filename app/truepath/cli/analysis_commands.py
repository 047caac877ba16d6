"""The commands on measurements: `analyse`, `discover`, `predict`, `reanalyse`."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from truepath.cli.summary import (
    describe_effect,
    print_result,
    print_verdict,
    summarise_result,
    warn_of_verdict,
)
from truepath.cli.terminal import (
    HERE,
    Address,
    CaFile,
    Json,
    KeyFile,
    OutputFolder,
    PerpendicularOnly,
    ResultFile,
    open_client,
    print_files,
    print_json,
    print_table,
    require_folder,
    say,
    show_progress,
)
from truepath.files.earlier.verdict import verdict_json

if TYPE_CHECKING:
    from truepath.numerics.adaptive_trials import Mapper
    from truepath.results.prediction import Prediction


def analyse(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Measurements of one machine, each a folder, a .zip or a Run file.",
        ),
    ],
    output: OutputFolder,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json",
            help="Model whose effects are estimated beside the error motions.",
        ),
    ] = None,
    known_length: Annotated[
        Path | None,
        typer.Option(
            metavar="KNOWN_LENGTHS.csv",
            help="Lengths known otherwise, as the tracker of the first measurement "
            "shows them.",
        ),
    ] = None,
    perpendicular_only: PerpendicularOnly = False,
    monte_carlo: Annotated[
        bool,
        typer.Option(
            "--monte-carlo",
            help="Hold the uncertainty against GUM Supplement 1 trials.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the trials.")] = 1,
    interval: Annotated[
        Literal["symmetric", "shortest"],
        typer.Option(help="Form of the trials' coverage intervals."),
    ] = "symmetric",
    json: Json = False,
) -> None:
    """Measurements to error tables with their uncertainty, and a report."""
    from truepath.answers.calibration_report import (
        read_runs,
        render_analysis,
        write_analysis,
    )
    from truepath.documents.whole_files import read_whole
    from truepath.estimation.problem.prior_model import read_prior_model
    from truepath.files.bundle.recorded_files import (
        add_known_lengths,
        decode_known_lengths,
    )
    from truepath.measurement.run_file.run_loader import open_recorded
    from truepath.numerics.adaptive_trials import TrialPlan
    from truepath.results.analysis import analyse

    require_folder(output, "the results")
    workers = _open_workers() if monte_carlo else nullcontext(map)
    with show_progress("analyse") as on_progress, workers as mapper:
        on_progress(0.0, "reading")
        earlier = None if model is None else read_prior_model(model)
        first, *further = read_runs(bundles, open_recorded)
        if known_length is not None:
            data = read_whole(known_length)
            lengths = decode_known_lengths(data, file=known_length.name)
            first = add_known_lengths(first, lengths)
        findings = analyse(
            first,
            *further,
            model=earlier,
            perpendicular_only=perpendicular_only,
            monte_carlo=TrialPlan(seed=seed, interval=interval)
            if monte_carlo
            else None,
            mapper=mapper,
            on_progress=on_progress,
        )
        analysis = render_analysis(findings)
        on_progress(1.0, "writing")
        write_analysis(analysis, output)
    warn_of_verdict(analysis.result["verdict"])
    if json:
        print_json(summarise_result(analysis.result, output))
    else:
        print_result(analysis.result, output)


def discover(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Measurements of one machine, each a folder, a .zip or a Run file: "
            "the first, and further lines that it asked for.",
        ),
    ],
    output: OutputFolder,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json",
            help="A model or result to hold it against. Else the rigid-body model "
            "fitted to it.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Find what the model of a measurement lacks, and what to drive to be sure."""
    from truepath.answers.calibration_report import read_runs
    from truepath.answers.discovery import discover_runs
    from truepath.answers.discovery_report import write_discovery
    from truepath.estimation.problem.prior_model import read_prior_model
    from truepath.measurement.run_file.run_loader import open_recorded

    require_folder(output, "the results")
    with show_progress("discover") as on_progress:
        on_progress(0.0, "reading")
        parent = None if model is None else read_prior_model(model)
        runs = read_runs(bundles, open_recorded)
        discovered = discover_runs(runs, parent, on_progress)
        on_progress(1.0, "writing")
        write_discovery(discovered, output)
    warn_of_verdict(discovered.content["verdict"])
    if json:
        print_json(discovered.content)
    else:
        _print_discovery(discovered.content)
        print_files(sorted(path for path in output.rglob("*") if path.is_file()))


def predict(
    result: ResultFile,
    points: Annotated[
        Path, typer.Option(metavar="P.csv", help="Axis positions: x_mm,y_mm,z_mm[,...]")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT.csv", help="What to write.")
    ],
    json: Json = False,
) -> None:
    """Volumetric error and its standard uncertainty at any points."""
    from truepath.answers.predicted_points import predict_points

    predicted = predict_points(result, points, output)
    warn_of_verdict(verdict_json(predicted.verdict))
    for warning in predicted.warnings:
        say(f"note: {warning}")
    if json:
        print_json(_summarise_prediction(predicted, output))
    else:
        print(f"{len(predicted.error_um)} points in {output}")


def reanalyse(
    run_ids: Annotated[
        list[str] | None, typer.Argument(metavar="RUN...", help="Runs of the service.")
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(help="In their place: all Runs of this machine of the service."),
    ] = None,
    since: Annotated[
        datetime | None, typer.Option(help="Only Runs since then, by local time.")
    ] = None,
    address: Address = HERE,
    key_file: KeyFile = None,
    ca_file: CaFile = None,
    json: Json = False,
) -> None:
    """Analyse Runs again and say what has changed; Ctrl-C leaves the job running."""
    from truepath.cli.calibration import follow_to_the_end

    order: dict[str, Any] = {"kind": "reanalyse"}
    if run_ids:
        order["run_ids"] = run_ids
    if machine is not None:
        order["machine"] = machine
    if since is not None:
        order["since"] = since.astimezone().isoformat()
    with open_client(address, key_file, ca_file) as client:
        job_id = client.create_job(**order)["id"]
        with show_progress("reanalyse") as on_progress:

            def show(share: float, stage: str, _note: str = "") -> None:
                on_progress(share, stage, f"{100 * share:.0f} % of the Runs")

            follow_to_the_end(client, job_id, show)
        summary = client.get_reanalysis(job_id)
    if json:
        print_json(summary)
    else:
        _print_reanalysis(job_id, summary)


def _open_workers() -> AbstractContextManager[Mapper]:
    # Only trials ask who computes: settings and workers are not loaded for others.
    from truepath.jobs.workers.workers import choose_workers, open_workers
    from truepath.settings import load_settings

    return open_workers(choose_workers(load_settings()))


def _summarise_prediction(predicted: Prediction, output: Path) -> dict[str, object]:
    length_um = (predicted.error_um**2).sum(axis=1) ** 0.5
    return {
        "schema": "prediction-summary/1",
        "points": len(length_um),
        "mean_error_um": float(length_um.mean()),
        "largest_error_um": float(length_um.max()),
        "largest_uncertainty_um": float(predicted.uncertainty_um.max()),
        "verdict": verdict_json(predicted.verdict),
        "warnings": list(predicted.warnings),
        "files": [output],
    }


def _print_discovery(content: dict[str, Any]) -> None:
    print_verdict(content["verdict"])
    lines = [describe_effect(effect) for effect in content["effects"]]
    lines += [f"without a name: {u['description']}" for u in content["unnamed"]]
    lines += [f"possible: {describe_effect(e)}" for e in content["possible"]]
    for line in lines or ["nothing is missing"]:
        print(line)
    if content["ask"]:
        print(content["ask"]["reason"])
    gap = content["gap"]
    print(
        f"gap on lines not seen: {gap['before']:.2f} to {gap['after']:.2f} µm, "
        f"noise alone {gap['noise_floor']:.2f} µm"
    )


def _print_reanalysis(job_id: str, summary: dict[str, Any]) -> None:
    rows = [
        [
            one["name"] or one["run_id"],
            _show(one["before"], "volumetric_error_um"),
            _show(one["after"], "volumetric_error_um"),
            _show(one["before"], "verdict"),
            _show(one["after"], "verdict"),
        ]
        for one in summary["analyses"]
    ]
    columns = ["Run", "before, µm", "after, µm", "verdict before", "after"]
    print_table("mean volumetric error", columns, rows)
    print(
        f"job {job_id}: {summary['analysed']} of {summary['total']} Runs analysed, "
        f"{summary['failed']} failed, {summary['unchanged']} of {summary['compared']} "
        "unchanged"
    )
    for one in summary["analyses"]:
        if one["failure"]:
            say(f"failed: {one['name'] or one['run_id']}: {one['failure']['detail']}")


def _show(figures: dict[str, Any] | None, name: str) -> str:
    if figures is None or figures[name] is None:
        return ""
    value = figures[name]
    return f"{value:.2f}" if isinstance(value, float) else str(value)
