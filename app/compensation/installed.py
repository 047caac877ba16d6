"""The formats that are installed, ours and others', by name."""

from __future__ import annotations

from typing import Any

from truepath.app.compensation.format import CompensationFormat
from truepath.app.plugins import find_plugins, load

GROUP = "truepath.compensation_formats"


def load_format(name: str) -> CompensationFormat:
    """Return an installed format. Raises BadInput, which tells what is installed."""
    return load(GROUP, name)()


def list_formats() -> dict[str, CompensationFormat]:
    """Return every installed format, in the order of their names."""
    return {name: load_format(name) for name in sorted(find_plugins(GROUP))}


def describe_format(name: str, kind: CompensationFormat) -> dict[str, Any]:
    """Return what a format carries, its bounds, and where its sign is from."""
    return {
        "name": name,
        "control": kind.control,
        "carries": kind.carries,
        "not_carried": kind.not_carried,
        "most_rows": kind.most_points,
        "resolution_um": kind.resolution_um,
        "sign": {"rule": kind.sign, "verified": kind.sign_is_verified},
        "note": kind.note,
    }
