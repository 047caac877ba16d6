"""Compensation files ordered for a result: made, stored, read back."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from truepath.compensation.active_files import (
    ActiveFiles,
    GivenTables,
    make_active_files,
)
from truepath.compensation.export import SPACING_MM, export_files
from truepath.compensation.stored_files import ACCOUNT, STEM, read_account
from truepath.compensation.tables.error_map import Unmeasured
from truepath.documents.whole_files import read_whole
from truepath.files.earlier.result_file import read_result
from truepath.kinematics.machine.machine import Machine


@dataclass(frozen=True, slots=True)
class CompensationOrder:
    """The requested files.

    format : name of an installed one; spacing_mm : of the rows
    unmeasured : content of tables where an axis was not measured
    choices : of the format, by name
    given : tables of the control during the measurement, where stated
    """

    format: str
    spacing_mm: float = SPACING_MM
    unmeasured: Unmeasured = Unmeasured.HOLD
    choices: Mapping[str, str] = field(default_factory=dict[str, str])
    given: GivenTables = field(default_factory=GivenTables)

    @property
    def name(self) -> str:
        """Unique per result: the same order makes the same files."""
        chosen = "".join(f"-{self.choices[key]}" for key in sorted(self.choices))
        spacing = repr(float(self.spacing_mm)).removesuffix(".0")
        given = "-difference" if self.given.is_difference else ""
        if self.given.data:
            every = sorted(hashlib.sha256(d).digest() for d in self.given.data.values())
            given += f"-combined-{hashlib.sha256(b''.join(every)).hexdigest()[:8]}"
        return f"{self.format}-{spacing}-{self.unmeasured.value}{chosen}{given}"


def store_files(
    source: Path, folder: Path, order: CompensationOrder, *, accept_verdict: bool
) -> tuple[str, dict[str, Any]]:
    """Name of the files, written below `folder`, and their account.

    source : a result or model file; active tables that the service has made itself need
        not be given

    Raises what `export_files` raises.
    """
    order = _find_given(source, folder, order)
    export_files(
        source,
        order.format,
        folder / order.name / STEM,
        spacing_mm=order.spacing_mm,
        unmeasured=order.unmeasured,
        choices=order.choices,
        accept_verdict=accept_verdict,
        given=order.given,
    )
    return order.name, read_account(folder, order.name)


def _find_given(
    source: Path, folder: Path, order: CompensationOrder
) -> CompensationOrder:
    given, stated = order.given, read_result(source).provenance.get("active_tables")
    if not (given.data or given.is_difference) and stated:
        for kept in folder.parent.parent.glob(f"*/{folder.name}/*/{ACCOUNT}"):
            account = json.loads(kept.read_bytes())
            if account.get("files_sha256") == stated:
                data = {name: read_whole(kept.parent / name) for name in stated}
                return replace(order, given=GivenTables(data, account))
    return order


def read_stored_files(folder: Path, machine: Machine) -> ActiveFiles:
    """Files that are stored with a result. Raises NotFound."""
    account = read_account(folder.parent, folder.name)
    data = {name: read_whole(folder / name) for name in account["files"]}
    return make_active_files(data, account["format"], machine, account)
