"""Error motions that the measured targets determine, from geometry alone.

It works for any serial chain, for targets on tool and workpiece, and for a tracker on
either side. With one tool offset only 14 of the 18 error motions of a three-axis
machine move the target in distinct ways: turns of the last axis are confounded with its
straightness, and so is the turn of the last but one about the last axis' direction. Two
tool lengths give 16, three offsets off one line 18. What is confounded is named, and
solved for under a prior alone; a pseudo-inverse would return it as a silent zero.

A motion is confounded if at every position of its axis its arm is a combination of the
arms of motions that are kept. Most such motions the others absorb, and estimates are
made without them first. A turn of a rotary axis about the line of two targets is
determined in some directions and not in others: no single turn absorbs it. Squarenesses
and locations of rotary axes enter where they add to that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag

from truepath.kinematics.conditions import Conditions, observe_targets
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.error_motion import (
    compute_arm,
    list_axis_locations,
    list_squarenesses,
    make_error_motion,
)
from truepath.kinematics.effects.pose_timing_seats import (
    TargetSeat,
    TrackerPose,
    list_target_seats,
)
from truepath.kinematics.machine.machine import (
    SAME_TARGET_MM,
    Axis,
    Machine,
    RotaryAxis,
    Target,
)
from truepath.kinematics.machine.symbols import (
    describe_symbol,
    is_turn,
    list_error_motions,
)
from truepath.kinematics.model import MachineModel

# Of an error motion. The prior limits its bending: closer knots only cost time.
KNOT_SPACING_MM = 22.0
KNOT_SPACING_DEG = 15.0
_MOST_INTERVALS = 32  # unless a motion needs more
_CONFOUNDED_INTERVALS = 12  # what data do not show needs no fine shapes
_PLACES, _AROUND = 5, 40  # positions of an axis, configurations of the others at each
_PROBE = 700  # configurations that represent the whole volume
_INTERVALS = 8  # shapes of motions with which single numbers are compared
_SAME_ARM = 1e-6


@dataclass(frozen=True, slots=True)
class Confounded:
    """An error motion that these targets do not distinguish from others.

    varies : the turns that replace it change along its axis, without bounds: without
        it, they would not be smooth; or a location of such an axis
    """

    symbol: str
    partners: tuple[str, ...]
    varies: bool = False

    def __str__(self) -> str:
        named = f"{self.symbol} ({describe_symbol(self.symbol)})"
        if not self.partners:
            return f"{named} does not move the target"
        return (
            f"{named} is not distinguishable from {', '.join(self.partners)} with "
            "the measured tool offsets; another tool length or offset separates them"
        )


def build_identifiable_model(
    machine: Machine,
    *offsets_mm: Float64[np.ndarray, "_ 3"],
    knot_spacing_mm: float = KNOT_SPACING_MM,
    intervals: int | None = None,
) -> tuple[MachineModel, tuple[Confounded, ...]]:
    """The model that these targets determine, and what is confounded.

    offsets_mm : (t, 3) offsets of the targets measured in a Run, one Run after another
    intervals : the same number of knot intervals on every axis, instead of a spacing
    """
    runs = tuple(_targets_at(machine, offsets) for offsets in offsets_mm)
    symbols, others, confounded = _find_identifiable(machine, runs)
    axes = {axis.name: axis for axis in machine.axes}
    motions = [
        make_error_motion(
            s, axes[s[2]], intervals or _intervals(axes[s[2]], knot_spacing_mm)
        )
        for s in symbols
    ]
    return MachineModel(machine, (*motions, *others)), confounded


def list_confounded_effects(
    machine: Machine, *offsets_mm: Float64[np.ndarray, "_ 3"]
) -> tuple[Effect, ...]:
    """Effects of the machine that these targets do not distinguish from others.

    They move another target, or another tool, in ways that the data do not determine.
    """
    return (
        *list_partly_determined_effects(machine, *offsets_mm),
        *list_absorbed_effects(machine, *offsets_mm),
    )


def list_partly_determined_effects(
    machine: Machine, *offsets_mm: Float64[np.ndarray, "_ 3"]
) -> tuple[Effect, ...]:
    """Confounded effects that an estimate of the others cannot leave out.

    Such are turns of a head about the line of its targets, which turns with it, and the
    location of the axis of such turns.
    """
    return _list_confounded(machine, offsets_mm, varies=True)


def list_absorbed_effects(
    machine: Machine, *offsets_mm: Float64[np.ndarray, "_ 3"]
) -> tuple[Effect, ...]:
    """All other confounded effects: without them the model fits equally well."""
    return _list_confounded(machine, offsets_mm, varies=False)


def _list_confounded(
    machine: Machine, offsets_mm: Sequence[Float64[np.ndarray, "_ 3"]], *, varies: bool
) -> tuple[Effect, ...]:
    runs = tuple(_targets_at(machine, offsets) for offsets in offsets_mm)
    _, _, confounded = _find_identifiable(machine, runs)
    axes = {s: axis for axis in machine.axes for s in list_error_motions(axis.name)}
    known = {effect.name: effect for effect in list_location_errors(machine)}
    return tuple(
        known.get(one.symbol) or _make_confounded(one.symbol, axes[one.symbol])
        for one in confounded
        if one.varies == varies
    )


def _make_confounded(symbol: str, axis: Axis) -> Effect:
    intervals = min(_CONFOUNDED_INTERVALS, _intervals(axis, KNOT_SPACING_MM))
    return make_error_motion(symbol, axis, intervals)


def _targets_at(
    machine: Machine, offsets_mm: Float64[np.ndarray, "_ 3"]
) -> tuple[Target, ...]:
    """Targets that are not in the machine file are on the tool."""
    # One target is measured for many samples: no need to sort equal ones.
    changes = np.diff(offsets_mm, axis=0, prepend=np.inf).any(axis=1)
    offsets_mm = np.unique(offsets_mm[changes], axis=0)
    stated = np.array([t.offset_mm for t in machine.targets]).reshape(-1, 3)
    away = np.abs(offsets_mm[:, None] - stated).max(axis=2, initial=0.0)
    same = away < SAME_TARGET_MM
    known = [machine.targets[k] for k in np.flatnonzero(same.any(axis=0))]
    others = offsets_mm[~same.any(axis=1)]
    return (*known, *(Target("", "tool", (x, y, z)) for x, y, z in others.tolist()))


def _intervals(axis: Axis, spacing_mm: float) -> int:
    if isinstance(axis, RotaryAxis):
        spacing = KNOT_SPACING_DEG * spacing_mm / KNOT_SPACING_MM
        return max(6, round(min(axis.high - axis.low, 360.0) / spacing))
    most = round(_MOST_INTERVALS * KNOT_SPACING_MM / spacing_mm)
    return min(most, max(3, round((axis.high - axis.low) / spacing_mm)))


@lru_cache(maxsize=16)  # requested again by every stage of an estimate
def _find_identifiable(
    machine: Machine, runs: tuple[tuple[Target, ...], ...]
) -> tuple[tuple[str, ...], tuple[Effect, ...], tuple[Confounded, ...]]:
    targets = list(dict.fromkeys(target for run in runs for target in run))
    symbols = [s for axis in machine.axes for s in list_error_motions(axis.name)]
    arms = _probe_arms(machine, targets)
    kept: list[str] = []
    confounded: list[Confounded] = []
    # Displacements first: where a turn is confounded with one, the turn is left out.
    for symbol in sorted(symbols, key=is_turn):
        found = _find_partners(symbol, kept, arms)
        if found is None:
            kept.append(symbol)
        else:
            confounded.append(found)
    others, undetermined = select_location_errors(
        runs, *_probe_volume(machine, runs, kept)
    )
    partly = {one.symbol[2] for one in confounded if one.varies}
    left_out = [
        Confounded(s, partners, s[2] in partly) for s, partners in undetermined.items()
    ]
    motions = tuple(s for s in symbols if s in kept)
    return motions, tuple(others), (*confounded, *left_out)


def _probe_volume(
    machine: Machine, runs: Sequence[Sequence[Target]], kept: Sequence[str]
) -> tuple[list[Conditions], list[Effect]]:
    each_run = [
        replace(_probe(machine, targets, _PROBE, run), run=run)
        for run, targets in enumerate(runs)
    ]
    axes = {axis.name: axis for axis in machine.axes}
    return each_run, [make_error_motion(s, axes[s[2]], _INTERVALS) for s in kept]


def _probe_arms(
    machine: Machine, targets: Sequence[Target]
) -> dict[str, Float64[np.ndarray, "p m"]]:
    arms: dict[str, Float64[np.ndarray, "p m"]] = {}
    for axis in machine.axes:
        places = [
            _probe(machine, targets, _AROUND, place, axis.name)
            for place in range(_PLACES)
        ]
        for symbol in list_error_motions(axis.name):
            arm = np.stack([compute_arm(symbol, at).ravel() for at in places])
            arms[symbol] = arm / 100.0 if is_turn(symbol) else arm
    return arms


def _find_partners(
    symbol: str, kept: list[str], arms: Mapping[str, Float64[np.ndarray, "p m"]]
) -> Confounded | None:
    own, candidates = arms[symbol], [k for k in kept if k[2] == symbol[2]]
    others = np.stack([arms[m] for m in candidates] or [0.0 * own], axis=2)
    solution = np.linalg.pinv(others, rcond=1e-10) @ own[:, :, None]
    left = float(np.abs(own[:, :, None] - others @ solution).max())
    size = float(np.abs(own).max())
    if size < _SAME_ARM:
        return Confounded(symbol, ())
    if left > _SAME_ARM * size:
        return None
    share = np.abs(solution[:, :, 0]).max(axis=0)
    change = float(np.ptp(solution[:, :, 0], axis=0).max())
    pairs = zip(candidates, share.tolist(), strict=True)
    partners = tuple(m for m, s in pairs if s > 1e-3 * share.max())
    varies = change > 1e-3 * float(share.max()) and any(map(is_turn, partners))
    return Confounded(symbol, partners, varies=varies)


def _probe(
    machine: Machine, targets: Sequence[Target], count: int, seed: int, fixed: str = ""
) -> Conditions:
    rng = np.random.default_rng(seed)
    low, high = machine.travel
    position = rng.uniform(low, high, (count * len(targets), len(low)))
    if fixed:
        column = machine.axis_names.index(fixed)
        position[:, column] = position[0, column]
    return observe_targets(machine, position, targets)


_NEW_SHAPE = 0.02  # splines make a sine to a hundredth


def select_location_errors(
    runs: Sequence[Sequence[Target]],
    each_run: Sequence[Conditions],
    motions: Sequence[Effect],
) -> tuple[list[Effect], dict[str, tuple[str, ...]]]:
    """Numbers and seats that are determined; the others with their partners.

    runs : the targets measured in each Run; each_run : probes of the volume by them
    motions : error motions that are determined
    """
    poses, seats = _find_seats(runs, each_run)
    blocks = [poses, *(_columns(e, each_run) for e in (*motions, *seats))]
    basis, _ = np.linalg.qr(np.hstack(blocks))
    added: list[Effect] = []
    undetermined: dict[str, tuple[str, ...]] = {}
    for effect in list_location_errors(each_run[0].machine):
        own = _columns(effect, each_run)
        size = float(np.linalg.norm(own))
        new = _remove(basis, own)
        if size > 0.0 and np.linalg.norm(new) > _NEW_SHAPE * size:
            more, _ = np.linalg.qr(new)
            basis = np.hstack([basis, more])
            added.append(effect)
        else:
            partners = _nearest(own, [*motions, *added], each_run) if size > 0.0 else ()
            undetermined[effect.name] = partners
    return [*added, *seats], undetermined


def list_location_errors(machine: Machine) -> list[Effect]:
    """Squarenesses, then the locations of the rotary axes."""
    found: list[Effect] = [*list_squarenesses(machine.axis_names)]
    for axis in machine.rotary_axes:
        found += list_axis_locations(axis)
    return found


def _find_seats(
    runs: Sequence[Sequence[Target]], each_run: Sequence[Conditions]
) -> tuple[Float64[np.ndarray, "m q"], list[TargetSeat]]:
    """A seat that looks like an error motion stays: its prior limits it."""
    poses = _pose_columns(each_run)
    basis, _ = np.linalg.qr(poses)
    found: list[TargetSeat] = []
    for seat in list_target_seats(runs):
        own = _columns(seat, each_run)
        new = _remove(basis, own)
        if np.linalg.norm(new) > _NEW_SHAPE * np.linalg.norm(own):
            more, size, _ = np.linalg.svd(new, full_matrices=False)
            basis = np.hstack([basis, more[:, size > _NEW_SHAPE * size[0]]])
            found.append(seat)
    return poses, found


def _remove(
    basis: Float64[np.ndarray, "m b"], columns: Float64[np.ndarray, "m p"]
) -> Float64[np.ndarray, "m p"]:
    """Projected off an orthonormal basis twice, because of rounding."""
    once = columns - basis @ (basis.T @ columns)
    return once - basis @ (basis.T @ once)


def _pose_columns(each_run: Sequence[Conditions]) -> Float64[np.ndarray, "m q"]:
    poses: list[Float64[np.ndarray, "_ 6"]] = []
    for at in each_run:
        x, y, z = (float(v) for v in at.point_mm.mean(axis=0))
        poses.append(_columns(TrackerPose((x, y, z)), [at]))
    return np.asarray(block_diag(*poses), np.float64)


def _columns(
    effect: Effect, each_run: Sequence[Conditions]
) -> Float64[np.ndarray, "m p"]:
    J = np.concatenate([effect.jacobian(at) for at in each_run])
    return J.reshape(-1, J.shape[2])


def _nearest(
    own: Float64[np.ndarray, "m 1"], known: list[Effect], each_run: Sequence[Conditions]
) -> tuple[str, ...]:
    blocks = [_columns(e, each_run) for e in known]
    scale = [1.0 / max(float(np.linalg.norm(b)), 1e-12) for b in blocks]
    stacked = np.hstack([b * s for b, s in zip(blocks, scale, strict=True)])
    solution, *_ = np.linalg.lstsq(stacked, own, rcond=1e-6)
    ends = np.cumsum([b.shape[1] for b in blocks])
    part = [float(np.linalg.norm(p)) for p in np.split(solution, ends[:-1])]
    return tuple(
        e.name
        for e, p in zip(known, part, strict=True)
        if p > 0.2 * max(part) and e.role is Role.MACHINE
    )
