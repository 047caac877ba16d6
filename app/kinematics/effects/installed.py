"""All families that are installed: ours, and those of others by entry point."""

from __future__ import annotations

from functools import cache

from app.kinematics.effects.catalogue import Family
from app.plugins import installed, load

GROUP = "truepath.effects"


def list_families() -> tuple[Family, ...]:
    """Return one of each family, in the order of their names."""
    return tuple(map(find_family, sorted(installed(GROUP))))


def find_family(name: str) -> Family:
    """Return the family of a name. Raises BadInput, telling what is installed."""
    return _make(load(GROUP, name))


@cache
def _make(factory: type[Family]) -> Family:
    return factory()
