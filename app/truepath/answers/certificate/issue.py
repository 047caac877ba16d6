"""What a certificate is made from, and whether it may be issued."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

from truepath.answers.certificate.as_left import (
    drop_little_gained,
    reject_as_left,
    require_same_machine,
)
from truepath.answers.certificate.language import LanguageCode
from truepath.documents.file_model import as_object, parse_json
from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError
from truepath.files.bundle.identity_file import Identity
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    RESULT_SCHEMA,
    CalibrationResult,
    require_account,
    require_finite_numbers,
    result_from_json,
)
from truepath.files.earlier.verdict import Verdict

VERIFICATION, COMPENSATION = "verification/1", "compensation/1"
Content = Mapping[str, Any]
_DEVICES = {"tracker": "tracker", "control": "motion"}
_SIMULATED = re.compile(r"(?i)simulat|\bSIM-")


@dataclass(frozen=True, slots=True)
class Source:
    """A JSON file that a certificate is made from, as it is on disk."""

    name: str
    content: Content
    sha256: str

    @property
    def input_sha256(self) -> str:
        """Digest of the Runs that its result is from; empty where the file has none."""
        provenance = as_object(self.content.get("provenance"))
        origin = as_object(provenance.get("result")) or provenance
        found = origin.get("input_sha256")
        return found if isinstance(found, str) else ""

    def is_of_another(self, result: Source) -> bool:
        """Whether it was made for a result of other Runs."""
        return bool(self.input_sha256) and self.input_sha256 != result.input_sha256


@dataclass(frozen=True, slots=True)
class ResultSource(Source):
    """A result file, with the machine and estimate that it holds."""

    result: CalibrationResult


@dataclass(frozen=True, slots=True)
class Certificate:
    """Content of a certificate, independent of language.

    found : the result as found; left : that of a measurement after compensation
    verification, compensation : contents of their files, where there are any
    number : empty for one that follows from the result
    issued_by : empty where unknown
    tolerance_um : of the machine, for 95 % of the volume; None where none is agreed
    is_preview : not issued: its pages say so
    """

    found: ResultSource
    issued: date
    left: ResultSource | None = None
    verification: Source | None = None
    compensation: Source | None = None
    identity: Identity = field(default_factory=dict[str, str])
    language: LanguageCode = "en"
    number: str = ""
    issued_by: str = ""
    tolerance_um: float | None = None
    is_preview: bool = False

    @property
    def devices(self) -> dict[str, str]:
        """Names that tracker and control reported for the Runs, by identity field."""
        known: dict[str, str] = {}
        for field_name, device in _DEVICES.items():
            said = [
                as_object(as_object(run).get("source")).get(device)
                for source in (self.found, self.left)
                if source is not None
                for run in source.content.get("runs", ())
            ]
            if names := dict.fromkeys(str(one).strip() for one in said if one):
                known[field_name] = "; ".join(names)
        return known

    @property
    def is_simulated(self) -> bool:
        """Whether a device reported itself, or was stated, to be simulated."""
        names = [self.devices.get(name, "") for name in _DEVICES]
        names += [self.identity.get(name, "") for name in _DEVICES]
        return any(map(_SIMULATED.search, names))

    @property
    def left_verdict(self) -> Verdict | None:
        """None without a result as left; `little-gained` is no reason there."""
        return (
            None if self.left is None else drop_little_gained(self.left.result.verdict)
        )

    @property
    def shown_number(self) -> str:
        """The given number, or one made of the date and digest of the result."""
        if self.number:
            return self.number
        created = str(self.found.content["provenance"].get("created", ""))[:10]
        return f"TP-{created.replace('-', '')}-{self.found.sha256[:8].upper()}"


def gather_certificate(
    found: ResultSource,
    *,
    issued: date,
    left: Path | None = None,
    verification: Path | None = None,
    compensation: Path | None = None,
    identity: Identity,
    language: LanguageCode = "en",
    number: str = "",
    issued_by: str = "",
    tolerance_um: float | None = None,
) -> Certificate:
    """Raises BundleError for a file that does not belong to the result."""
    as_left = None if left is None else read_result_source(left)
    if as_left is not None:
        require_same_machine(
            found.result.machine, as_left.result.machine, file=as_left.name
        )
        reject_as_left(found.content, as_left.content, file=as_left.name)
    return Certificate(
        found,
        issued,
        as_left,
        None if verification is None else read_source(verification, VERIFICATION),
        None if compensation is None else read_source(compensation, COMPENSATION),
        identity,
        language,
        number,
        issued_by,
        tolerance_um,
    )


def read_result_source(file: str | Path) -> ResultSource:
    """Raises BundleError, for a model file as well."""
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    shown = Path(file).name
    parsed = parse_json(data, shown)
    result, content = result_from_json(parsed, file=shown), as_object(parsed)
    if content["schema"] != RESULT_SCHEMA:
        remedy = "give the result.json of an analysis"
        raise BundleError("is a model, not a result", file=shown, remedy=remedy)
    return ResultSource(shown, content, _digest(data), result)


def read_source(file: str | Path, schema: str) -> Source:
    """Any other file of a certificate. Raises BundleError for another schema."""
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    shown = Path(file).name
    content = as_object(parse_json(data, shown))
    if content.get("schema") != schema:
        remedy = f"give a file of {schema}"
        raise BundleError("is of another schema", file=shown, remedy=remedy)
    require_finite_numbers(content, shown)
    if schema == COMPENSATION:
        require_account(content, shown)
    return Source(shown, content, _digest(data))


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
