"""The files of an analysis: Runs in; result, tables and report out.

The report is one HTML file that needs no other. Its sections are in the order of ISO/TR
16907: machine and measurement, error motions, volumetric error, residuals, limits,
validation, documentation. Uncertainties are expanded (k = 2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from truepath.answers.calibration.error_sections import (
    describe_direction,
    describe_effects,
    describe_error_motions,
    describe_squareness,
    describe_volume,
    state_figure,
)
from truepath.answers.calibration.measurement_sections import (
    GOOD_FIT,
    describe_documentation,
    describe_limits,
    describe_machine,
    describe_residuals,
    describe_validation,
    name_runs,
    residual_over_noise,
)
from truepath.answers.shown.templating import View, render_page, render_part
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.errors import BundleError
from truepath.files.bundle.run import Run
from truepath.results.error_tables import error_tables_csv
from truepath.results.result_json import result_json
from truepath.results.result_summary import Findings

RESULT, TABLES, REPORT = "result.json", "error_tables.csv", "report.html"
_SECTIONS: dict[str, Callable[[Findings], View]] = {
    "machine": describe_machine,
    "error_motions": describe_error_motions,
    "squareness": describe_squareness,
    "direction": describe_direction,
    "volume": describe_volume,
    "residuals": describe_residuals,
    "limits": describe_limits,
    "effects": describe_effects,
    "validation": describe_validation,
    "documentation": describe_documentation,
}


@dataclass(frozen=True, slots=True)
class Analysis:
    """Contents of the files of an analysis.

    result : content of `result.json`; the others are texts of the files of that name
    """

    found: Findings
    result: dict[str, Any]
    tables_csv: str
    report_html: str


def read_runs(
    places: Sequence[str | Path], read: Callable[[Path], Run]
) -> tuple[Run, ...]:
    """Raises BundleError; of several Runs `file` begins with the name of that Run."""
    return tuple(_read(Path(place), read, len(places)) for place in places)


def _read(place: Path, read: Callable[[Path], Run], count: int) -> Run:
    try:
        return read(place)
    except BundleError as error:
        if count == 1:
            raise
        raise BundleError(
            error.problem,
            file=f"{place.name}: {error.file}",
            row=error.row,
            column=error.column,
            remedy=error.remedy,
        ) from error


def render_analysis(found: Findings) -> Analysis:
    """`result.json`, `error_tables.csv` and `report.html`, not yet written."""
    return Analysis(
        found,
        result_json(found),
        error_tables_csv(found.tables, found.verdict),
        render_calibration_report(found),
    )


def write_analysis(analysis: Analysis, folder: str | Path) -> None:
    """`result.json`, `error_tables.csv` and `report.html` in a folder, each whole."""
    # The result last: where it exists, the others exist as well.
    files = {
        TABLES: analysis.tables_csv.encode(),
        REPORT: analysis.report_html.encode(),
        RESULT: encode_json(analysis.result),
    }
    write_files(Path(folder), files)


def render_calibration_report(findings: Findings) -> str:
    """One HTML page with its style sheet and figures inside."""
    before, after = findings.volumetric.before, findings.volumetric.after
    both = findings.both_directions
    created = findings.provenance.created
    return render_page(
        "calibration.html",
        {
            "machine": findings.estimate.model.machine.name,
            "measured": name_runs(findings),
            "created": f"{created:%Y-%m-%d %H:%M} {created.tzname() or ''}",
            "verdict": findings.verdict,
            "before": before.mean.value_um,
            "largest": state_figure(before.largest),
            "both": both and state_figure(both.before.mean),
            "lost": both and state_figure(both.left.mean),
            "after": after.mean.value_um,
            "share": after.mean.value_um / max(before.mean.value_um, 1e-12),
            "ratio": residual_over_noise(findings),
            "good_fit": GOOD_FIT,
            "known": len(findings.tables.tables),
            "motions": 6 * len(findings.estimate.model.machine.axes),
            "software": findings.provenance.software_version,
            "number_of": _number_sections(findings),
            "sections": [
                render_section(name, findings) for name in _number_sections(findings)
            ],
        },
    )


def render_section(name: str, findings: Findings) -> Markup:
    """The same markup as in the report, with the section's number there."""
    numbers = _number_sections(findings)
    common = {"findings": findings, "number": numbers[name], "number_of": numbers}
    view = common | _SECTIONS[name](findings)
    return render_part(f"calibration/{name}.html", view)


def _number_sections(findings: Findings) -> dict[str, int]:
    has_model = findings.provenance.model is not None
    names = [name for name in _SECTIONS if has_model or name != "effects"]
    return {name: number for number, name in enumerate(names, start=1)}
