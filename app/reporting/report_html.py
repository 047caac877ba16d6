"""The report for people: one HTML file that needs nothing else.

The order is that of ISO/TR 16907: machine and measurement, error motions, volumetric
error, what was left, what cannot be told, validation, documentation. Uncertainties are
expanded ones (k = 2).
"""

from __future__ import annotations

from app.reporting.html_parts import escape, figure_text, tile
from app.reporting.report_direction import direction
from app.reporting.report_effects import effects
from app.reporting.report_errors import error_motions, squareness, volumetric
from app.reporting.report_measurement import (
    GOOD_FIT,
    documentation,
    fit_ratio,
    machine_and_measurement,
    residuals_and_noise,
    unobservable,
    validation,
)
from app.reporting.report_runs import measured_how
from app.reporting.report_style import STYLE
from app.results.findings import Findings
from app.results.numbers_as_text import plain


def report_html(found: Findings) -> str:
    """Return the report."""
    name = escape(found.estimate.model.machine.name)
    sections = (
        machine_and_measurement,
        error_motions,
        squareness,
        direction,
        volumetric,
        residuals_and_noise,
        unobservable,
        *(() if found.provenance.model is None else (effects,)),
        validation,
        documentation,
    )
    body = "".join(part(number, found) for number, part in enumerate(sections, start=1))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: calibration report</title>\n<style>{STYLE}</style>\n</head>\n"
        f"<body><main>\n{_header(found, name)}{_tiles(found)}{body}{_footer(found)}"
        "</main></body>\n</html>\n"
    )


def _header(found: Findings, name: str) -> str:
    created = found.provenance.created
    return (
        f"<header><p class=kind>Geometric calibration report</p><h1>{name}</h1>"
        f"<p>{measured_how(found)} by laser tracker, analysed "
        f"{created:%Y-%m-%d %H:%M} {escape(created.tzname() or '')}</p></header>\n"
    )


def _tiles(found: Findings) -> str:
    before, after = found.volumetric.before, found.volumetric.after
    left = 100.0 * after.mean.value_um / max(before.mean.value_um, 1e-12)
    known = len(found.tables.tables)
    motions = 6 * len(found.estimate.model.machine.axes)
    ratio = fit_ratio(found)
    tiles = (
        tile(
            plain(before.mean.value_um),
            "µm",
            "Mean volumetric error",
            f"largest {figure_text(before.largest)} µm in the travel",
        ),
        tile(
            plain(after.mean.value_um, 2),
            "µm",
            "After compensation",
            f"expected: {left:.1f} % of it stays; a separate measurement confirms",
            "good",
        ),
        tile(
            plain(ratio, 2),
            "× noise",
            "Residual of the model",
            "the model explains the measurement"
            if ratio <= GOOD_FIT
            else "the model lacks something, see section 6",
            "good" if ratio <= GOOD_FIT else "warn",
        ),
        tile(
            str(known),
            f"of {motions}",
            "Error motions told apart",
            "all of them"
            if known == motions
            else "the others need another target, see section 7",
        ),
    )
    return f'<div class="tiles">{"".join(tiles)}</div>\n'


def _footer(found: Findings) -> str:
    return (
        f"<footer>truepath {escape(found.provenance.software_version)} · uncertainties "
        "in this report are expanded, k = 2 (about 95 %); those in the result files "
        "are standard, k = 1</footer>\n"
    )
