"""Statements of people on a machine and its calibration.

`identity.json` (schema `identity/1`) is one flat object of texts; every key may be
missing. Earlier versions kept one such object by the name of each machine in
`identities.json` (`identities/1`); the registry of machines takes it over.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from truepath.documents.file_model import (
    LONGEST_LINE,
    encode_json,
    is_line,
    parse_json,
    quote,
)
from truepath.documents.whole_files import read_whole, replace_file
from truepath.errors import BadInput, BundleError

Field = Literal[
    "machine_maker",
    "machine_model",
    "serial_number",
    "control",
    "tracker",
    "tracker_serial_number",
    "tracker_certificate",
    "tracker_calibrated_on",
    "target",
    "operator",
    "laboratory",
    "customer",
    "place",
    "authorised_by",
    "condition",
    "received_on",
    "measured_on",
    "warm_up",
    "deviations",
]
FIELDS: tuple[Field, ...] = Field.__args__
OF_ONE_MEASUREMENT: frozenset[Field] = frozenset(
    {"condition", "received_on", "measured_on", "warm_up", "deviations"}
)
"""Stated anew each time: what was true of the last measurement is not of this one."""

EARLIER_NAMES: Mapping[str, Field] = {
    "machine_serial": "serial_number",
    "tracker_serial": "tracker_serial_number",
}

SCHEMA, STORE_SCHEMA = "identity/1", "identities/1"
_LARGEST_BYTES = 1 << 20

Identity = Mapping[str, str]
"""Texts by the names of `FIELDS`; what nobody has stated is missing."""


def read_identity(file: str | Path) -> Identity:
    """Raises BundleError naming the key."""
    content = parse_json(read_whole(file, largest_bytes=_LARGEST_BYTES), str(file))
    return identity_from_json(content, file=str(file))


def identity_from_json(content: object, *, file: str) -> Identity:
    """Non-empty texts of an object. Raises BundleError naming the key."""
    if not isinstance(content, Mapping):
        raise BundleError("is no object, {…}", file=file, remedy="write an object")
    stated = rename_earlier(content)
    if stated.pop("schema", SCHEMA) != SCHEMA:
        raise BundleError(
            f"schema is {quote(content['schema'])}",
            file=file,
            remedy=f'write "schema": "{SCHEMA}"',
        )
    return {key: _check(key, text, file) for key, text in stated.items() if text != ""}


def read_assignments(assignments: list[str]) -> Identity:
    """From `FIELD=TEXT`. Raises BadInput or BundleError naming the field."""
    content: dict[str, str] = {}
    for each in assignments:
        name, equals, text = each.partition("=")
        if not equals:
            raise BadInput(f"--state {each!r}: write FIELD=TEXT")
        content[name.strip()] = text.strip()
    return identity_from_json(content, file="--state")


def read_stored_identities(file: Path) -> Mapping[str, Identity]:
    """Identities by machine name that earlier versions stored in a file.

    Empty where there is no file. Raises BundleError on a damaged one.
    """
    if not file.exists():
        return {}
    name = str(file)
    content = parse_json(read_whole(name, largest_bytes=_LARGEST_BYTES), name)
    machines = content.get("machines") if isinstance(content, Mapping) else None
    if not isinstance(machines, Mapping):
        remedy = "restore it, or remove it and state the identities again"
        raise BundleError("holds no machines", file=name, remedy=remedy)
    return {
        str(machine): identity_from_json(stated, file=name)
        for machine, stated in machines.items()
    }


def rename_earlier(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Texts by the names of today."""
    return {EARLIER_NAMES.get(key, key): text for key, text in stated.items()}


def write_stored_identities(file: Path, machines: Mapping[str, Identity]) -> None:
    """Write the remaining identities; without any the file is removed."""
    if not machines:
        file.unlink(missing_ok=True)
        return
    content = {"schema": STORE_SCHEMA, "machines": machines}
    replace_file(file, encode_json(content, indent=1))


def _check(key: object, text: object, file: str) -> str:
    if key not in FIELDS:
        remedy = f"write one of {', '.join(FIELDS)}"
        raise BundleError(f"{quote(key)} is no field", file=file, remedy=remedy)
    if not isinstance(text, str) or not is_line(text):
        remedy = f"write one line of text of at most {LONGEST_LINE} characters"
        raise BundleError(f"{key} is {quote(text)}", file=file, remedy=remedy)
    return text
