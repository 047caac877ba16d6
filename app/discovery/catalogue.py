"""All families that may be missing: ours, and those of others by entry point."""

from __future__ import annotations

from functools import cache

from app.kinematics.effects.catalogue import Family
from app.plugins import effect_families


@cache
def families() -> tuple[Family, ...]:
    """Return one of each family, in the order of their names."""
    return tuple(make() for make in effect_families().values())
