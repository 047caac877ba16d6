"""What a certificate is made from, and whether it may be issued."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from truepath.answers.certificate.language import LanguageCode
from truepath.documents.file_model import as_object, parse_json
from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError
from truepath.files.bundle.identity_file import Identity
from truepath.files.bundle.one_machine import have_same_targets
from truepath.files.earlier.account_file import require_account, require_finite_numbers
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    RESULT_SCHEMA,
    CalibrationResult,
    result_from_json,
)
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import Machine

Content = Mapping[str, Any]
_ON, _OFF = "on", "off"
_LITTLE_GAINED = "little-gained"  # of a machine as left: there is little left to gain
VERIFICATION, _COMPENSATION = "verification/1", "compensation/1"
_DEVICES = {"tracker": "tracker", "control": "motion"}
_SIMULATED = re.compile(r"(?i)simulat|\bSIM-")


def _drop_little_gained(verdict: Verdict) -> Verdict:
    """Without `little-gained`, which is no objection to a machine as left."""
    return Verdict(tuple(one for one in verdict.reasons if one.kind != _LITTLE_GAINED))


def _require_same_machine(found: Machine, left: Machine, *, file: str) -> None:
    """Raise BundleError where a result as left is of another machine, travel or tool.

    With another tool, or over another travel, the same machine has another error.

    file : of the result as left
    """
    if (found.name, found.chain) != (left.name, left.chain):
        raise BundleError(
            f"is of machine {left.name} ({left.chain}), not {found.name} "
            f"({found.chain})",
            file=file,
            remedy="give a result of the same machine",
        )
    if _describe_travel(found) != _describe_travel(left):
        what, one, other = "travel", _describe_travel(found), _describe_travel(left)
    elif not have_same_targets(found, left):
        what, one, other = "targets", _describe_targets(found), _describe_targets(left)
    else:
        return
    raise BundleError(
        f"has other {what}, {other}, than the result as found, {one}",
        file=file,
        remedy="measure the machine as left with the same travel and targets",
    )


def _reject_as_left(found: Content, left: Content, *, file: str) -> None:
    """Raise BundleError for a shared Run, or where `left` began before `found`.

    found, left : contents of result files of one machine; file : that of `left`
    """
    if shared := _list_digests(found) & _list_digests(left):
        raise BundleError(
            f"comes from a measurement of the result as found (input "
            f"{min(shared)[:16]}), so that it cannot state the machine as left",
            file=file,
            remedy="measure again with the compensation active, and give that result",
        )
    found_at, left_at = _list_starts(found), _list_starts(left)
    if found_at and left_at and left_at[0] <= found_at[-1]:
        raise BundleError(
            f"was measured at {left_at[0].isoformat()}, not after the result as found "
            f"({found_at[-1].isoformat()})",
            file=file,
            remedy="give the later result as the one as left",
        )
    if _OFF in _list_controls(left):
        raise BundleError(
            "was measured while the control said that its compensation is off",
            file=file,
            remedy="switch the compensation on, measure again, and give that result",
        )


def is_compensation_confirmed(left: Content) -> bool:
    """Whether the control reported for every Run that it compensated."""
    return set(_list_controls(left)) == {_ON}


def _describe_travel(machine: Machine) -> str:
    return ", ".join(f"{a.name} {a.low:g} to {a.high:g}" for a in machine.axes)


def _describe_targets(machine: Machine) -> str:
    return ", ".join(
        f"{target.name} ({', '.join(f'{each:g}' for each in target.offset_mm)}) mm"
        for target in machine.targets
    )


def _list_sources(content: Content) -> Iterator[Mapping[str, Any]]:
    for run in content.get("runs", ()):
        yield as_object(as_object(run).get("source"))


def _list_digests(content: Content) -> set[str]:
    whole = as_object(content.get("provenance")).get("input_sha256")
    runs = [as_object(run).get("input_sha256") for run in content.get("runs", ())]
    return {one for one in (whole, *runs) if isinstance(one, str) and one}


def _list_starts(content: Content) -> list[datetime]:
    """In order; only of Runs that know when they began."""
    return sorted(
        at
        for source in _list_sources(content)
        if (at := _read_time(source.get("started"))) is not None
    )


def _read_time(text: object) -> datetime | None:
    try:
        at = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def _list_controls(content: Content) -> list[str]:
    return [
        str(source.get("control_compensation", "")) for source in _list_sources(content)
    ]


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
            None if self.left is None else _drop_little_gained(self.left.result.verdict)
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
        _require_same_machine(
            found.result.machine, as_left.result.machine, file=as_left.name
        )
        _reject_as_left(found.content, as_left.content, file=as_left.name)
    return Certificate(
        found,
        issued,
        as_left,
        None if verification is None else _read_source(verification, VERIFICATION),
        None if compensation is None else _read_source(compensation, _COMPENSATION),
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


def _read_source(file: str | Path, schema: str) -> Source:
    data = read_whole(file, largest_bytes=LARGEST_BYTES)
    shown = Path(file).name
    content = as_object(parse_json(data, shown))
    if content.get("schema") != schema:
        remedy = f"give a file of {schema}"
        raise BundleError("is of another schema", file=shown, remedy=remedy)
    require_finite_numbers(content, shown)
    if schema == _COMPENSATION:
        require_account(content, shown)
    return Source(shown, content, _digest(data))


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
