"""The commands that use a result: `compare`, `verify`, `export`, `certificate`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from truepath.cli.summary import UNITS, find_unit, print_verdict, warn_of_verdict
from truepath.cli.terminal import (
    Json,
    OutputFile,
    OutputFolder,
    ResultFile,
    list_files,
    print_files,
    print_json,
    print_table,
    require_folder,
    say,
    show_progress,
)
from truepath.errors import ActiveTablesUnknown, BadInput, NotUsable

_SUFFIXES = (".pdf", ".html")  # of certificates
_KEPT_OF_VERIFICATION = (
    "compensated",
    "compensation",
    "verdict",
    "run_verdict",
    "statements",
    "agreement",
    "map_scale",
    "conformity",
    "volumetric_error_um",
    "difference_um",
    "directions",
    "worst",
)


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
    from truepath.answers.comparison import ReferenceUncertainty
    from truepath.answers.comparison_report import compare_files

    require_folder(output, "the comparison")
    uncertainty = ReferenceUncertainty(reference_um, reference_urad)
    content = compare_files(result, reference, output, uncertainty)
    files = list_files(output)
    warn_of_verdict(content["verdict"])
    if json:
        print_json(_summarise_comparison(content, files))
    else:
        _print_comparison(content, files)


def export(
    result: ResultFile,
    format: Annotated[
        str, typer.Option(metavar="F", help="Of the controller; `formats` lists them.")
    ],
    output: OutputFile,
    spacing: Annotated[
        float, typer.Option(min=0.1, help="Of the rows of a table, mm.")
    ] = 10.0,
    unmeasured: Annotated[
        Literal["hold", "fade", "refuse"],
        typer.Option(
            help="Where an axis was not measured: hold the last value, fade to 0, or "
            "refuse to write.",
        ),
    ] = "hold",
    control: Annotated[
        Literal["840d-sl", "828d", "808d"] | None,
        typer.Option(help="Of Siemens: whose room for tables is used. [840d-sl]"),
    ] = None,
    measuring_system: Annotated[
        str | None,
        typer.Option(
            metavar="1|2|X=1,Y=2",
            help="Of Siemens leadscrew tables: the measuring system of the axes that "
            "they are of. [1]",
        ),
    ] = None,
    backlash_reading: Annotated[
        Literal["negative-value", "difference"] | None,
        typer.Option(help="Of Heidenhain's column BACKLASH. [negative-value]"),
    ] = None,
    directions: Annotated[
        Literal["both", "mean"] | None,
        typer.Option(help="Of Fanuc: whether lost motion is in the tables. [both]"),
    ] = None,
    tool_length: Annotated[
        Literal["fixed", "followed"] | None,
        typer.Option(
            help="Of ISG, Etalon: of the measured tool, or of the one in use. [fixed]"
        ),
    ] = None,
    at_temperature: Annotated[
        float | None,
        typer.Option(
            metavar="DEGC",
            help="Of the machine, where RESULT.json is what `temperature` wrote.",
        ),
    ] = None,
    active: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="A table that the control had while it was measured, once for each "
            "file: what is written has it as well, to be loaded in its place.",
        ),
    ] = None,
    difference: Annotated[
        bool,
        typer.Option("--difference", help="Only what the active tables lacked."),
    ] = False,
    accept_verdict: Annotated[
        bool,
        typer.Option(
            "--accept-verdict",
            help="Write the files of a result that is not to be used all the same.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """A controller's compensation file, and the error that remains with it."""
    from truepath.compensation.active_files import read_given_tables
    from truepath.compensation.export import export_files
    from truepath.compensation.tables.error_map import Unmeasured

    chosen = {
        "control": control,
        "measuring_system": measuring_system,
        "backlash_reading": backlash_reading,
        "directions": directions,
        "tool_length": tool_length,
    }
    try:
        account = export_files(
            result,
            format,
            output,
            spacing_mm=spacing,
            unmeasured=Unmeasured(unmeasured),
            choices={key: word for key, word in chosen.items() if word},
            accept_verdict=accept_verdict,
            at_temperature_degc=at_temperature,
            given=read_given_tables(active or (), format, is_difference=difference),
        )
    except ActiveTablesUnknown as error:
        remedy = "--active FILE for each of their files, or --difference"
        raise BadInput(f"{result}: {error}: {remedy}") from error
    except NotUsable as error:
        raise BadInput(f"{error} --accept-verdict writes it all the same") from error
    warn_of_verdict(account["verdict"])
    sign = account["sign"]
    if not sign["verified"]:
        say(
            "note: the sign is not verified for this control "
            f"({sign['rule']}): try one deliberate value before first use"
        )
    if warning := account["lengths"]["warning"]:
        say(f"warning: {warning}")
    if json:
        print_json(account)
    else:
        _print_compensation(account)


def certificate(
    result: ResultFile,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FILE", help=".pdf or .html to write."),
    ],
    as_left: Annotated[
        Path | None,
        typer.Option(metavar="RESULT.json", help="Measured after compensation."),
    ] = None,
    verification: Annotated[
        Path | None, typer.Option(metavar="V.json", help="What `verify` wrote.")
    ] = None,
    compensation: Annotated[
        Path | None,
        typer.Option(metavar="ACCOUNT.json", help="What `export` wrote beside files."),
    ] = None,
    identity: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Serial numbers, operator, customer …"),
    ] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(metavar="FIELD=TEXT", help="One field of the identity."),
    ] = None,
    language: Annotated[Literal["en", "de"], typer.Option()] = "en",
    number: Annotated[
        str, typer.Option(help="Of the certificate; else made from the result.")
    ] = "",
    issued: Annotated[
        datetime | None,
        typer.Option(formats=["%Y-%m-%d"], help="Date of issue; today if left out."),
    ] = None,
    tolerance_um: Annotated[
        float | None,
        typer.Option(min=0.01, help="Of the machine, for 95 % of the volume, µm."),
    ] = None,
    accept_verdict: Annotated[
        bool,
        typer.Option(
            "--accept-verdict",
            help="Issue one for a result that is not to be used all the same.",
        ),
    ] = False,
) -> None:
    """A calibration certificate of a result, as PDF or HTML."""
    from truepath.answers.certificate.document import (
        print_pdf,
        render_certificate,
        require_printer,
    )
    from truepath.answers.certificate.issue import (
        CertificateOrder,
        gather_certificate,
        read_result_source,
    )
    from truepath.documents.whole_files import replace_file
    from truepath.files.bundle.identity_file import (
        FIELDS,
        read_assignments,
        read_identity,
    )

    suffix = output.suffix.lower()
    if suffix not in _SUFFIXES:
        raise BadInput(f"{output}: write a name that ends in {' or '.join(_SUFFIXES)}")
    if suffix == ".pdf":
        require_printer()
    found = read_result_source(result)
    given = read_identity(identity) if identity else {}
    stated = {**given, **read_assignments(state or [])}
    order = CertificateOrder(
        number,
        result,
        issued or datetime.now().astimezone(),
        left=as_left,
        verification=verification,
        compensation=compensation,
        identity=stated,
        language=language,
        tolerance_um=tolerance_um,
    )
    content = replace(gather_certificate(found, order), number=number)
    try:
        html = render_certificate(content, accept_verdict=accept_verdict)
    except NotUsable as error:
        remedy = "--accept-verdict issues it all the same"
        raise BadInput(f"{error} {remedy}") from error
    output.parent.mkdir(parents=True, exist_ok=True)
    replace_file(output, print_pdf(html) if suffix == ".pdf" else html.encode())
    if missing := [name for name in FIELDS if name not in stated]:
        say(f"not stated: {', '.join(missing)}; state them with --state FIELD=TEXT")
    print_files([output])


def _print_compensation(account: Mapping[str, Any]) -> None:
    error = account["volumetric_error_um"]
    print(f"holds {account['basis']['holds']}: {account['basis']['text']}")
    print(f"carries: {account['carries']}")
    print(f"not carried: {account['not_carried']}")
    if stated := account["temperature"]:
        print(f"of temperature: {stated['carried']}")
    print(
        f"mean volumetric error {error['before']['mean']:.2f} µm, "
        f"with these tables {_state_left(error['after'])}, over places that fill the "
        "travel evenly, each direction"
    )
    if account["unmeasured"] and (inside := error["after_where_measured"]):
        print(f"where every axis was measured {_state_left(inside)}")
    reasons = (
        f"{reason.replace('_', ' ')} {value:.2f}"
        for reason, value in account["left_um"].items()
        if reason != "map"
    )
    print(f"of that, root mean squares in µm: {', '.join(reasons)}")
    if over := account["over_all_axes_um"]:
        print(
            f"over the travel of all axes {over['before']:.2f} ± "
            f"{over['before_expanded_uncertainty']:.2f} µm, with these files "
            f"{over['after_expected']:.2f} ± {over['after_expanded_uncertainty']:.2f} "
            f"µm (k = {over['coverage_factor']:g})"
        )
    for axis, one in account["rotary"].items():
        print(f"rotary axis {axis}: {_state_rotary(one)}")
    for statement in account["unmeasured"]:
        print(f"not measured: {statement}")
    print(account["lengths"]["text"])
    print(f"do: {account['note']}")
    for statement in account["unobservable"]:
        print(f"not in the tables: {statement}")
    print_files(account["files"])


def _state_rotary(one: Mapping[str, Any]) -> str:
    parts: list[str] = []
    if table := one["table"]:
        beyond = "each turn" if table["repeats_each_turn"] else "end values beyond"
        parts.append(
            f"table {table['from_deg']:g} to {table['to_deg']:g} deg, {beyond}"
        )
    if angle := one.get("positioning_urad"):
        parts.append(
            f"positioning {_state_change(angle)} µrad, at the tool "
            f"{_state_change(one['at_tool_um'])} µm"
        )
    lost = one["lost_motion_urad"]
    change = f"{_state_change(lost)} µrad, " if lost else ""
    parts.append(f"lost motion {change}{one['lost_motion']}")
    if place := one.get("location_at_tool_um"):
        parts.append(f"its place, at the tool {_state_change(place)} µm")
    if one["not_in_files"]:
        parts.append(f"not in the files: {', '.join(one['not_in_files'])}")
    return f"{'; '.join(parts)} (root mean squares; k = 2)"


def _state_change(left: Mapping[str, float]) -> str:
    return (
        f"{left['before']:.2f} to {left['after_expected']:.2f} "
        f"± {left['after_expanded_uncertainty']:.2f}"
    )


def _state_left(after: Mapping[str, float]) -> str:
    return f"{after['mean']:.2f} ± {2.0 * after['mean_uncertainty']:.2f} µm (k = 2)"


def _print_comparison(content: Mapping[str, Any], files: Sequence[Path]) -> None:
    print_verdict(content["verdict"])
    columns = ("error", "largest |d|", "mean |d|", "largest |En|", "agree", "")
    title = f"Result less reference, {content['machine']}"
    print_table(title, columns, [*_yield_rows(content)])
    for symbol, reason in content["not_compared"].items():
        print(f"not compared: {symbol}: {reason}")
    print_files(files)


def _summarise_comparison(
    content: Mapping[str, Any], files: Sequence[Path]
) -> dict[str, Any]:
    kept = ("largest_difference", "mean_difference", "largest_en", "share_within")
    return {
        "schema": "comparison-summary/1",
        "verdict": content["verdict"],
        "errors": {
            symbol: {k: v for k, v in error.items() if k.startswith(kept)}
            for symbol, error in content["errors"].items()
        },
        "numbers": content["numbers"],
        "kinds": content["kinds"],
        "volumetric": content["volumetric"],
        "not_compared": content["not_compared"],
        "files": files,
    }


def _yield_rows(content: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for symbol, error in content["errors"].items():
        unit = find_unit(error, "difference")
        yield (
            symbol,
            f"{error[f'largest_difference_{unit}']:.2f}",
            f"{error[f'mean_difference_{unit}']:.2f}",
            f"{error['largest_en']:.2f}",
            f"{100.0 * error['share_within']:.0f} %",
            UNITS[unit],
        )
    for symbol, number in content["numbers"].items():
        unit = find_unit(number, "difference")
        difference, en = abs(number[f"difference_{unit}"]), abs(number["en"])
        yield symbol, f"{difference:.2f}", "", f"{en:.2f}", "", UNITS[unit]


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
        kept = {key: content[key] for key in _KEPT_OF_VERIFICATION}
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
    title = f"Volumetric error of {content['machine']}, noise deducted"
    print_table(title, columns, rows)
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
        title = "Lines, µm (k = 2), noise deducted from A and R"
        print_table(title, ("line", *"AERBM"), rows)
    rows = [
        (
            f"{one['plane']} r {one['radius_mm']:.0f} mm",
            *(_state_figure(one, name) for name in ("G", "F_max", "F_min")),
        )
        for one in content["circles"]
    ]
    if rows:
        columns = ("circle", "G", "F max", "F min")
        print_table("Circles, µm (k = 2), noise deducted", columns, rows)
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
        title = "Circles in motion, µm (k = 2), noise deducted"
        print_table(title, ("circle", *names), rows)


def _state_figure(one: Mapping[str, Any], name: str) -> str:
    if name not in one["figures_um"]:
        return "—"
    expanded = 2.0 * one["uncertainty_um"][name]
    return f"{one['figures_um'][name]:.1f} ± {expanded:.1f}"
