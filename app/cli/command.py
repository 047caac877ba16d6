"""The commands and their options."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer

from app.cli.failures import exit_status

app = typer.Typer(
    help="Calibrates machine tools with a laser tracker, with the machine in the loop.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[
    bool, typer.Option("--json", help="Print the summary on standard output as JSON.")
]
OutputFolder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", help="Where the files go.")
]


def main() -> NoReturn:
    """Run the command line of this process and exit with its status."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status: 0, 2 for bad input, else 1."""
    return exit_status(lambda: app(args=list(arguments), standalone_mode=False))


def _compute_on_one_thread() -> None:
    # Before NumPy is imported: on busy cores the threads of a BLAS wait for each other
    # and take several times the processor time of one.
    from app.jobs.executor import limit_threads

    limit_threads()
    # Imports make many objects that stay; looking through them again and again for
    # cycles costs a command that soon ends a twentieth of its time.
    gc.set_threshold(100_000, 50, 50)


def _print_version(asked: bool) -> None:
    if asked:
        print(version("truepath"))
        raise typer.Exit


@app.callback()
def truepath(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, help="Print the version."),
    ] = False,
) -> None:
    """Calibrates machine tools with a laser tracker, with the machine in the loop."""


@app.command()
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
        port=port,
        data_dir=data_dir,
        allow_plain_http=allow_plain_http or None,
    )


@app.command()
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
        typer.Option(min=0.01, help="End early at this volumetric uncertainty, µm."),
    ] = None,
    adaptive: Annotated[
        bool,
        typer.Option("--adaptive", help="Plan the lines on the way, part after part."),
    ] = False,
    json: Json = False,
) -> None:
    """The main job on simulated devices, over real serial and Modbus links."""
    _compute_on_one_thread()
    from app.cli.demo import Demo

    faults = tuple(fault or ())
    shown = Demo(output, feed, minutes, speed, seed, faults, target_um, adaptive)
    shown.run(as_json=json)


@app.command(
    context_settings={
        "allow_extra_args": True,
        "ignore_unknown_options": True,
        "help_option_names": [],
    }
)
def simulate(context: typer.Context) -> None:
    """Simulated tracker and CNC as stand-alone processes, for test rigs."""
    from app.plugins import load

    simulator = load("truepath.simulators", "command")
    raise typer.Exit(simulator(context.args) or 0)


@app.command()
def analyse(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Measurements of one machine, each a folder or a .zip.",
        ),
    ],
    output: OutputFolder,
    perpendicular_only: Annotated[
        bool,
        typer.Option(
            "--perpendicular-only", help="Leave out what is seen along each line."
        ),
    ] = False,
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
    _compute_on_one_thread()
    from app.cli.science import analyse_bundles
    from app.numerics.adaptive_trials import TrialPlan

    plan = TrialPlan(seed=seed, interval=interval) if monte_carlo else None
    analyse_bundles(bundles, output, perpendicular_only, monte_carlo=plan, as_json=json)


@app.command()
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
    _compute_on_one_thread()
    from app.cli.discovering import discover_bundles

    discover_bundles(bundles, output, model=model, as_json=json)


@app.command()
def grade(
    machine: Annotated[Path, typer.Argument(metavar="MACHINE.json")],
    commanded: Annotated[
        Path,
        typer.Argument(
            metavar="PATH.csv", help="A path, or standstill points: no feed column."
        ),
    ],
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="Where the tracker stands, mm. Else usual places."
        ),
    ] = None,
    perpendicular_only: Annotated[
        bool,
        typer.Option(
            "--perpendicular-only", help="Leave out what is seen along each line."
        ),
    ] = False,
    json: Json = False,
) -> None:
    """What a set-up is worth, from its geometry alone; nothing moves."""
    _compute_on_one_thread()
    from app.cli.grading import grade_set_up

    grade_set_up(
        machine,
        commanded,
        tracker,
        perpendicular_only=perpendicular_only,
        as_json=json,
    )


@app.command()
def predict(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="What `analyse` or `discover` wrote."
        ),
    ],
    points: Annotated[
        Path, typer.Option(metavar="P.csv", help="Axis positions: x_mm,y_mm,z_mm[,...]")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT.csv", help="What to write.")
    ],
    json: Json = False,
) -> None:
    """Volumetric error and its standard uncertainty at any points."""
    from app.cli.science import predict_file

    predict_file(result, points, output, as_json=json)


@app.command()
def compare(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="What `analyse` or `discover` wrote."
        ),
    ],
    reference: Annotated[
        Path,
        typer.Argument(
            metavar="REFERENCE.csv", help="error,position_mm,direction,value,unit"
        ),
    ],
    output: OutputFolder,
    reference_um: Annotated[
        float,
        typer.Option(min=0.0, help="Standard uncertainty of its displacements, µm."),
    ] = 0.0,
    reference_urad: Annotated[
        float, typer.Option(min=0.0, help="Standard uncertainty of its angles, µrad.")
    ] = 0.0,
    json: Json = False,
) -> None:
    """A result against a direct measurement of single error motions."""
    _compute_on_one_thread()
    from app.cli.comparing import compare_result
    from app.reporting.comparison import ReferenceUncertainty

    uncertainty = ReferenceUncertainty(reference_um, reference_urad)
    compare_result(result, reference, output, uncertainty, as_json=json)


@app.command()
def export(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="What `analyse` or `discover` wrote."
        ),
    ],
    format: Annotated[
        str, typer.Option(metavar="F", help="Of the controller; another word lists.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="What to write.")
    ],
    spacing: Annotated[
        float, typer.Option(min=0.1, help="Of the rows of a table, mm.")
    ] = 10.0,
    json: Json = False,
) -> None:
    """A controller's compensation file, and what it leaves behind."""
    _compute_on_one_thread()
    from app.cli.exporting import export_compensation

    export_compensation(result, format, output, spacing, as_json=json)


@app.command()
def plan(
    machine: Annotated[
        Path, typer.Argument(metavar="MACHINE.json", help="The machine to measure.")
    ],
    output: OutputFolder,
    mode: Annotated[
        str, typer.Option(metavar="otf|standstill", help="On the fly, or at points.")
    ] = "otf",
    minutes: Annotated[
        float | None, typer.Option(min=0.1, help="At most, dwells included.")
    ] = None,
    target_um: Annotated[
        float | None,
        typer.Option(min=0.01, help="Volumetric uncertainty (k = 2) to reach, µm."),
    ] = None,
    feed: Annotated[
        list[float] | None,
        typer.Option(min=1.0, help="mm/min; several tell dynamic effects apart."),
    ] = None,
    dwell: Annotated[
        float | None, typer.Option(min=0.05, help="At each row, s.")
    ] = None,
    workspace: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keep-out boxes, tracker, what blocks it."),
    ] = None,
    control: Annotated[
        list[str] | None, typer.Option(help="Whose NC program; else of all.")
    ] = None,
    perpendicular_only: Annotated[
        bool,
        typer.Option(
            "--perpendicular-only", help="Count on deviations across lines only."
        ),
    ] = False,
    corner_path: Annotated[
        bool,
        typer.Option("--corner-path", help="The 2023 paper's path, to compare with."),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the search.")] = 0,
    json: Json = False,
) -> None:
    """The measurement that tells most in its time, and what it will leave unknown."""
    _compute_on_one_thread()
    from app.cli.planning import plan_files
    from app.jobs.planning import PlanRequest
    from app.measurement.workspace_file import read_workspace
    from app.planning.paths import DEFAULT_FEED_MM_MIN
    from app.planning.workspace import Workspace

    request = PlanRequest(
        mode,
        minutes,
        target_um,
        tuple(feed or (DEFAULT_FEED_MM_MIN,)),
        dwell,
        perpendicular_only,
        corner_path,
        read_workspace(workspace) if workspace else Workspace(),
        seed,
    )
    plan_files(machine, output, request, control or (), as_json=json)


@app.command()
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
