"""A comparison with a direct measurement: its page, one HTML file, and its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from truepath.app.files.file_model import encode_json
from truepath.app.files.recorded_files import decode_reference
from truepath.app.files.result_file import read_result
from truepath.app.files.verdict import Verdict
from truepath.app.files.whole_files import write_files
from truepath.app.kinematics.machine import Machine
from truepath.app.kinematics.symbols import describe_symbol
from truepath.app.reporting.comparison_figures import draw_error_motions, draw_volume
from truepath.app.reporting.templating import View, render_page
from truepath.app.results.comparison import (
    ComparedError,
    ComparedNumber,
    ComparedVolume,
    Comparison,
    K,
    ReferenceUncertainty,
    compare,
    compare_volumes,
    mean_length,
)
from truepath.app.results.comparison_files import (
    KINDS,
    classify,
    comparison_csv,
    comparison_json,
    compute_agreement,
)
from truepath.app.results.number_format import SIGN, format_expanded, format_number


def render_comparison_report(
    machine: Machine,
    comparison: Comparison,
    volume: ComparedVolume | None,
    names: dict[str, str],
    verdict: Verdict,
) -> str:
    """Return the page.

    names : of the result and the reference; verdict : of the result
    """
    errors = [
        e for kind in KINDS for e in comparison.errors if classify(e.symbol) == kind
    ]
    return render_page(
        "comparison.html",
        {
            "machine": machine.name,
            "verdict": verdict,
            "result": names["result"],
            "reference": names["reference"],
            "rows": [_state_number(one) for one in (*errors, *comparison.numbers)],
            "axes": [
                {"name": axis.name, "figure": draw_error_motions(comparison, axis)}
                for axis in machine.axes
                if any(e.symbol[2] == axis.name for e in errors)
            ],
            "volume": None if volume is None else _describe_volume(volume),
            "not_compared": list(comparison.not_compared.items()),
        },
    )


def _state_number(number: ComparedNumber) -> tuple[str, ...]:
    unit = SIGN[number.unit]
    largest, expanded, normalised = (
        format_number(float(abs(values).max()), 2)
        for values in (number.difference, K * number.combined, number.normalised)
    )
    if isinstance(number, ComparedError):
        text = _describe_motion(number)
        mean = f"{format_number(float(abs(number.difference).mean()), 2)} {unit}"
        agreement = f"{format_number(100.0 * compute_agreement(number), 0)} %"
    else:
        result = format_expanded(float(number.value), float(number.sigma))
        sigma = float(number.reference_sigma)
        reference = format_expanded(float(number.reference), sigma)
        text = f"result {result} {unit}, reference {reference} {unit}"
        mean, agreement = "", "yes" if abs(number.normalised) <= 1.0 else "no"
    stated = f"{largest} {unit}", mean, f"{expanded} {unit}", normalised, agreement
    return number.symbol, text, *stated


def _describe_motion(error: ComparedError) -> str:
    text = describe_symbol(error.symbol)
    if error.merged:
        text += f", with its share of {', '.join(error.merged)}"
    if error.missing:
        text += f"; holds a share of {', '.join(error.missing)}, not in the reference"
    return text


def _describe_volume(volume: ComparedVolume) -> View:
    lengths = (
        ("Result", volume.value_um),
        ("Reference", volume.reference_um),
        ("Difference", volume.difference_um),
    )
    return {
        "rows": [
            (name, format_number(mean_length(vector), 2)) for name, vector in lengths
        ],
        "points": len(volume.position),
        "figure": draw_volume(volume),
    }


COMPARISON, TABLE, PAGE = "comparison.json", "comparison.csv", "comparison.html"


def compare_files(
    result: str | Path,
    reference: str | Path,
    folder: str | Path,
    instrument: ReferenceUncertainty,
) -> dict[str, Any]:
    """Compare and write the three files into a folder; return the content of the JSON.

    Raises BundleError with the place, BadInput if nothing can be compared.
    """
    loaded = read_result(result)
    direct = decode_reference(Path(reference).read_bytes(), file=str(reference))
    comparison = compare(loaded, direct, instrument)
    volume = compare_volumes(loaded.machine, comparison)
    names = {
        "machine": loaded.machine.name,
        "result": Path(result).name,
        "reference": Path(reference).name,
    }
    verdict = loaded.verdict
    content = comparison_json(comparison, volume, names, verdict)
    page = render_comparison_report(loaded.machine, comparison, volume, names, verdict)
    files = {
        TABLE: comparison_csv(comparison).encode(),
        PAGE: page.encode(),
        COMPARISON: encode_json(content),
    }
    write_files(Path(folder), files)
    return content
