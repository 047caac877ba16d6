"""A result against a direct measurement, for a person and for scripts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from app.cli.terminal import print_json, print_table
from app.errors import BadInput
from app.reporting.comparison_output import compare_files
from app.results.comparison import ReferenceUncertainty

_UNITS = (("um", "µm"), ("urad", "µrad"))


def compare_result(
    result: Path,
    reference: Path,
    output: Path,
    uncertainty: ReferenceUncertainty,
    *,
    as_json: bool,
) -> None:
    """Compare a result file with a reference and write the three files."""
    if output.exists() and not output.is_dir():
        raise BadInput(f"{output}: is a file; name a folder for the comparison")
    content = compare_files(result, reference, output, uncertainty)
    files = sorted(str(path) for path in output.iterdir() if path.is_file())
    if as_json:
        print_json(_summary(content, files))
        return
    columns = ("error", "largest |d|", "mean |d|", "largest |En|", "agree", "")
    title = f"Result less reference, {content['machine']}"
    print_table(title, columns, [*_rows(content)])
    for symbol, reason in content["not_compared"].items():
        print(f"not compared: {symbol}: {reason}")
    for file in files:
        print(file)


def _summary(content: Mapping[str, Any], files: list[str]) -> dict[str, Any]:
    kept = ("largest_difference", "mean_difference", "largest_en", "share_within")
    return {
        "schema": "comparison-summary/1",
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


def _rows(content: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for symbol, error in content["errors"].items():
        unit, shown = next(u for u in _UNITS if f"difference_{u[0]}" in error)
        yield (
            symbol,
            f"{error[f'largest_difference_{unit}']:.2f}",
            f"{error[f'mean_difference_{unit}']:.2f}",
            f"{error['largest_en']:.2f}",
            f"{100.0 * error['share_within']:.0f} %",
            shown,
        )
    for symbol, number in content["numbers"].items():
        unit, shown = next(u for u in _UNITS if f"difference_{u[0]}" in number)
        difference = abs(number[f"difference_{unit}"])
        yield symbol, f"{difference:.2f}", "", f"{abs(number['en']):.2f}", "", shown
