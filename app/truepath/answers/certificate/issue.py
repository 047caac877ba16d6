"""What a certificate is made from, and whether it may be issued."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
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
from truepath.files.earlier.result_file import (
    LARGEST_BYTES,
    RESULT_SCHEMA,
    CalibrationResult,
    require_account,
    require_finite_numbers,
    result_from_json,
)
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import Machine

Content = Mapping[str, Any]
_COMPENSATION = "compensation/1"
_DEVICES = {"tracker": "tracker", "control": "motion"}
_SIMULATED = re.compile(r"(?i)simulat|\bSIM-")


def _require_same_machine(found: Machine, left: Machine, *, file: str) -> None:
    """Raise BundleError where a result as left is of another machine, travel or tool.

    With another tool, or over another travel, the same machine has another error.
    """
    if (found.name, found.chain) != (left.name, left.chain):
        raise BundleError(
            f"is of machine {left.name} ({left.chain}), not {found.name} "
            f"({found.chain})",
            file=file,
            remedy="give a result of the same machine",
        )
    one, other = (
        ", ".join(f"{a.name} {a.low:g} to {a.high:g}" for a in machine.axes)
        for machine in (found, left)
    )
    what = "travel"
    if one == other:
        if have_same_targets(found, left):
            return
        what = "targets"
        one, other = (
            ", ".join(
                f"{target.name} ({', '.join(f'{v:g}' for v in target.offset_mm)}) mm"
                for target in machine.targets
            )
            for machine in (found, left)
        )
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
    if "off" in _list_controls(left):
        raise BundleError(
            "was measured while the control said that its compensation is off",
            file=file,
            remedy="switch the compensation on, measure again, and give that result",
        )


def is_compensation_confirmed(left: Content) -> bool:
    """Whether the control reported for every Run that it compensated."""
    return set(_list_controls(left)) == {"on"}


def _list_sources(content: Content) -> Iterator[Mapping[str, Any]]:
    for run in content.get("runs", ()):
        yield as_object(as_object(run).get("source"))


def _list_digests(content: Content) -> set[str]:
    whole = as_object(content.get("provenance")).get("input_sha256")
    runs = [as_object(run).get("input_sha256") for run in content.get("runs", ())]
    return {one for one in (whole, *runs) if isinstance(one, str) and one}


def _list_starts(content: Content) -> list[datetime]:
    """In order; only of Runs that know when they began."""
    starts: list[datetime] = []
    for source in _list_sources(content):
        with suppress(ValueError):
            at = datetime.fromisoformat(str(source.get("started")))
            starts.append(at if at.tzinfo else at.replace(tzinfo=UTC))
    return sorted(starts)


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
    def sources(self) -> dict[str, Source]:
        """The files that there are."""
        files = {
            "result": self.found,
            "as_left": self.left,
            "verification": self.verification,
            "compensation": self.compensation,
        }
        return {name: one for name, one in files.items() if one is not None}

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
        """None without a result as left; `little-gained` is no objection there."""
        if self.left is None:
            return None
        reasons = self.left.result.verdict.reasons
        return Verdict(tuple(one for one in reasons if one.kind != "little-gained"))

    @property
    def shown_number(self) -> str:
        """The given number, or one made of the date of the result and of all it holds.

        Translations of a certificate have the same number.
        """
        if self.number:
            return self.number
        created = str(self.found.content["provenance"].get("created", ""))[:10]
        files = [f"{name} {source.sha256}" for name, source in self.sources.items()]
        identity = [f"{name} {text}" for name, text in sorted(self.identity.items())]
        stated = [str(self.issued), self.issued_by, str(self.tolerance_um)]
        digest = hashlib.sha256(
            "\n".join([*files, *identity, *stated]).encode()
        ).hexdigest()
        return f"TP-{created.replace('-', '')}-{digest[:8].upper()}"


@dataclass(frozen=True, slots=True)
class CertificateOrder:
    """What a client requests of a certificate.

    stem : of its number; a count follows it
    result, left, verification, compensation : files; the last three are optional
    issued_by : empty where unknown
    """

    stem: str
    result: Path
    issued_at: datetime
    issued_by: str = ""
    left: Path | None = None
    verification: Path | None = None
    compensation: Path | None = None
    identity: Identity = field(default_factory=dict[str, str])
    language: LanguageCode = "en"
    accept_verdict: bool = False
    tolerance_um: float | None = None


def gather_certificate(found: ResultSource, order: CertificateOrder) -> Certificate:
    """Raises BundleError for a file that does not belong to the result."""
    left = None if order.left is None else read_result_source(order.left)
    if left is not None:
        _require_same_machine(found.result.machine, left.result.machine, file=left.name)
        _reject_as_left(found.content, left.content, file=left.name)
    verification, compensation = (
        None if file is None else _read_source(file, schema)
        for file, schema in (
            (order.verification, "verification/1"),
            (order.compensation, _COMPENSATION),
        )
    )
    return Certificate(
        found,
        order.issued_at.date(),
        left,
        verification,
        compensation,
        order.identity,
        order.language,
        issued_by=order.issued_by,
        tolerance_um=order.tolerance_um,
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
    return ResultSource(shown, content, hashlib.sha256(data).hexdigest(), result)


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
    return Source(shown, content, hashlib.sha256(data).hexdigest())
