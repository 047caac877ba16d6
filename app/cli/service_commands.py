"""The commands that bring devices up: the service, the demo, simulators, recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from app.cli.terminal import Json, OutputFolder, compute_on_one_thread


def serve(
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Settings, as TOML.")
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="Bring simulated devices up as well.")
    ] = False,
    measure: Annotated[
        bool, typer.Option("--measure", help="Begin the main job at once (simulated).")
    ] = False,
    hide: Annotated[
        list[str] | None,
        typer.Option(
            metavar="EFFECT[*SIZE_UM]",
            help="An effect that the simulated machine has and the model lacks, or a "
            "JSON object with its numbers; may be given several times.",
        ),
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port; 0 takes a free one.")
    ] = None,
    data_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Runs, results, catalogue.")
    ] = None,
    allow_plain_http: Annotated[
        bool,
        typer.Option(
            "--allow-plain-http", help="Listen beyond this computer, unencrypted."
        ),
    ] = False,
) -> None:
    """REST API and operator page."""
    from app.cli.serving import serve_until_stopped

    serve_until_stopped(
        config,
        measure=measure,
        simulated=simulated or None,
        simulated_hidden=hide or None,
        port=port,
        data_dir=data_dir,
        allow_plain_http=allow_plain_http or None,
    )


def demo(
    output: OutputFolder = Path("truepath-demo"),
    feed: Annotated[
        float, typer.Option(min=1.0, help="Feed along the path, mm/min.")
    ] = 6000.0,
    minutes: Annotated[
        float | None,
        typer.Option(min=0.1, help="Choose the feed so that the path takes this long."),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.1, help="Clock of the simulated devices, x real.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Which simulated machine.")] = 1,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="What goes wrong; `truepath simulate --help` lists faults."),
    ] = None,
    target_um: Annotated[
        float | None,
        typer.Option(min=0.01, help="End early at this uncertainty (k = 1), µm."),
    ] = None,
    adaptive: Annotated[
        bool,
        typer.Option("--adaptive", help="Plan the lines on the way, part after part."),
    ] = False,
    json: Json = False,
) -> None:
    """The main job on simulated devices, over real serial and Modbus links."""
    compute_on_one_thread()
    from app.cli.demo import Demo

    faults = tuple(fault or ())
    shown = Demo(output, feed, minutes, speed, seed, faults, target_um, adaptive)
    shown.run(as_json=json)


def simulate(context: typer.Context) -> None:
    """Simulated tracker and CNC as stand-alone processes, for test rigs."""
    from app.plugins import load

    simulator = load("truepath.simulators", "command")
    raise typer.Exit(simulator(context.args) or 0)


def record(
    commanded: Annotated[
        Path, typer.Argument(metavar="PATH.csv", help="What the CNC will drive.")
    ],
    output: OutputFolder,
    machine: Annotated[
        Path | None, typer.Option(metavar="MACHINE.json", help="As in the settings.")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Settings, as TOML: the tracker."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help="For so long; else until Ctrl-C.")
    ] = None,
    json: Json = False,
) -> None:
    """The tracker's stream beside a CNC without any link, as a bundle to analyse."""
    from app.cli.recording import record_bundle

    record_bundle(
        commanded,
        output,
        machine=machine,
        config=config,
        seconds=seconds,
        as_json=json,
    )
