"""Which effects of a model a file takes away, and how much of each it leaves.

Each effect is taken out of the model and the file written and read back again: the
difference is what the file does against that effect. So nobody has to know beforehand
what a format makes of sag, of a screw's wave between its rows, or of lost motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from app.compensation.format import CompensationFormat, Correction
from app.compensation.order import CompensationOrder
from app.compensation.places import positions, without_rigid
from app.compensation.source import Source
from app.files.units import UM_PER_MM
from app.kinematics.effects.catalogue_effect import CatalogueEffect
from app.kinematics.symbols import is_positioning

_NOTHING_MM = 1e-9
_SIDES = (1.0, -1.0)  # coming up, coming down


@dataclass(frozen=True, slots=True)
class Carried:
    """One effect: its root mean square in the map, and what the file leaves of it.

    before_um : coming up and coming down, without the rigid motion of the whole; 0
        where it depends on speed, temperature or the way since a reversal
    """

    effect: CatalogueEffect
    before_um: float
    after_um: float

    def in_words(self) -> dict[str, Any]:
        """Return the effect as the account states it."""
        beyond = self.before_um == 0.0
        return {
            "name": self.effect.family,
            **dict(self.effect.keys),
            "rms_um": {"before": self.before_um, "after": self.after_um},
            "note": "depends on more than place and direction: no table has it"
            if beyond
            else "",
        }


def carried_effects(
    source: Source,
    kind: CompensationFormat,
    ordered: Callable[[Source], CompensationOrder],
    correction: Correction,
) -> Iterator[Carried]:
    """Yield each effect of the model with what the file leaves of it.

    ordered : makes what the format writes; correction : what its files do
    """
    place = positions(source)
    for effect in source.result.model.catalogued:
        other = _without(source, effect)
        reread = kind.read(kind.write(ordered(other)), source.machine)
        own = [source.error_mm(place, s) - other.error_mm(place, s) for s in _SIDES]
        done = [correction(place, s) - reread(place, s) for s in _SIDES]
        left = [error + taken for error, taken in zip(own, done, strict=True)]
        before, after = _rms(place, own), _rms(place, left)
        if before < _NOTHING_MM:
            before = after = 0.0
        yield Carried(effect, UM_PER_MM * before, UM_PER_MM * after)


def _rms(
    place: Float64[np.ndarray, "n a"], error_mm: Sequence[Float64[np.ndarray, "n 3"]]
) -> float:
    """Return the root mean square over both sides, their common motion left out."""
    every = without_rigid(np.vstack([place, place]), np.vstack(error_mm))
    return float(np.sqrt(3.0 * np.mean(every**2)))


def _without(source: Source, effect: CatalogueEffect) -> Source:
    """Return the source as if the effect were not there."""
    theta = source.result.theta.copy()
    theta[source.result.model.slices[effect.name]] = 0.0
    half = dict(source.half)
    lost = effect.half_difference
    if lost and is_positioning(lost.symbol):
        half.pop(lost.axis.name, None)
    return replace(source, result=replace(source.result, theta=theta), half=half)
