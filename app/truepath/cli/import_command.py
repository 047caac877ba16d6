"""`import`: a recording of any tracker's software, as a bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from truepath.cli.terminal import (
    Json,
    list_files,
    print_files,
    print_json,
    print_table,
    require_folder,
    say,
)
from truepath.errors import AlignmentError, BadInput

if TYPE_CHECKING:
    from truepath.files.bundle.run import Run
    from truepath.files.imports.recording import Recording

_CSV = ".csv"


def import_recording(
    recording: Annotated[
        Path, typer.Argument(metavar="FILE", help="Text or CSV of a tracker.")
    ],
    machine: Annotated[
        Path, typer.Option(metavar="MACHINE.json", help="The machine it measured.")
    ],
    path: Annotated[
        Path,
        typer.Option(
            metavar="PATH", help="path.csv, points.csv, or the NC program that ran."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="BUNDLE", help="Bundle to write.")
    ],
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE=NAME",
            help="A column by name or number: x y z time date status point NAME_degC.",
        ),
    ] = None,
    unit: Annotated[
        Literal["", "mm", "m", "inch", "um", "cm", "ft"],
        typer.Option(help="Of positions."),
    ] = "",
    time_unit: Annotated[
        Literal["", "s", "ms", "us"], typer.Option(help="Of times that are numbers.")
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", min=0.01, help="Rows come so often, none missing."),
    ] = None,
    decimal: Annotated[
        Literal["", "point", "comma"], typer.Option(help="Mark of decimals.")
    ] = "",
    delimiter: Annotated[
        Literal["", "tab", "semicolon", "comma", "blank"],
        typer.Option(help="What separates columns."),
    ] = "",
    valid: Annotated[
        list[str] | None, typer.Option(help="Status of samples that may be used.")
    ] = None,
    axes: Annotated[
        str, typer.Option(help="The file's axes that become x, y, z: x,-y,z.")
    ] = "x,y,z",
    date_order: Annotated[
        Literal["", "dmy", "mdy"], typer.Option(help="Order of day and month.")
    ] = "",
    across_midnight: Annotated[
        bool, typer.Option("--across-midnight", help="The time of day starts anew.")
    ] = False,
    dialect: Annotated[
        str, typer.Option(help="Control whose NC program is given as the path.")
    ] = "",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what is recognised, write nothing.")
    ] = False,
    json: Json = False,
) -> None:
    """A recording of any tracker's software, as a bundle for `analyse`."""
    from truepath.alignment.observations.cell_blocks import order_shots
    from truepath.documents.whole_files import read_whole
    from truepath.files.bundle.bundle import write_bundle
    from truepath.files.bundle.commanded_file import read_point_names
    from truepath.files.bundle.recorded_files import MAX_STREAM_TEXT_BYTES
    from truepath.files.bundle.run import Run
    from truepath.files.imports.columns import TextOptions, parse_columns
    from truepath.files.imports.recording import read_recording

    require_folder(output, "the bundle")
    options = TextOptions(
        delimiter=delimiter,
        decimal=decimal,
        columns=parse_columns(column or []),
        unit=unit,
        time_unit=time_unit,
        date_order=date_order,
        across_midnight=across_midnight,
        rate_hz=rate,
        valid=tuple(valid or []),
        axes=axes,
    )
    known, commanded, source = _read_commanded(machine, path, dialect)
    data = read_whole(recording, largest_bytes=MAX_STREAM_TEXT_BYTES)
    names = read_point_names(path) if path.suffix.lower() == _CSV else ()
    read = read_recording(
        data, str(recording), commanded, options, names, partial(order_shots, known)
    )
    run = Run(
        name=recording.stem,
        machine=known,
        commanded=read.commanded,
        tracker=read.samples,
        points=read.points,
        temperature=read.temperature,
        events=read.events,
        stream_file=str(recording),
        provenance={"started": read.started} if read.started else {},
    )
    problems, notes = _compare_with_commanded(run, read)
    if not json:
        _print_recording(read, source, notes)
    if not (dry_run or problems):
        write_bundle(run, output)
    files = [] if dry_run or problems else list_files(output)
    if json:
        print_json(_summarise(read, source, notes, problems, files))
    else:
        print_files(files)
    _reject(problems, recording)


def _reject(problems: Sequence[BadInput], recording: Path) -> None:
    if len(problems) > 1:
        for problem in problems:
            say(f"problem: {problem}")
        raise BadInput(f"{recording}: {len(problems)} problems, listed above")
    for problem in problems:
        raise problem


def _read_commanded(machine: Path, path: Path, dialect: str) -> tuple[Any, Any, str]:
    from truepath.files.bundle.commanded_file import read_commanded_program, read_set_up
    from truepath.files.bundle.machine_file import read_machine

    if path.suffix.lower() == _CSV:
        return *read_set_up(machine, path), "rows"
    known = read_machine(machine)
    commanded, name = read_commanded_program(path, known, dialect)
    return known, commanded, f"NC program, {name}"


def _compare_with_commanded(
    run: Run, read: Recording
) -> tuple[list[BadInput], list[str]]:
    """All problems, and notes on the differences from the commanded rows. A difference
    may follow from a known problem: then it is not reported too.
    """
    from truepath.alignment.align import align

    problems: list[BadInput] = [*read.problems]
    if not (run.tracker.status == 0).any():
        return problems, [*read.notes]
    try:
        seen = align(run)
    except AlignmentError as error:
        mirrored = replace(
            run.tracker, position_mm=run.tracker.position_mm * [1.0, -1.0, 1.0]
        )
        try:
            align(replace(run, tracker=mirrored))
        except AlignmentError:
            why = f"the recording does not fit what was commanded: {error}"
            return problems or [BadInput(why)], [*read.notes]
        why = (
            "the recording fits what was commanded only mirrored: its axes are "
            "left-handed or two are swapped; say which by --axes (x,-y,z or y,x,z)"
        )
        return [*problems, BadInput(why)], [*read.notes]
    from truepath.results.result_assessment import assess_recording

    said = [str(reason) for reason in assess_recording(seen).reasons]
    return problems, [*read.notes, *said]


def _print_recording(read: Recording, source: str, notes: Sequence[str]) -> None:
    from rich.markup import escape  # else "[mm]" is taken for a style

    rows = [
        (escape(c.name), str(c.index + 1), c.role or "left out", c.unit, escape(cell))
        for c, cell in zip(read.columns, read.first_row, strict=True)
    ]
    print_table("columns", ["name", "number", "read as", "unit", "first row"], rows)
    facts = {**read.facts, "commanded": source}
    print_table("recording", ["what", "read as"], list(facts.items()))
    for note in notes:
        say(f"note: {note}")


def _summarise(
    read: Recording,
    source: str,
    notes: Sequence[str],
    problems: Sequence[BadInput],
    files: list[Path],
) -> dict[str, Any]:
    columns = [
        {"number": c.index + 1, "name": c.name, "role": c.role, "unit": c.unit}
        for c in read.columns
    ]
    return {
        "schema": "import-summary/1",
        "columns": columns,
        **read.facts,
        "commanded": source,
        "row_of_point": read.row_of,
        "notes": [*notes],
        "problems": [str(problem) for problem in problems],
        "files": files,
    }
