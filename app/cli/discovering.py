"""From a measurement to what its model lacks, on files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from app.cli.effects import effect_line
from app.cli.terminal import print_json, progress
from app.errors import BadInput
from app.files.bundle import read_bundle
from app.reporting.analysis_files import read_all
from app.reporting.discovery_files import discover_runs, write_discovery
from app.results.prior_model import read_prior_model


def discover_bundles(
    bundles: Sequence[Path], output: Path, *, model: Path | None, as_json: bool
) -> None:
    """Find what the model of measurements lacks and write the files of the answer.

    bundles : of one machine: the first, and further lines that it asked for
    model : a model or result file; the rigid-body model fitted to them if None
    """
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for the results")
    with progress("discover") as report:
        report(0.0, "reading")
        parent = None if model is None else read_prior_model(model)
        discovered = discover_runs(read_all(bundles, read_bundle), parent, report)
        report(1.0, "writing")
        write_discovery(discovered, output)
    if as_json:
        print_json(discovered.content)
    else:
        print(worded(discovered.content))
        for file in sorted(path for path in output.rglob("*") if path.is_file()):
            print(file)


def worded(content: dict[str, Any]) -> str:
    """Return what was found in a few lines."""
    lines = [effect_line(e) for e in content["effects"]]
    lines += [f"without a name: {u['description']}" for u in content["unnamed"]]
    gap = content["gap"]
    return "\n".join(
        [
            *(lines or ["nothing is missing"]),
            *([content["ask"]["reason"]] if content["ask"] else []),
            f"gap on lines not seen: {gap['before']:.2f} to {gap['after']:.2f} µm, "
            f"noise alone {gap['noise_floor']:.2f} µm",
        ]
    )
