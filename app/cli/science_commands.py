"""The commands that compute: from files to files, no device anywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from app.cli.computing import compute_on_one_thread
from app.cli.options import Json, OutputFolder, PerpendicularOnly, ResultFile


def analyse(
    bundles: Annotated[
        list[Path],
        typer.Argument(
            metavar="BUNDLE...",
            help="Measurements of one machine, each a folder or a .zip.",
        ),
    ],
    output: OutputFolder,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json",
            help="Model whose effects are estimated beside the error motions.",
        ),
    ] = None,
    perpendicular_only: PerpendicularOnly = False,
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
    compute_on_one_thread()
    from app.cli.science import analyse_bundles
    from app.numerics.adaptive_trials import TrialPlan

    plan = TrialPlan(seed=seed, interval=interval) if monte_carlo else None
    analyse_bundles(
        bundles,
        output,
        perpendicular_only,
        model=model,
        monte_carlo=plan,
        as_json=json,
    )


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
    from app.cli.discovering import discover_bundles

    discover_bundles(bundles, output, model=model, as_json=json)


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
    perpendicular_only: PerpendicularOnly = False,
    json: Json = False,
) -> None:
    """What a set-up is worth, from its geometry alone; nothing moves."""
    compute_on_one_thread()
    from app.cli.grading import grade_set_up

    grade_set_up(
        machine,
        commanded,
        tracker,
        perpendicular_only=perpendicular_only,
        as_json=json,
    )


def predict(
    result: ResultFile,
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


def compare(
    result: ResultFile,
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
    compute_on_one_thread()
    from app.cli.comparing import compare_result
    from app.results.comparison import ReferenceUncertainty

    uncertainty = ReferenceUncertainty(reference_um, reference_urad)
    compare_result(result, reference, output, uncertainty, as_json=json)


def export(
    result: ResultFile,
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
    compute_on_one_thread()
    from app.cli.exporting import export_compensation

    export_compensation(result, format, output, spacing, as_json=json)


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
        typer.Option(min=0.01, help="Volumetric uncertainty (k = 1) to reach, µm."),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL.json",
            help="Model whose effects are to be told apart as well.",
        ),
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
    compute_on_one_thread()
    from app.cli.planning import plan_files
    from app.files.workspace_file import read_workspace
    from app.motion.paths import DEFAULT_FEED_MM_MIN
    from app.motion.workspace import Workspace
    from app.planning.plan import PlanRequest
    from app.results.prior_model import read_prior_model

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
        None if model is None else read_prior_model(model),
    )
    plan_files(machine, output, request, control or (), as_json=json)
