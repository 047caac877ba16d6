"""Which error motions the measured targets can tell apart, decided from geometry alone.

With one tool offset only 14 of the 18 error motions of a three-axis machine move the
target in ways of their own: turns of the last axis merge with its straightness, and the
turn of the last but one about the last axis' direction merges likewise. Two tool
lengths give 16, three offsets off one line 18. What merges is left out of the solve and
named; a pseudo-inverse would return it as a silent zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions, standstill
from app.kinematics.effects.error_motion import arm_of, error_motion
from app.kinematics.effects.squareness import squareness_between
from app.kinematics.effects.tool_orientation import tool_orientation
from app.kinematics.identifiable_chain import told_by
from app.kinematics.machine import Axis, Machine, RotaryAxis
from app.kinematics.model import MachineModel
from app.kinematics.symbols import error_motions, is_turn, meaning
from app.numerics.splines import natural_spline

# Of an error motion. How much it bends is for the prior to say: closer knots only cost
# time.
KNOT_SPACING_MM = 22.0
KNOT_SPACING_DEG = 15.0
_SAME_TARGET_MM = 1e-6  # rounding
_PROBE = 400  # configurations that stand for the whole volume
_SHAPES = 5  # knots of the shapes that motions are told apart by
_NEW_SHAPE = 1e-6  # relative size of a new singular value


@dataclass(frozen=True, slots=True)
class Confounded:
    """An error motion that no data of these targets tell from others."""

    symbol: str
    partners: tuple[str, ...]

    def __str__(self) -> str:
        """Return the statement for reports."""
        if not self.partners:
            return f"{self.symbol} ({meaning(self.symbol)}) does not move the target"
        others = ", ".join(self.partners)
        return (
            f"{self.symbol} ({meaning(self.symbol)}) cannot be told from {others} with "
            "the measured tool offsets; another tool length or offset separates them"
        )


def identifiable_model(
    machine: Machine,
    *offsets_mm: Float64[np.ndarray, "_ 3"],
    knot_spacing_mm: float = KNOT_SPACING_MM,
    intervals: int | None = None,
) -> tuple[MachineModel, tuple[Confounded, ...]]:
    """Return the model of what these targets can tell, and what merged.

    offsets_mm : (t, 3) offsets of the targets measured in a Run, one Run after another
    intervals : the same number of knot intervals on every axis, instead of a spacing
    """
    each_run = [np.unique(offsets, axis=0) for offsets in offsets_mm]
    if not _is_plain(machine):
        return _chain_model(machine, each_run, knot_spacing_mm, intervals)
    symbols = [s for axis in machine.linear_axes for s in error_motions(axis.name)]
    # Displacements first: where a turn merges with one, the displacement is kept.
    symbols.sort(key=is_turn)
    travels = {axis.name: axis for axis in machine.linear_axes}
    probe = _probe(machine, np.unique(np.concatenate(each_run), axis=0))
    columns = {s: _columns(s, travels[s[2]], probe) for s in symbols}
    kept: list[str] = []
    merged: list[Confounded] = []
    for symbol in symbols:
        partners = _absorbed_by(symbol, kept, columns)
        if partners is None:
            kept.append(symbol)
        else:
            merged.append(Confounded(symbol, partners))
    ordered = [
        s for axis in machine.linear_axes for s in error_motions(axis.name) if s in kept
    ]
    motions = tuple(
        error_motion(
            s, travels[s[2]], intervals or _intervals(travels[s[2]], knot_spacing_mm)
        )
        for s in ordered
    )
    squareness = squareness_between(tuple(travels))
    tool = [
        effect
        for run, targets in enumerate(each_run)
        for effect in tool_orientation(machine, targets, run)
    ]
    return MachineModel(machine, (*motions, *squareness, *tool)), tuple(merged)


def _is_plain(machine: Machine) -> bool:
    """Tell whether straight axes move targets on a tool seen from the workpiece."""
    on_tool = all(t.on == "tool" for t in machine.targets)
    from_workpiece = machine.tracker.stands_on == "workpiece"
    return on_tool and from_workpiece and not machine.rotary_axes


def _chain_model(
    machine: Machine,
    each_run: list[Float64[np.ndarray, "_ 3"]],
    knot_spacing_mm: float,
    intervals: int | None,
) -> tuple[MachineModel, tuple[Confounded, ...]]:
    told = told_by(
        machine,
        tuple(
            tuple(t for t in machine.targets if _is_among(t.offset_mm, measured))
            for measured in each_run
        ),
    )
    axes = {axis.name: axis for axis in machine.axes}
    motions = [
        error_motion(
            s, axes[s[2]], intervals or _intervals(axes[s[2]], knot_spacing_mm)
        )
        for s in told.motions
    ]
    merged = tuple(Confounded(symbol, mates) for symbol, mates in told.merged)
    return MachineModel(machine, (*motions, *told.others)), merged


def _is_among(
    offset_mm: tuple[float, float, float], measured: Float64[np.ndarray, "t 3"]
) -> bool:
    away = np.abs(measured - np.array(offset_mm)).max(axis=1)
    return bool(away.min() < _SAME_TARGET_MM)


def _intervals(axis: Axis, spacing_mm: float) -> int:
    if isinstance(axis, RotaryAxis):
        spacing = KNOT_SPACING_DEG * spacing_mm / KNOT_SPACING_MM
        return max(6, round(min(axis.high - axis.low, 360.0) / spacing))
    return max(3, round((axis.max_mm - axis.min_mm) / spacing_mm))


def _probe(machine: Machine, offsets_mm: Float64[np.ndarray, "t 3"]) -> Conditions:
    rng = np.random.default_rng(0)
    low = np.array([a.min_mm for a in machine.linear_axes])
    high = np.array([a.max_mm for a in machine.linear_axes])
    position = rng.uniform(low, high, (_PROBE, len(low)))
    offset = offsets_mm[np.arange(_PROBE) % len(offsets_mm)]
    return standstill(machine, position, offset)


def _columns(symbol: str, axis: Axis, probe: Conditions) -> Float64[np.ndarray, "m p"]:
    """Return what a motion does to the target; a few smooth shapes stand for all."""
    spline = natural_spline(np.linspace(axis.low, axis.high, _SHAPES))
    rows = spline.basis(probe.axis_mm(axis.name))
    arm = arm_of(symbol, probe)[:, :, None] * rows[:, None, :]
    columns = arm.reshape(-1, spline.size)
    return columns / 100.0 if is_turn(symbol) else columns


def _absorbed_by(
    symbol: str, kept: list[str], columns: dict[str, Float64[np.ndarray, "m p"]]
) -> tuple[str, ...] | None:
    """Return the kept motions that make all of this one's shapes already, or None."""
    mates = [k for k in kept if k[2] == symbol[2]]
    own = columns[symbol]
    if np.abs(own).max() < _NEW_SHAPE:
        return ()
    if not mates:
        return None
    others = np.hstack([columns[m] for m in mates])
    solution, *_ = np.linalg.lstsq(others, own, rcond=1e-10)
    left = np.linalg.norm(own - others @ solution) / np.linalg.norm(own)
    if left > _NEW_SHAPE:
        return None
    size = own.shape[1]
    share = [
        float(np.abs(solution[i * size : (i + 1) * size]).max())
        for i in range(len(mates))
    ]
    return tuple(m for m, s in zip(mates, share, strict=True) if s > 1e-3 * max(share))
