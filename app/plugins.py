"""Finds drivers, effects and simulators by entry point; ours are found the same way."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from truepath.app.errors import BadInput


def find_plugins(group: str) -> dict[str, EntryPoint]:
    """Return what is installed in an entry-point group, by name."""
    return {point.name: point for point in entry_points(group=group)}


def load(group: str, name: str) -> Any:
    """Return the factory called `name`; an unknown name tells what is installed."""
    known = find_plugins(group)
    if name not in known:
        raise BadInput(
            f"no {group.removeprefix('truepath.')} called {name!r} is installed; "
            f"installed: {', '.join(sorted(known)) or 'none'}"
        )
    return known[name].load()
