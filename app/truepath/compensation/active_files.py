"""Compensation files that a controller applies during a measurement."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.compensation.format import CompensationFormat, Correction
from truepath.compensation.format_registry import load_format
from truepath.documents.file_model import as_object, parse_json
from truepath.documents.whole_files import read_whole
from truepath.errors import ActiveTablesUnknown, BadInput, BundleError
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.machine.machine import Machine
from truepath.plugins import PluginFailed

CONTROL, ON, OFF, MIXED = "control_compensation", "on", "off", "mixed"
_HOLDS = {
    "as-found": "the whole error: measured while the control did not compensate",
    "as-measured": "the error as it was measured; nothing says whether the control "
    "compensated: if it did, this is what its tables lacked",
    "combined": "the tables that were active and what they lacked, to be loaded in "
    "their place",
    "difference": "only what the active tables lacked: to be added to these, not to be "
    "loaded in their place",
}


@dataclass(frozen=True, slots=True)
class ActiveFiles:
    """Files of a format, and the correction that a controller adds with them.

    texts : by name; files_sha256 : digest by name
    before : the files that these replace, active during the measurement from which
        these were made; made_of : digest of its data, where the account has it
    """

    format: str
    files_sha256: Mapping[str, str]
    texts: Mapping[str, str]
    kind: CompensationFormat
    machine: Machine
    correction: Correction
    before: ActiveFiles | None = None
    made_of: str = ""

    def describe(self) -> dict[str, Any]:
        """Format and digests, as in a verification."""
        return {"format": self.format, "files_sha256": dict(self.files_sha256)}

    def additional_correction(
        self, place: Float64[np.ndarray, "n a"], direction: float
    ) -> Float64[np.ndarray, "n 3"]:
        """Correction beyond that of the files active during the measurement, mm."""
        before = self.before.correction(place, direction) if self.before else 0.0
        return self.correction(place, direction) - before

    def additional_correction_at(self, at: Conditions) -> Float64[np.ndarray, "n 3"]:
        """The same for conditions that give the direction of approach of each axis.

        A format corrects lost motion along the axis that it belongs to: half the
        difference of both directions counts by the last motion of that axis.
        """
        columns = [self.machine.axis_names.index(name) for name in "XYZ"]
        forward, back = (
            self.additional_correction(at.position_mm, side) for side in (1.0, -1.0)
        )
        return 0.5 * (forward + back + (forward - back) * at.approach[:, columns])

    def relate_to_result(self, provenance: Mapping[str, Any]) -> ActiveFiles:
        """The files as a change to the errors of a result. Raises BadInput."""
        if self.made_of == provenance.get("input_sha256"):
            return self
        if read_control_state(provenance) == ON:
            raise BadInput(
                f"{', '.join(self.texts)}: the result was measured while the control "
                "compensated, and these files were not exported from it: name files "
                "that were, with their account, or none if the tables are as they were"
            )
        return replace(self, before=None)


@dataclass(frozen=True, slots=True)
class GivenTables:
    """Tables of the control during the measurement, as far as stated.

    data : the files by name; account : of these, where it is known
    is_difference : the new files are to hold the difference from these, not the sum
    """

    data: Mapping[str, bytes] = field(default_factory=dict[str, bytes])
    account: Mapping[str, Any] = field(default_factory=dict[str, Any])
    is_difference: bool = False


def read_control_state(provenance: Mapping[str, Any]) -> str | None:
    """`on`, `off` or `mixed`: whether the control compensated; None if unknown."""
    source = as_object(provenance.get("source"))
    return provenance.get(CONTROL) or source.get(CONTROL)


def find_basis(
    provenance: Mapping[str, Any],
    name: str,
    machine: Machine,
    choices: Mapping[str, str],
    given: GivenTables,
) -> tuple[dict[str, Any], ActiveFiles | None]:
    """Basis of the files of a result for their account, and the files they replace.

    provenance : of the result; name, choices : of the format

    Raises ActiveTablesUnknown, or BadInput for tables that were not active.
    """
    control, active, named = read_control_state(provenance), None, None
    stated = provenance.get("active_tables")
    if control == MIXED:
        raise BadInput(
            "the Runs of this result were not measured alike: the control compensated "
            "in some alone, or by other tables; export a result of Runs that were"
        )
    if given.data:
        if control == OFF or given.is_difference or "followed" in choices.values():
            raise BadInput(
                f"{', '.join(given.data)}: active tables are of no use where none were "
                "on, for a difference, or for tools that are followed: leave them out"
            )
        account = {"choices": choices, **given.account}
        active = make_active_files(given.data, name, machine, account)
        if stated not in (None, active.files_sha256):
            raise BadInput(
                f"{', '.join(given.data)}: the control had other tables, by their "
                f"SHA-256 in the result: {', '.join(stated)}"
            )
        if active.kind.composes_rotary and machine.rotary_axes:
            raise BadInput(
                f"{name} of a machine with rotary axes is not combined with active "
                "tables: measure with the compensation off, or ask for the difference"
            )
        named = active.describe() | {
            "choices": account["choices"],
            "texts": active.texts,
        }
    elif control == ON and not given.is_difference:
        raise ActiveTablesUnknown(
            "the control compensated while this was measured: files of what its tables "
            "lack would undo them; give the active tables, or ask for the difference"
        )
    holds = "combined" if active else "as-measured"
    if control == OFF:
        holds = "as-found"
    elif given.is_difference:
        holds = "difference"
    text = _HOLDS[holds]
    return {"holds": holds, CONTROL: control, "text": text, "active": named}, active


def read_given_tables(
    files: Sequence[Path], name: str, *, is_difference: bool
) -> GivenTables:
    """Active tables in files, with the account for reading them."""
    data = {file.name: read_whole(file) for file in files}
    account: Mapping[str, Any] = {}
    if files:
        account = _find_account(files[0].parent, name, data)
    return GivenTables(data, account, is_difference)


def read_active_files(
    files: Sequence[Path], name: str | None, machine: Machine
) -> ActiveFiles | None:
    """Files of a format and their correction; None where there are none.

    They are read with the choices of the account in their folder, if there is one.

    Raises BadInput if the format is not named, or a file is not of it.
    """
    if not files:
        if name is not None:
            raise BadInput(f"--format {name}: name its files with --compensation FILE")
        return None
    if name is None:
        raise BadInput(
            f"{files[0]}: say its format with --format; `formats` lists them"
        )
    given = read_given_tables(files, name, is_difference=False)
    return make_active_files(given.data, name, machine, given.account)


def make_active_files(
    data: Mapping[str, bytes], name: str, machine: Machine, account: Mapping[str, Any]
) -> ActiveFiles:
    """Files by name as the controller of a format reads them. Raises BadInput.

    account : of these files, as far as it is known
    """
    texts = {file: each.decode("utf-8", "replace") for file, each in data.items()}
    kind = load_format(name, as_object(account.get("choices")))
    try:
        correction = kind.read(texts, machine)
    except (ValueError, LookupError, PluginFailed) as error:
        raise BadInput(
            f"{', '.join(texts)}: cannot be read as files of {name} ({error}); give "
            "the files of one export, as it wrote them"
        ) from error
    made_of = str(as_object(account.get("provenance")).get("input_sha256", ""))
    old, before = as_object(as_object(account.get("basis")).get("active")), None
    if older := {n: str(t).encode() for n, t in as_object(old.get("texts")).items()}:
        before = make_active_files(older, name, machine, old)
    digests = _digest(data)
    return ActiveFiles(name, digests, texts, kind, machine, correction, before, made_of)


def _digest(data: Mapping[str, bytes]) -> dict[str, str]:
    return {file: hashlib.sha256(each).hexdigest() for file, each in data.items()}


def _find_account(
    folder: Path, name: str, data: Mapping[str, bytes]
) -> Mapping[str, Any]:
    digests = _digest(data)
    for place in sorted(folder.glob("*.json")):
        with suppress(BundleError):
            account = as_object(parse_json(read_whole(place), place.name))
            if (account.get("format"), account.get("files_sha256")) == (name, digests):
                return account
    return {}
