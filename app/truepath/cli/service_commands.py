"""The commands that start devices: the service, the demo, simulators, recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from truepath.cli.terminal import (
    Config,
    DataDir,
    Json,
    OutputFolder,
    list_files,
    print_files,
    print_json,
)
from truepath.errors import BadInput


def serve(
    config: Config = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="Bring simulated devices up as well.")
    ] = False,
    simulated_machines: Annotated[
        int | None,
        typer.Option(min=1, max=64, help="So many simulated machines; 1."),
    ] = None,
    measure: Annotated[
        bool,
        typer.Option(
            "--measure",
            help="Begin the main job at once (simulated), on the first machine.",
        ),
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
    data_dir: DataDir = None,
    root_path: Annotated[
        str | None,
        typer.Option(metavar="PATH", help="Where a reverse proxy shows it: /truepath."),
    ] = None,
    allow_plain_http: Annotated[
        bool,
        typer.Option(
            "--allow-plain-http", help="Listen beyond this computer without TLS."
        ),
    ] = False,
) -> None:
    """REST API and operator page."""
    from truepath.cli.calibration import calibrate
    from truepath.main import serve
    from truepath.settings import load_settings

    settings = load_settings(
        config,
        simulated=simulated or None,
        simulated_hidden=hide or None,
        simulated_machines=simulated_machines,
        port=port,
        data_dir=data_dir,
        root_path=root_path,
        allow_plain_http=allow_plain_http or None,
    )
    if measure and not settings.simulated:  # no operator has checked the machine
        raise BadInput("--measure moves the machine at once; it needs --simulated")
    if measure and (settings.log_in_required or settings.tls_cert):
        raise BadInput(
            "--measure begins with nobody logged in; leave it out, or listen on this "
            "computer only, without TLS"
        )
    if hide and not settings.simulated:
        raise BadInput("--hide is for simulated devices; it needs --simulated")
    serve(settings, listening=calibrate if measure else None)


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
    compensate: Annotated[
        bool,
        typer.Option(
            "--compensate",
            help="Load the tables into the simulated control; prove what is left.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """The main job on simulated devices, over real serial and Modbus links."""
    from truepath.cli.demo import Demo

    faults = tuple(fault or ())
    wanted = target_um, adaptive, compensate
    shown = Demo(output, feed, minutes, speed, seed, faults, *wanted)
    shown.run(as_json=json)


def simulate(context: typer.Context) -> None:
    """Simulated tracker and CNC as stand-alone processes, for test rigs."""
    from truepath.plugins import load

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
    from truepath.cli.recording import record_run
    from truepath.device_options import make_device
    from truepath.files.bundle.bundle import write_bundle
    from truepath.files.bundle.commanded_file import read_set_up
    from truepath.measurement.run_file.run_file import RunHeader
    from truepath.measurement.run_file.run_loader import open_run
    from truepath.settings import load_settings
    from truepath_drivers.interfaces.tracker import PolledTracker

    settings = load_settings(config)
    machine_file = machine or settings.machine_file
    if machine_file is None:
        raise BadInput("no machine is named; give --machine MACHINE.json")
    described, planned = read_set_up(machine_file, commanded)
    rate_hz = described.tracker.rate_hz
    header = RunHeader(output.name, described, planned, rate_hz, {}, ())
    run_file = output / "run.sqlite"
    if run_file.exists():
        raise BadInput(f"{run_file}: is there already; name another folder")
    tracker = make_device("tracker", settings.tracker_driver, settings.tracker_options)
    if isinstance(tracker, PolledTracker):
        raise BadInput(
            f"tracker_driver {settings.tracker_driver} measures point by point, so it "
            "records nothing while a program runs; use a tracker that streams"
        )
    thermometers = None
    if settings.thermometer_driver:
        thermometers = make_device(
            "thermometer", settings.thermometer_driver, settings.thermometer_options
        )
    output.mkdir(parents=True, exist_ok=True)
    closed = record_run(
        tracker,
        header,
        run_file,
        seconds,
        thermometers=thermometers,
        light=settings.light,
    )
    write_bundle(open_run(run_file), output)
    if json:
        counts = {"samples": closed.samples, "lost_samples": closed.lost_samples}
        files = {"files": list_files(output)}
        print_json({"schema": "recording-summary/1", **counts, **files})
    else:
        print(f"{closed.samples} samples, {closed.lost_samples} lost")
        print_files(list_files(output))
