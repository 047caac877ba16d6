"""Whether a result may stand for the machine as left, beside that as found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from truepath.app.errors import BundleError
from truepath.app.files.file_model import as_object

Content = Mapping[str, Any]
ON, OFF = "on", "off"


def refuse_as_left(found: Content, left: Content, *, file: str) -> None:
    """Raise BundleError where a result cannot be of the machine as left.

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
    """Tell whether the control said of every Run that it compensated."""
    return set(_list_controls(left)) == {ON}


def _list_sources(content: Content) -> Iterator[Mapping[str, Any]]:
    for run in content.get("runs", ()):
        yield as_object(as_object(run).get("source"))


def _list_digests(content: Content) -> set[str]:
    """Return the digests of a result's own Runs, and of the result's whole input."""
    whole = as_object(content.get("provenance")).get("input_sha256")
    runs = [as_object(run).get("input_sha256") for run in content.get("runs", ())]
    return {one for one in (whole, *runs) if isinstance(one, str) and one}


def _list_starts(content: Content) -> list[datetime]:
    """Return when the Runs began, in order, where they know it."""
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
