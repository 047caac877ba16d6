"""The command on errors over temperature, from several results: `temperature`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from truepath.cli.summary import print_verdict, warn_of_verdict
from truepath.cli.terminal import (
    Json,
    OutputFolder,
    collect_garbage_rarely,
    list_files,
    print_files,
    print_json,
    print_table,
    require_folder,
)
from truepath.errors import BadInput

_KEPT = ("reference_degC", "measured_degC", "valid_degC", "results", "dependences")
_SAID = ("expansion", "volumetric_um_per_K", "text", "verdict")


def temperature(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT.json...",
            help="Of one machine at three temperatures or more.",
        ),
    ],
    output: OutputFolder,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="H,H,...",
            help="When each was measured, in hours from any begin: tells temperature "
            "from a drift over time.",
        ),
    ] = None,
    sensor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Thermometer of the machine; the mean of several. [those of the "
            "scales]",
        ),
    ] = None,
    degc: Annotated[
        str | None,
        typer.Option(
            metavar="T,T,...",
            help="Temperature of each result, in place of thermometers.",
        ),
    ] = None,
    thermometer_k: Annotated[
        float,
        typer.Option(
            min=0.0, help="Standard uncertainty of a temperature against others, K."
        ),
    ] = 0.1,
    reference: Annotated[
        float, typer.Option(help="Temperature that tables are stated at, °C.")
    ] = 20.0,
    range_degc: Annotated[
        str | None,
        typer.Option(
            "--range",
            metavar="LOW,HIGH",
            help="Where the line is taken to hold, °C. [as measured]",
        ),
    ] = None,
    matters: Annotated[
        float | None,
        typer.Option(
            min=1e-3,
            help="U (k = 2) of the volumetric change above which nothing is stated, "
            "µm/K. [2 µm/(m·K) of the longest travel]",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """How the errors of a machine depend on its temperature, from several results."""
    collect_garbage_rarely()
    from truepath.answers.temperature.machine_temperature import read_results
    from truepath.answers.temperature.temperature_model import study_temperature
    from truepath.answers.temperature.temperature_report import write_temperature

    require_folder(output, "the temperature model")
    study = study_temperature(
        read_results(
            results,
            times_h=_parse_numbers("--at", at, len(results)),
            degc=_parse_numbers("--degc", degc, len(results)),
            sensors=[name.removesuffix("_degC") for name in sensor or ()],
            thermometer_k=thermometer_k,
        ),
        reference_degc=reference,
        range_degc=_parse_range(range_degc),
        matters_um_per_k=matters,
    )
    content = write_temperature(study, output)
    warn_of_verdict(content["verdict"])
    files = list_files(output)
    if json:
        kept = {key: content[key] for key in (*_KEPT, *_SAID)}
        print_json({"schema": "temperature-summary/1", **kept, "files": files})
    else:
        _print_study(content)
        print_files(files)


def _parse_numbers(
    option: str, text: str | None, count: int
) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise BadInput(f"{option} {text}: write numbers with commas between") from error
    if len(found) != count:
        raise BadInput(f"{option} {text}: has {len(found)} numbers for {count} results")
    return found


def _parse_range(text: str | None) -> tuple[float, float] | None:
    ends = _parse_numbers("--range", text, 2)
    if ends is None:
        return None
    low, high = ends
    if low >= high:
        raise BadInput(f"--range {text}: write the lower temperature first")
    return low, high


def _print_study(content: dict[str, Any]) -> None:
    print_verdict(content["verdict"])
    columns = ("", "chi² without", "with temperature", "chance", "depends")
    title = f"{content['machine']['name']} over temperature"
    print_table(title, columns, _list_rows(content["dependences"]))
    for sentence in content["text"]:
        print(sentence)


def _list_rows(dependences: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    return [
        (
            one["symbol"],
            f"{one['chi2_per_freedom']['without_temperature']:.2f}",
            f"{one['chi2_per_freedom']['with_temperature']:.2f}",
            f"{one['chance']:.4f}",
            "yes" if one["is_significant"] else "not seen",
        )
        for one in dependences
    ]
