"""A plan on the command line: what to drive, and what it will leave unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from app.cli.effects import effect_line
from app.cli.terminal import print_json, print_table, progress
from app.errors import BadInput
from app.files.machine_file import read_machine
from app.planning.plan import PlanRequest, make_plan
from app.reporting.plan_files import write_plan


def plan_files(
    machine: Path,
    output: Path,
    request: PlanRequest,
    controls: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Plan a measurement and write its files."""
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for the plan")
    with progress("plan") as report:
        planned = make_plan(read_machine(machine), request, on_progress=report)
        report(1.0, "writing")
        document = write_plan(planned, output, controls)
    files = [str(output / name) for name in document["files"]]
    summary = {k: v for k, v in document.items() if k != "machine"} | {"files": files}
    if as_json:
        print_json(summary)
    else:
        _print_plan(document, files)


def _print_plan(document: Mapping[str, Any], files: Sequence[str]) -> None:
    predicted = document["predicted"]
    rows = [
        (symbol, f"{2.0 * at[f'uncertainty_{unit}']:.2f}", shown)
        for symbol, at in predicted["errors"].items()
        for unit, shown in (("um", "µm"), ("urad", "µrad"))
        if f"uncertainty_{unit}" in at
    ]
    rows += [
        (f"lag of {axis}", f"{2e3 * at['uncertainty_ms']:.1f}", "µs")
        for axis, at in predicted["servo_mismatch"].items()
    ]
    name = document["machine"]["name"]
    columns = ("error", "predicted U (k = 2)", "")
    print_table(f"What a measurement of {name} will leave", columns, rows)
    for effect in predicted["effects"]:
        print(f"foretold: {effect_line(effect)}")
    for statement in document["unobservable"]:
        print(f"will not be seen: {statement}")
    if document["tracker"]["assumed"]:
        place = ", ".join(f"{v:.0f}" for v in document["tracker"]["position_mm"])
        print(f"tracker taken to stand at {place} mm; state it in a workspace file")
    print(
        f"{document['rows']} rows, {document['duration_s'] / 60.0:.1f} min, volumetric "
        f"uncertainty {predicted['volumetric_uncertainty_um']:.2f} µm (k = 1), "
        f"{predicted['expanded_volumetric_uncertainty_um']:.2f} µm (k = 2)"
    )
    if document["target"] is not None and not document["target"]["reached"]:
        wanted = document["target"]["volumetric_uncertainty_um"]
        print(f"the target of {wanted:g} µm (k = 1) is out of reach in that time")
    for file in files:
        print(file)
