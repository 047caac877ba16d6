"""The command `discover`: what the model of a measurement lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from app.cli.options import Json, OutputFolder, compute_on_one_thread, require_folder
from app.cli.summary import describe_effect
from app.cli.terminal import print_files, print_json, show_progress


def discover(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Measurements of one machine, each a folder or a .zip: the first, and "
            "further lines that it asked for.",
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
    compute_on_one_thread()
    from app.estimation.prior_model import read_prior_model
    from app.files.bundle import read_bundle
    from app.reporting.analysis_files import read_runs
    from app.reporting.discovery_files import discover_runs, write_discovery

    require_folder(output, "the results")
    with show_progress("discover") as on_progress:
        on_progress(0.0, "reading")
        parent = None if model is None else read_prior_model(model)
        runs = read_runs(bundles, read_bundle)
        discovered = discover_runs(runs, parent, on_progress)
        on_progress(1.0, "writing")
        write_discovery(discovered, output)
    if json:
        print_json(discovered.content)
    else:
        _print_discovery(discovered.content)
        print_files(sorted(path for path in output.rglob("*") if path.is_file()))


def _print_discovery(content: dict[str, Any]) -> None:
    lines = [describe_effect(effect) for effect in content["effects"]]
    lines += [f"without a name: {u['description']}" for u in content["unnamed"]]
    for line in lines or ["nothing is missing"]:
        print(line)
    if content["ask"]:
        print(content["ask"]["reason"])
    gap = content["gap"]
    print(
        f"gap on lines not seen: {gap['before']:.2f} to {gap['after']:.2f} µm, "
        f"noise alone {gap['noise_floor']:.2f} µm"
    )
