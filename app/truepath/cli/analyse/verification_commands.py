"""The command that compares a result with an independent measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from truepath.cli.summary import print_verdict, warn_of_verdict
from truepath.cli.terminal import (
    Json,
    OutputFolder,
    ResultFile,
    collect_garbage_rarely,
    list_files,
    print_files,
    print_json,
    print_table,
    require_folder,
    say,
    show_progress,
)

_KEPT = (
    "compensated",
    "compensation",
    "verdict",
    "run_verdict",
    "statements",
    "agreement",
    "map_scale",
)
_KEPT += ("conformity", "volumetric_error_um", "difference_um", "directions", "worst")


def verify(
    result: ResultFile,
    bundle: Annotated[
        Path,
        typer.Argument(
            metavar="BUNDLE",
            help="A measurement that the result was not made from: a folder, a .zip "
            "or a Run file.",
        ),
    ],
    output: OutputFolder,
    tolerance_um: Annotated[
        float | None,
        typer.Option(min=0.001, help="Largest error that a place may have, µm."),
    ] = None,
    compensation: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="A compensation file that was active; once for each file.",
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(metavar="F", help="Of these files; `formats` lists them."),
    ] = None,
    json: Json = False,
) -> None:
    """A measurement that the calibration did not use, compared with its result."""
    collect_garbage_rarely()
    from truepath.answers.verification.verification import verify
    from truepath.answers.verification.verification_report import write_verification
    from truepath.compensation.active_files import read_active_files
    from truepath.files.earlier.result_file import read_result
    from truepath.measurement.run_file.run_loader import open_recorded

    require_folder(output, "the verification")
    loaded = read_result(result)
    files = tuple(compensation or ())
    active = read_active_files(files, format, loaded.machine)
    active = active and active.relate_to_result(loaded.provenance)
    with show_progress("verify") as on_progress:
        found = verify(
            loaded,
            open_recorded(bundle),
            tolerance_um=tolerance_um,
            correction=active.additional_correction_at if active else None,
            on_progress=on_progress,
        )
        on_progress(1.0, "writing")
        named = active.describe() if active else None
        content = write_verification(found, output, compensation=named)
    written = list_files(output)
    warn_of_verdict(content["verdict"])
    warn_of_verdict(content["run_verdict"], "the verifying measurement")
    for name, one in content["conformity"].items():
        if one["conformity"] != "within":
            say(f"note: {name}: {one['conformity']} the tolerance")
    if json:
        kept = {key: content[key] for key in _KEPT}
        print_json({"schema": "verification-summary/1", **kept, "files": written})
    else:
        _print_verification(content, written)


def _print_verification(content: Mapping[str, Any], files: Sequence[Path]) -> None:
    print_verdict(content["verdict"])
    for statement in content["statements"]:
        print(statement)
    rows = [
        (
            name,
            *(
                f"{one[key]:.2f} ± {2.0 * one[f'{key}_uncertainty']:.2f}"
                for key in ("mean", "p95", "largest")
            ),
        )
        for name, one in content["volumetric_error_um"].items()
    ]
    columns = ("µm (k = 2)", "mean", "95 % within", "largest")
    print_table(f"Volumetric error of {content['machine']}", columns, rows)
    _print_figures(content)
    print_files(files)


def _print_figures(content: Mapping[str, Any]) -> None:
    rows = [
        (
            f"{line['axes']} {line['standard']}",
            *(_state_figure(line, name) for name in "AERBM"),
        )
        for line in content["lines"]
    ]
    if rows:
        print_table("Lines, µm (k = 2)", ("line", *"AERBM"), rows)
    rows = [
        (
            f"{one['plane']} r {one['radius_mm']:.0f} mm",
            *(_state_figure(one, name) for name in ("G", "F_max", "F_min")),
        )
        for one in content["circles"]
    ]
    if rows:
        print_table("Circles, µm (k = 2)", ("circle", "G", "F max", "F min"), rows)
    names = ("H", "G", "F_max", "F_min")
    rows = [
        (
            f"{one['plane']} d {one['diameter_mm']:.0f} mm, "
            f"{one['feed_mm_min']:.0f} mm/min",
            *(_state_figure(one, name) for name in names),
        )
        for one in content["circles_in_motion"]
    ]
    if rows:
        print_table("Circles in motion, µm (k = 2)", ("circle", *names), rows)


def _state_figure(one: Mapping[str, Any], name: str) -> str:
    if name not in one["figures_um"]:
        return "—"
    expanded = 2.0 * one["uncertainty_um"][name]
    return f"{one['figures_um'][name]:.1f} ± {expanded:.1f}"
