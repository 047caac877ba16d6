"""The units of files: µm and µrad outside, mm and rad inside."""

from __future__ import annotations

from truepath.kinematics.effects.base import Parameter

UM_PER_MM = 1e3
URAD_PER_RAD = 1e6
PER_PPM = 1e-6
# Inside unit -> unit in files and its number in one of the inside unit.
_UNITS = {
    "mm": ("um", UM_PER_MM),
    "rad": ("urad", URAD_PER_RAD),
    "s": ("ms", 1e3),
    "mm/s": ("um_per_s", 1e3),
    "1/K": ("um_per_m_K", 1e6),
    "1": ("um_per_m", 1e6),
}


def unit_of(parameter: Parameter) -> tuple[str, float]:
    """Unit in files, and the factor from the inside unit."""
    return _UNITS.get(parameter.unit, (parameter.unit, 1.0))


def scale_of(unit: str) -> float:
    """Number of `um` or `urad` in one mm or rad."""
    return URAD_PER_RAD if unit == "urad" else UM_PER_MM
