"""What has changed in a machine between two of its calibrations, and how surely.

Each calibration gives θ̂ with its covariance C. Table entries and the volumetric error
are linear in θ, so their difference R₂θ̂₂ − R₁θ̂₁ has the covariance R₂C₂R₂ᵀ + R₁C₁R₁ᵀ.
That is on the safe side: what both took from the same prior would cancel. Tables are
compared in their own gauge, the volumetric error after its best-fit rigid motion is
removed from each: the station of the tracker is no change of the machine.

Many entries are tested, and some of them differ much by chance alone. An entry has
changed only if its |difference| / uncertainty is more than the largest over all entries
is with a chance of 2.5 %; the root mean square of the volumetric difference is compared
with its own such limit, so that an unchanged machine is reported as changed with a
chance of 5 % at most. Both limits come from 4000 draws of the joint covariance:
correlated entries count less than independent ones (the single-step maximum test of
Westfall and Young, 1993).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.files.bundle.one_machine import have_same_targets, one_machine
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.machine.machine import position_unit
from truepath.kinematics.machine.symbols import find_unit
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.error_tables import choose_table_positions

CHANCE = 0.05  # that an unchanged machine is reported as changed
_DRAWS = 4000
_SMALLEST = 1e-9  # µm, µrad: rounding of what is 0 by convention of the table
_FINE = 1e-9  # of the largest eigenvalue: shapes that no error over the travel shows


@dataclass(frozen=True, slots=True)
class ChangedEntry:
    """One number of the tables in both calibrations.

    position : of the axis in `position_unit`; None of a number that has none
    unit : "um" or "urad", of both values and of the uncertainty of their difference
    chance : that so large a difference occurs anywhere in the tables of a machine that
        has not changed; 1/4001 at least
    """

    symbol: str
    position: float | None
    position_unit: str
    unit: str
    before: float
    after: float
    uncertainty: float
    chance: float
    is_significant: bool

    @property
    def difference(self) -> float:
        """After less before."""
        return self.after - self.before


@dataclass(frozen=True, slots=True)
class ChangedVolume:
    """The volumetric error of both calibrations, one less the other.

    difference_um : root mean square of its length over the travel
    by_chance_um : its limit of 97.5 % without a change
    change_um : the difference less the part of chance, in squares; 0 if nothing remains
    """

    difference_um: float
    by_chance_um: float
    change_um: float
    chance: float

    @property
    def is_significant(self) -> bool:
        """At the limit of 97.5 %."""
        return self.difference_um > self.by_chance_um


@dataclass(frozen=True, slots=True)
class MachineChange:
    """All differences between two calibrations.

    factor : how many standard uncertainties an entry has to differ by to count
    not_compared : symbols that only one of both has
    """

    entries: tuple[ChangedEntry, ...]
    volume: ChangedVolume
    factor: float
    not_compared: tuple[str, ...]

    @property
    def is_significant(self) -> bool:
        """Any entry, or the volumetric error."""
        return self.volume.is_significant or any(e.is_significant for e in self.entries)


def detect_changes(
    before: CalibrationResult, after: CalibrationResult
) -> MachineChange:
    """Differences between two results of one machine.

    Raises BadInput if they share a Run, or hold for other targets; BundleError if they
    are of different machines.
    """
    _require_comparable(before, after)
    sides = before.reduce_to_targets, after.reduce_to_targets
    known_by = [_list_symbols(one) for one in sides]
    symbols = known_by[0] & known_by[1]
    if not symbols:
        raise BadInput("the results state no error motion in common")
    (places, rows), (_, other) = (_build_rows(one, symbols) for one in sides)
    values = np.stack([rows @ sides[0].theta, other @ sides[1].theta])
    drawn = rows @ _sample_parameters(sides[0], 1)
    drawn = drawn + other @ _sample_parameters(sides[1], 2)
    sigma = drawn.std(axis=1)
    known = sigma > _SMALLEST
    highest = np.max(np.abs(drawn[known]) / sigma[known, None], axis=0, initial=0.0)
    factor = float(np.quantile(highest, 1.0 - CHANCE / 2.0))
    excess = np.where(known, np.abs(values[1] - values[0]), 0.0)
    excess = np.divide(excess, sigma, out=np.zeros_like(excess), where=known)
    entries = tuple(
        ChangedEntry(
            *place,
            float(values[0, k]),
            float(values[1, k]),
            float(sigma[k]),
            _count_chance(highest, float(excess[k])),
            bool(excess[k] > factor),
        )
        for k, place in enumerate(places)
    )
    volume = _compare_volume(before, after)
    not_compared = tuple(sorted(known_by[0] ^ known_by[1]))
    return MachineChange(entries, volume, factor, not_compared)


def _require_comparable(before: CalibrationResult, after: CalibrationResult) -> None:
    one_machine([before.machine, after.machine], ["the earlier", "the later result"])
    any_tool = before.model.knows_all_motions and after.model.knows_all_motions
    if not (any_tool or have_same_targets(before.machine, after.machine)):
        raise BadInput(
            "the results hold for different targets, or another tool; compare two that "
            "were measured with the same, or with three targets that tell all motions"
        )
    digests = [
        {str(run["input_sha256"]) for run in one.provenance.get("runs") or ()}
        for one in (before, after)
    ]
    if digests[0] & digests[1]:
        raise BadInput(
            "both results come from one Run, so that they are not independent; "
            "compare results of different measurements"
        )


_EntryKey = tuple[str, float | None, str, str]
"""Symbol, position, its unit, unit of the value."""


def _sample_parameters(
    estimated: EstimatedModel, seed: int
) -> Float64[np.ndarray, "p d"]:
    """Deviations of its parameters by their covariance, the same for the same seed."""
    value, vector = np.linalg.eigh(estimated.covariance)
    unit = np.random.default_rng(seed).standard_normal((len(value), _DRAWS))
    return vector @ (np.sqrt(np.maximum(value, 0.0))[:, None] * unit)


def _list_symbols(estimated: EstimatedModel) -> set[str]:
    hidden = estimated.model.confounded
    effects = [e for e in estimated.model.effects if e.name not in hidden]
    return {e.iso_symbol for e in effects if e.iso_symbol}


def _build_rows(
    estimated: EstimatedModel, symbols: set[str]
) -> tuple[list[_EntryKey], Float64[np.ndarray, "n p"]]:
    model = estimated.model
    places: list[_EntryKey] = []
    blocks: list[Float64[np.ndarray, "k p"]] = []
    effects = {e.iso_symbol: e for e in model.effects if e.name not in model.confounded}
    for symbol in sorted(symbols):
        effect, unit = effects[symbol], find_unit(symbol)
        part = np.eye(1)
        if motion := effect.motion:
            at = choose_table_positions(motion.axis)
            part = motion.rows(at)
            measure = position_unit(motion.axis)
            places += [(symbol, float(p), measure, unit) for p in at]
        else:
            places.append((symbol, None, "", unit))
        block = np.zeros((len(part), model.size))
        block[:, model.slices[effect.name]] = scale_of(unit) * part
        blocks.append(block)
    return places, np.concatenate(blocks)


def _compare_volume(
    before: CalibrationResult, after: CalibrationResult
) -> ChangedVolume:
    columns = np.concatenate([-_weigh(before), _weigh(after)], axis=1)
    value, vector = np.linalg.eigh(columns.T @ columns)
    kept = value > _FINE * value[-1]
    root: Float64[np.ndarray, "k p"] = (vector[:, kept] * np.sqrt(value[kept])).T
    theta = np.concatenate([before.theta, after.theta])
    drawn = root @ np.concatenate(
        [_sample_parameters(before, 1), _sample_parameters(after, 2)]
    )
    length_um: Float64[np.ndarray, " d"] = np.linalg.norm(drawn, axis=0)
    difference_um = float(np.linalg.norm(columns @ theta))
    left = difference_um**2 - float(np.mean(length_um**2))
    return ChangedVolume(
        difference_um,
        float(np.quantile(length_um, 1.0 - CHANCE / 2.0)),
        float(np.sqrt(max(left, 0.0))),
        _count_chance(length_um, difference_um),
    )


def _weigh(estimated: EstimatedModel) -> Float64[np.ndarray, "m p"]:
    """Columns whose length is the root mean square over the travel, µm."""
    volumetric = build_volumetric_map(estimated.model)
    columns = volumetric.jacobian(volumetric.volume)
    columns *= UM_PER_MM * np.sqrt(volumetric.weight)[:, None, None]
    return columns.reshape(-1, columns.shape[2])


def _count_chance(drawn: Float64[np.ndarray, " d"], found: float) -> float:
    """Share of draws that are as large; never 0."""
    return float((1 + np.count_nonzero(drawn >= found)) / (1 + len(drawn)))


def list_significant(change: MachineChange) -> Iterator[ChangedEntry]:
    """The most significant entry of each symbol that has changed, surest first."""
    found: dict[str, ChangedEntry] = {}
    for entry in change.entries:
        known = found.get(entry.symbol)
        if entry.is_significant and (known is None or _excess(entry) > _excess(known)):
            found[entry.symbol] = entry
    yield from sorted(found.values(), key=_excess, reverse=True)


def _excess(entry: ChangedEntry) -> float:
    return abs(entry.difference) / entry.uncertainty
