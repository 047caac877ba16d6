"""Compensation files as a controller applies them while it is measured."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.compensation.format import Correction
from truepath.app.compensation.installed import load_format
from truepath.app.compensation.kept_files import read_account
from truepath.app.errors import BadInput, BundleError
from truepath.app.files.file_model import as_object, parse_json
from truepath.app.files.whole_files import read_whole
from truepath.app.kinematics.conditions import Conditions
from truepath.app.kinematics.machine import Machine

AddedMotion = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""What a controller adds, mm, under conditions that say from where an axis came."""


@dataclass(frozen=True, slots=True)
class ActiveFiles:
    """Files of a format, and what a controller adds by them.

    files_sha256 : digest by name
    """

    format: str
    files_sha256: Mapping[str, str]
    added: AddedMotion

    def describe(self) -> dict[str, Any]:
        """Return which files they are, as a verification states it."""
        return {"format": self.format, "files_sha256": dict(self.files_sha256)}


def read_active_files(
    files: Sequence[Path],
    name: str | None,
    machine: Machine,
    choices: Mapping[str, str] | None = None,
) -> ActiveFiles | None:
    """Return the files of a format and what they add; None where there are none.

    choices : by which the files were written; None for those of the account that was
    written beside them, where it is there

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
    data = {file.name: read_whole(file) for file in files}
    content = {file: each.decode("utf-8", "replace") for file, each in data.items()}
    digests = {file: hashlib.sha256(each).hexdigest() for file, each in data.items()}
    if choices is None:
        choices = find_choices(files[0].parent, name, digests)
    kind = load_format(name, choices)
    try:
        correction = kind.read(content, machine)
    except (ValueError, LookupError) as error:
        raise BadInput(
            f"{', '.join(content)}: cannot be read as files of {name} ({error}); give "
            "the files of one export, as it wrote them"
        ) from error
    return ActiveFiles(name, digests, follow_approach(correction, machine))


def read_kept_files(folder: Path, machine: Machine) -> ActiveFiles:
    """Return files that are kept with a result. Raises NotFound."""
    account = read_account(folder.parent, folder.name)
    files = [folder / name for name in account["files"]]
    active = read_active_files(
        files, account["format"], machine, account.get("choices")
    )
    assert active is not None  # noqa: S101 (an account names its files)
    return active


def find_choices(
    folder: Path, name: str, files_sha256: Mapping[str, str]
) -> dict[str, str]:
    """Return the choices of the account that was written beside files of a format.

    Empty, for the usual ones, where there is no account of just these files.
    """
    for place in sorted(folder.glob("*.json")):
        account = as_object(_read_json(place))
        digests = as_object(account.get("files_sha256"))
        if account.get("format") == name and digests == files_sha256:
            return dict(as_object(account.get("choices")))
    return {}


def _read_json(place: Path) -> object:
    """Return what a file holds; nothing where it is no JSON or too large."""
    try:
        return parse_json(read_whole(place), place.name)
    except BundleError:
        return {}


def follow_approach(correction: Correction, machine: Machine) -> AddedMotion:
    """Return a correction of one direction of all axes by the approach of each.

    A format corrects lost motion along the axis that it belongs to: half the difference
    of both directions counts by the last motion of that axis.
    """
    columns = [machine.axis_names.index(name) for name in "XYZ"]

    def add(at: Conditions) -> Float64[np.ndarray, "n 3"]:
        forward = correction(at.position_mm, 1.0)
        backward = correction(at.position_mm, -1.0)
        half = 0.5 * (forward - backward)
        return 0.5 * (forward + backward) + half * at.approach[:, columns]

    return add
