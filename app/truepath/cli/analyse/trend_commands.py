"""The command on a machine over time: `trend`."""

from __future__ import annotations

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
    show_progress,
)
from truepath.errors import BadInput


def trend(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Short measurements of one machine, in the order of time.",
        ),
    ],
    output: OutputFolder,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="H,H,...",
            help="Middle of each, in hours from any begin. Else the tracker's clock, "
            "if it has run on.",
        ),
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(min=0.01, help="What the machine may be off by then, µm rms."),
    ] = None,
    horizon: Annotated[
        float, typer.Option(min=0.1, help="Hours to look ahead, after the last.")
    ] = 24.0,
    later: Annotated[
        list[float] | None,
        typer.Option(min=0.0, help="Hours after the last at which tables are asked."),
    ] = None,
    temperature: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=DEGC",
            help="Of a sensor that every measurement has, and that stays from then on.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """The machine over time: tables at each measurement, later, when to repeat."""
    collect_garbage_rarely()
    from truepath.answers.calibration.analysis_files import read_runs
    from truepath.answers.trend.trend import HOUR_S, TrendRequest, follow_machine
    from truepath.answers.trend.trend_report import write_trend
    from truepath.measurement.run_file.run_loader import open_recorded

    require_folder(output, "the trend")
    with show_progress("trend") as on_progress:
        on_progress(0.0, "reading")
        runs = read_runs(bundles, open_recorded)
        times = None if at is None else _parse_times(at, HOUR_S)
        ahead = [HOUR_S * hours for hours in (horizon, *(later or ()))]
        question = TrendRequest(
            times,
            limit,
            ahead[0],
            tuple(ahead[1:]),
            _parse_temperatures(temperature or ()),
        )
        found = follow_machine(runs, question, on_progress=on_progress)
        content = write_trend(found, output)
    warn_of_verdict(content["verdict"])
    files = list_files(output)
    if json:
        print_json({**content, "schema": "trend-summary/1", "files": files})
    else:
        _print_trend(content)
        print_files(files)


def _parse_times(text: str, unit_s: float) -> tuple[float, ...]:
    try:
        return tuple(unit_s * float(part) for part in text.split(","))
    except ValueError as error:
        raise BadInput(f"--at {text}: write hours with commas between") from error


def _parse_temperatures(texts: list[str] | tuple[()]) -> dict[str, float]:
    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name.removesuffix("_degC")] = float(value)
        except ValueError as error:
            problem = f"--temperature {text}: write NAME=DEGC, as X=21.5"
            raise BadInput(problem) from error
    return found


def _print_trend(content: dict[str, Any]) -> None:
    print_verdict(content["verdict"])
    rows = [
        (
            at.get("name", "predicted"),
            f"{at['time_h']:.2f}",
            f"{at['change_um']['median']:.2f}",
            f"{at['change_um']['high']:.2f}",
        )
        for at in (*content["runs"], *content["later"])
    ]
    columns = ("", "h", "off the last, µm", "at most (97.5 %)")
    print_table(f"{content['machine']['name']} over time", columns, rows)
    print(content["outlook"]["sentence"])
