"""A result as compensation files, for a person and for scripts."""

from __future__ import annotations

from pathlib import Path

from app.cli.terminal import print_json, say
from app.compensation.export_files import export_files


def export_compensation(
    result: Path, name: str, output: Path, spacing_mm: float, *, as_json: bool
) -> None:
    """Write the files of a format and say what they leave behind."""
    account = export_files(result, name, output, spacing_mm=spacing_mm)
    sign = account["sign"]
    if not sign["verified"]:
        say(
            "note: the sign is not verified for this control "
            f"({sign['rule']}): try one deliberate value before first use"
        )
    if as_json:
        print_json(account)
        return
    error = account["volumetric_error_um"]
    before, after = error["before"]["mean"], error["after"]["mean"]
    print(f"carries: {account['carries']}")
    print(f"not carried: {account['not_carried']}")
    print(f"mean volumetric error {before:.2f} µm, with these tables {after:.2f} µm")
    print(f"lost between rows: {account['interpolation_loss_um']:.2f} µm at most")
    print(f"do: {account['note']}")
    for statement in account["unobservable"]:
        print(f"not in the tables: {statement}")
    for file in account["files"]:
        print(file)
