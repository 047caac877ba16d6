"""Whether a result may describe the machine as left, next to the one as found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from truepath.documents.file_model import as_object
from truepath.errors import BundleError
from truepath.files.bundle.one_machine import have_same_targets
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.machine.machine import Machine

Content = Mapping[str, Any]
ON, OFF = "on", "off"
_LITTLE_GAINED = "little-gained"  # of a machine as left: there is little left to gain


def drop_little_gained(verdict: Verdict) -> Verdict:
    """Without `little-gained`, which is no objection to a machine as left."""
    return Verdict(tuple(one for one in verdict.reasons if one.kind != _LITTLE_GAINED))


def require_same_machine(found: Machine, left: Machine, *, file: str) -> None:
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


def reject_as_left(found: Content, left: Content, *, file: str) -> None:
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
    if OFF in _list_controls(left):
        raise BundleError(
            "was measured while the control said that its compensation is off",
            file=file,
            remedy="switch the compensation on, measure again, and give that result",
        )


def is_compensation_confirmed(left: Content) -> bool:
    """Whether the control reported for every Run that it compensated."""
    return set(_list_controls(left)) == {ON}


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
