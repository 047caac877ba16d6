"""The commands before a measurement: `grade` a set-up, `plan` the rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from truepath.cli.summary import UNITS, describe_effect, find_unit, warn_of_verdict
from truepath.cli.terminal import (
    Json,
    OutputFolder,
    PerpendicularOnly,
    print_files,
    print_json,
    print_table,
    require_folder,
    show_progress,
)
from truepath.errors import BadInput
from truepath.motion.paths.verification_kinds import VerificationKind


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
    from truepath.files.bundle.commanded_file import read_set_up
    from truepath.results.grade_json import grade_set_up

    place = None if tracker is None else _parse_place(tracker)
    found = grade_set_up(
        *read_set_up(machine, commanded),
        tracker_mm=place,
        perpendicular_only=perpendicular_only,
    )
    if json:
        print_json({"schema": "grade/1", **found})
    else:
        _print_grade(found)


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
            help="Model whose effects the plan has to separate as well.",
        ),
    ] = None,
    feed: Annotated[
        list[float] | None,
        typer.Option(min=1.0, help="mm/min; several tell lags apart; else chosen."),
    ] = None,
    max_feed: Annotated[
        float | None, typer.Option(min=1.0, help="mm/min, up to which it is chosen.")
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
    stations: Annotated[
        int,
        typer.Option(min=1, help="Places of the tracker, which share the minutes."),
    ] = 1,
    verify: Annotated[
        list[VerificationKind] | None,
        typer.Option(
            help="Points that prove a result instead, of this kind; several times for "
            "several kinds; circles-in-motion by itself.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """The most informative measurement in its time, with its expected uncertainty."""
    if verify:
        _plan_verification(machine, output, verify, seed, control or (), json=json)
        return
    from truepath.answers.plan_report import write_plan
    from truepath.estimation.problem.prior_model import read_prior_model
    from truepath.files.bundle.machine_file import read_machine
    from truepath.files.bundle.workspace_file import read_workspace
    from truepath.motion.workspace import Workspace
    from truepath.planning.plan import make_plan
    from truepath.planning.plan_request import PlanRequirements

    request = PlanRequirements(
        mode,
        minutes,
        target_um,
        tuple(feed or ()),
        dwell,
        perpendicular_only,
        corner_path,
        read_workspace(workspace) if workspace else Workspace(),
        seed,
        None if model is None else read_prior_model(model),
        stations=stations,
        max_feed_mm_min=max_feed,
    )
    require_folder(output, "the plan")
    with show_progress("plan") as on_progress:
        planned = make_plan(read_machine(machine), request, on_progress=on_progress)
        on_progress(1.0, "writing")
        document = write_plan(planned, output, control or ())
    files = [output / name for name in document["files"]]
    warn_of_verdict(document["verdict"], "the plan")
    if json:
        summary = {k: v for k, v in document.items() if k != "machine"}
        print_json(summary | {"files": files})
    else:
        _print_plan(document)
        print_files(files)


def _plan_verification(
    machine: Path,
    output: Path,
    kinds: Sequence[VerificationKind],
    seed: int,
    controls: Sequence[str],
    *,
    json: bool,
) -> None:
    from truepath.answers.plan_report import write_verification_plan
    from truepath.files.bundle.machine_file import read_machine

    require_folder(output, "the plan")
    planned = read_machine(machine), kinds, seed, output, controls
    document = write_verification_plan(*planned)
    files = [output / name for name in document["files"]]
    if json:
        print_json({**document, "files": files})
        return
    print(
        f"{document['rows']} rows, {document['duration_s'] / 60.0:.1f} min, drawn "
        f"from seed {seed}: measure them, then `truepath verify RESULT.json BUNDLE`"
    )
    print_files(files)


def _print_grade(found: Mapping[str, Any]) -> None:
    print(f"grade of the set-up: {found['text']}")
    for motion in found["weakest"]:
        if motion["remedy"] is not None:
            print(
                f"weak: {motion['error']} ({motion['meaning']}), "
                f"{motion['at_tool_um']:.1f} µm at the tool: {motion['remedy']}"
            )
    for shape in found["weak_shapes"]:
        print(f"weak: {shape}")
    for statement in found["unobservable"]:
        print(f"cannot be seen: {statement}")


def _parse_place(text: str) -> list[float]:
    with suppress(ValueError):
        place = [float(part) for part in text.split(",")]
        if len(place) == 3 and all(map(math.isfinite, place)):
            return place
    raise BadInput(f"--tracker {text}: not a place; write X,Y,Z in mm, as 1200,0,300")


def _print_plan(document: Mapping[str, Any]) -> None:
    from truepath.answers.plan_report import explain_feeds

    predicted = document["predicted"]
    _print_predicted(document["machine"]["name"], predicted)
    for effect in predicted["effects"]:
        print(f"predicted: {describe_effect(effect)}")
    for statement in document["unobservable"]:
        print(f"will not be seen: {statement}")
    for statement in explain_feeds(document):
        print(statement)
    if document["tracker"]["assumed"]:
        place = ", ".join(f"{v:.0f}" for v in document["tracker"]["position_mm"])
        print(f"tracker taken to stand at {place} mm; state it in a workspace file")
    if document["stations"] is not None:
        for statement in document["stations"]["statement"]:
            print(f"tracker: {statement}")
    stations: list[dict[str, Any]] = document["at_stations"] or []
    for number, station in enumerate(stations, start=1):
        place = ", ".join(f"{v:.0f}" for v in station["position_mm"])
        print(
            f"station-{number}: tracker at ({place}) mm, {station['rows']} rows, "
            f"{station['duration_s'] / 60.0:.1f} min"
        )
    print(
        f"{document['rows']} rows, {document['duration_s'] / 60.0:.1f} min, volumetric "
        f"uncertainty {predicted['expanded_volumetric_uncertainty_um']:.2f} µm (k = 2)"
    )
    if predicted["tracker_errors"] is not None:
        for statement in predicted["tracker_errors"]["statement"]:
            print(f"tracker: {statement}")
    if document["target"] is not None and not document["target"]["reached"]:
        wanted = document["target"]["expanded_volumetric_uncertainty_um"]
        print(f"the target of {wanted:g} µm (k = 2) is out of reach in that time")


def _print_predicted(name: str, predicted: Mapping[str, Any]) -> None:
    rows: list[tuple[str, str, str]] = []
    for symbol, at in predicted["errors"].items():
        unit = find_unit(at, "uncertainty")
        rows.append((symbol, f"{2.0 * at[f'uncertainty_{unit}']:.2f}", UNITS[unit]))
    rows += [
        (f"lag of {axis}", f"{2e3 * at['uncertainty_ms']:.1f}", "µs")
        for axis, at in predicted["servo_mismatch"].items()
    ]
    columns = ("error", "predicted U (k = 2)", "")
    print_table(f"What a measurement of {name} will leave", columns, rows)
