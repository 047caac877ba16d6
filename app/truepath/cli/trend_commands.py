"""The commands on a machine over time and over temperature: `trend`, `temperature`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from truepath.cli.summary import print_verdict, warn_of_verdict
from truepath.cli.terminal import (
    Json,
    OutputFolder,
    list_files,
    print_files,
    print_json,
    print_table,
    require_folder,
    show_progress,
)
from truepath.errors import BadInput

_KEPT = ("reference_degC", "measured_degC", "valid_degC", "results", "dependences")
_KEPT += ("expansion", "volumetric_um_per_K", "text", "verdict")


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
    from truepath.answers.calibration_report import read_runs
    from truepath.answers.trend import HOUR_S, TrendRequest, follow_machine
    from truepath.answers.trend_report import write_trend
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
    from truepath.answers.temperature import study_temperature
    from truepath.answers.temperature_report import read_results, write_temperature

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
        kept = {key: content[key] for key in _KEPT}
        print_json({"schema": "temperature-summary/1", **kept, "files": files})
    else:
        _print_study(content)
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
    rows = [
        (
            one["symbol"],
            f"{one['chi2_per_freedom']['without_temperature']:.2f}",
            f"{one['chi2_per_freedom']['with_temperature']:.2f}",
            f"{one['chance']:.4f}",
            "yes" if one["is_significant"] else "not seen",
        )
        for one in content["dependences"]
    ]
    print_table(title, columns, rows)
    for sentence in content["text"]:
        print(sentence)
