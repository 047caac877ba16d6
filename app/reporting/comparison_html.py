"""The comparison for people: one HTML file that needs nothing else."""

from __future__ import annotations

from app.kinematics.machine import Machine
from app.reporting.axis_panels import SIGN
from app.reporting.comparison_figures import axis_figure, volume_figure
from app.reporting.html_parts import drawing, escape, section, table
from app.reporting.report_style import STYLE
from app.results.comparison import ComparedError, Comparison, K, described
from app.results.comparison_files import KINDS, agreeing, kind_of, largest
from app.results.comparison_volume import ComparedVolume, mean_length
from app.results.numbers_as_text import expanded, plain


def comparison_html(
    machine: Machine,
    comparison: Comparison,
    volume: ComparedVolume | None,
    names: dict[str, str],
) -> str:
    """Return the page.

    names : of the result and the reference
    """
    name = escape(machine.name)
    parts = [_overview(1, comparison), _figures(2, machine, comparison)]
    if volume is not None:
        parts.append(_volume(3, volume))
    parts.append(_left_out(len(parts) + 1, comparison))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: comparison</title>\n<style>{STYLE}</style>\n</head>\n"
        "<body><main>\n<header><p class=kind>Comparison with a direct measurement</p>"
        f"<h1>{name}</h1><p>{escape(names['result'])} against "
        f"{escape(names['reference'])}</p></header>\n{''.join(parts)}"
        "<footer>U is expanded, k = 2 (about 95 %)</footer>\n</main></body>\n</html>\n"
    )


def _overview(number: int, comparison: Comparison) -> str:
    rows = [_row(error) for kind in KINDS for error in _of_kind(comparison, kind)]
    rows += [
        (
            f"<code>{n.symbol}</code>",
            f"result {expanded(n.value, n.sigma)} {SIGN[n.unit]}, reference "
            f"{expanded(n.reference, n.reference_sigma)} {SIGN[n.unit]}",
            f"{plain(abs(n.difference), 2)} {SIGN[n.unit]}",
            "",
            f"{plain(K * n.combined, 2)} {SIGN[n.unit]}",
            plain(abs(n.normalised), 2),
            "yes" if abs(n.normalised) <= 1.0 else "no",
        )
        for n in comparison.numbers
    ]
    head = (
        "Symbol",
        "Error",
        "largest |d|",
        "mean |d|",
        "largest U",
        "largest |E<sub>n</sub>|",
        "agree",
    )
    text = (
        "d is result less reference, both in one convention over the positions that "
        "both know: positioning and turns are 0 at the axis zero, else at the lowest "
        "position; straightness is 0 there and at the highest. E<sub>n</sub> = d / U; "
        "|E<sub>n</sub>| ≤ 1 says that both agree within U, which is that of the "
        "difference. “agree” is the share of positions where they do."
    )
    return section(
        number,
        "Error by error",
        table(head, rows, numbers=2),
        f"<p class=note>{text}</p>",
    )


def _of_kind(comparison: Comparison, kind: str) -> list[ComparedError]:
    return [e for e in comparison.errors if kind_of(e.symbol) == kind]


def _row(error: ComparedError) -> tuple[str, ...]:
    unit = SIGN[error.unit]
    mean = float(abs(error.difference).mean())
    return (
        f"<code>{error.symbol}</code>",
        escape(described(error)),
        f"{plain(largest(error), 2)} {unit}",
        f"{plain(mean, 2)} {unit}",
        f"{plain(K * float(error.combined.max()), 2)} {unit}",
        plain(float(abs(error.normalised).max()), 2),
        f"{plain(100.0 * agreeing(error), 0)} %",
    )


def _figures(number: int, machine: Machine, comparison: Comparison) -> str:
    caption = (
        "Result with its band of ±U (k = 2). Crosses: the direct measurement, one "
        "direction each, with bars of one standard deviation over its runs."
    )
    parts = [
        f"<h3>Axis {axis.name}</h3>" + drawing(axis_figure(comparison, axis), caption)
        for axis in machine.axes
        if any(e.symbol[2] == axis.name for e in comparison.errors)
    ]
    return section(number, "Error motions", *parts)


def _volume(number: int, volume: ComparedVolume) -> str:
    rows = [
        ("Result", plain(mean_length(volume.value_um), 2)),
        ("Reference", plain(mean_length(volume.reference_um), 2)),
        ("Difference", plain(mean_length(volume.difference_um), 2)),
    ]
    text = (
        f"On a regular grid of {len(volume.position)} points over the range of the "
        "reference, of the errors that both know, squareness left out."
    )
    caption = (
        "Left: the difference by component. Right: where it points, from the dots."
    )
    return section(
        number,
        "Volumetric error",
        table(("Mean length", "µm"), rows, numbers=1),
        f"<p class=note>{text}</p>",
        drawing(volume_figure(volume), caption),
    )


def _left_out(number: int, comparison: Comparison) -> str:
    rows = [
        (f"<code>{escape(symbol)}</code>", escape(reason))
        for symbol, reason in comparison.not_compared.items()
    ]
    if not rows:
        return section(number, "Not compared", "<p>Every error was compared.</p>")
    return section(number, "Not compared", table(("Symbol", "Reason"), rows, numbers=2))
