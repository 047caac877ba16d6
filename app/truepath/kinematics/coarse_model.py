"""Models of several Runs, and the coarse one that their noise is estimated with.

The splines of the coarse model are fine enough that shapes of the errors are not taken
for noise. For the same reason it has every lost motion and, where slow changes are to
be explained, splines of time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.linalg import null_space

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.backlash import make_half_shape, make_half_width
from truepath.kinematics.effects.base import (
    Effect,
    EffectOfRun,
    Parameter,
    QuadraticPrior,
    Role,
    SplineEffect,
    columns_along,
)
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.effects.instrument import list_instrument_errors
from truepath.kinematics.identifiable import (
    build_identifiable_model,
    list_absorbed_effects,
    list_partly_determined_effects,
)
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.symbols import LINEAR, is_turn, list_error_motions
from truepath.kinematics.model import MachineModel
from truepath.kinematics.splines import CubicSpline, natural_spline
from truepath.kinematics.volumetric_map import ShapeModel, build_shape_model

LONGEST_NOISE_S = 6.0  # correlated over longer: structure to be explained, not noise
_KNOT_SPACING_MM = 35.0
_TYPICAL_MM = 0.005  # of a slow shift
_POINTS_PER_KNOT = 6  # of a spline of time, for measurements at points
_UNIT_MM_S2 = 1000.0
# At 1 m/s²: more than carriages bend, so that data alone determine the size.
_BEND_MM, _BEND_RAD = 0.005, 1.5e-5


@dataclass(frozen=True)
class TimeSpline(SplineEffect):
    """Slow shift of all points with time: a natural spline without its mean."""

    kind = "time-spline"
    role = Role.NUISANCE
    direction: str
    spline: CubicSpline
    gauge: Float64[np.ndarray, "k p"]

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        return columns_along(self.direction, self.spline.basis(at.time_s) @ self.gauge)

    def prior(self) -> QuadraticPrior:
        """Mean square over the Run, of typical size 5 µm."""
        return self.mean_square_prior(_TYPICAL_MM, "time")


@dataclass(frozen=True)
class LineShift(Effect):
    """A separate shift of all points on each line.

    lines : numbers of the lines
    """

    kind = "line-shift"
    role = Role.NUISANCE
    direction: str
    lines: tuple[int, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"{self.name}[{n}]", "mm") for n in self.lines)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """1 along the direction on the parameter's own line, else 0."""
        on_line = at.line[:, None] == np.array(self.lines)
        return columns_along(self.direction, on_line.astype(np.float64))

    def prior(self) -> QuadraticPrior:
        count = len(self.lines)
        return QuadraticPrior(np.eye(count), count, count * _TYPICAL_MM**2, "line")


@dataclass(frozen=True)
class InertialBend(Effect):
    """The six error motions of an axis at an acceleration of 1 m/s².

    The carriage leans, with all that it carries. Only samples on ramps show it. Every
    estimate that uses them includes it: near the ends of lines it would be taken for
    error motions.
    """

    kind = "inertial-bend"
    role = Role.NUISANCE
    axis: LinearAxis

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{self.name}-{symbol}", "rad" if is_turn(symbol) else "mm")
            for symbol in list_error_motions(self.axis.name)
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arms of the error motions, times the acceleration in m/s²."""
        columns = np.zeros((len(at), 3, len(self.parameters)))
        share = at.axis_acceleration(self.axis.name) / _UNIT_MM_S2
        moving = np.flatnonzero(share)
        if len(moving):
            for k, symbol in enumerate(list_error_motions(self.axis.name)):
                arm = compute_arm(symbol, at)[moving]
                columns[moving, :, k] = arm * share[moving, None]
        return columns

    def prior(self) -> QuadraticPrior:
        sigma = [
            _BEND_RAD if is_turn(symbol) else _BEND_MM
            for symbol in list_error_motions(self.axis.name)
        ]
        form = np.diag(np.array(sigma) ** -2.0)
        return QuadraticPrior(form, len(sigma), float(len(sigma)), is_known=True)


@dataclass(frozen=True)
class NestedModels:
    """Models of Runs that differ in their treatment of the direction of approach.

    alone : error motions, and effects known before
    confounded : further effects of the machine that the targets do not determine
    """

    alone: MachineModel
    confounded: tuple[Effect, ...] = ()

    @cached_property
    def with_confounded(self) -> MachineModel:
        return self.alone.with_confounded(self.confounded)

    @cached_property
    def with_half_widths(self) -> MachineModel:
        return add_half_widths(self.alone)

    @cached_property
    def with_half_tables(self) -> MachineModel:
        motions = self.alone.identifiable_motions
        shapes = [make_half_shape(m.symbol, m.axis) for m in motions]
        return self.with_half_widths.with_effects(*shapes)


def build_baseline_models(
    machine: Machine,
    conditions: Sequence[Conditions],
    reference: MachineModel | None = None,
) -> tuple[NestedModels, MachineModel]:
    """The model that Runs are compared with, and the coarse one for their noise.

    Both have the systematic errors of the tracker.

    conditions : of each Run
    reference : the model; all that the Runs can identify of a rigid body if None
    """
    offsets_mm = [at.offset_mm for at in conditions]
    slow = [shift for at in conditions for shift in _list_slow_shifts(at)]
    instrument = list_instrument_errors(conditions)
    if reference is None:
        nested = _nest(machine, offsets_mm, instrument)
    else:
        nested = NestedModels(reference.with_effects(*instrument))
    model = nested.alone
    further = (*slow, *instrument, *model.catalogue_effects)
    return nested, build_coarse_model(model.machine, offsets_mm, (), further)


def _nest(
    machine: Machine,
    offsets_mm: Sequence[Float64[np.ndarray, "_ 3"]],
    known: Sequence[Effect] = (),
) -> NestedModels:
    model, _ = build_identifiable_model(machine, *offsets_mm)
    partly = list_partly_determined_effects(machine, *offsets_mm)
    absorbed = list_absorbed_effects(machine, *offsets_mm)
    return NestedModels(model.with_effects(*known).with_confounded(partly), absorbed)


def _list_slow_shifts(at: Conditions) -> Iterator[Effect]:
    """Knots of time are too far apart for one point. Lines of rotary axes are arcs that
    each show other errors: a shift of each would leave nothing to locate the tracker
    by.
    """
    spacing_s = LONGEST_NOISE_S
    first, last = float(at.time_s.min()), float(at.time_s.max())
    if (at.line < 0).all():
        spacing_s = max(spacing_s, _POINTS_PER_KNOT * (last - first) / len(at))
    count = max(3, int(np.ceil((last - first) / spacing_s)) + 1)
    spline = natural_spline(np.linspace(first, last, count))
    gauge = null_space((spline.gram() @ np.ones(spline.size))[None, :])
    lines = tuple(np.unique(at.line[at.line >= 0]).tolist())
    for direction in LINEAR:
        yield EffectOfRun(TimeSpline(direction, spline, gauge), at.run)
        if lines and not at.machine.rotary_axes:
            yield EffectOfRun(LineShift(direction, lines), at.run)


@dataclass(frozen=True)
class RunModels:
    """Models that Runs of one machine are solved with.

    coarse : for their noise; shapes : for the errors that they determine
    """

    nested: NestedModels
    coarse: MachineModel
    shapes: ShapeModel

    def with_effects(self, *effects: Effect) -> RunModels:
        """The effects are added to `nested` and `coarse`, not to `shapes`."""
        alone = add_effects(self.nested.alone, effects)
        nested = replace(self.nested, alone=alone)
        return replace(self, nested=nested, coarse=add_effects(self.coarse, effects))

    def add_bends(self) -> RunModels:
        """For Runs that include samples on ramps."""
        alone = add_bends(self.nested.alone)
        return replace(self, nested=replace(self.nested, alone=alone))


def build_run_models(
    machine: Machine, runs: Sequence[Conditions], known: Sequence[Effect] = ()
) -> RunModels:
    """Models of Runs, with the systematic errors of the tracker.

    machine : that of the Runs, with the targets of all
    known : effects of the machine from an earlier measurement
    """
    offsets_mm = [at.offset_mm for at in runs]
    instrument = list_instrument_errors(runs)
    return RunModels(
        _nest(machine, offsets_mm, (*known, *instrument)),
        build_coarse_model(machine, offsets_mm, known, instrument),
        build_shape_model(machine, *offsets_mm),
    )


def build_coarse_model(
    machine: Machine,
    offsets_mm: Sequence[Float64[np.ndarray, "_ 3"]],
    known: Sequence[Effect] = (),
    further: Sequence[Effect] = (),
) -> MachineModel:
    """Model of error motions, lost motions and further effects.

    offsets_mm : of the targets in each Run
    known : effects of the machine from an earlier measurement
    further : further effects; those already in the model are skipped
    """
    model, _ = build_identifiable_model(
        machine, *offsets_mm, knot_spacing_mm=_KNOT_SPACING_MM
    )
    partly = list_partly_determined_effects(machine, *offsets_mm)
    model = model.with_effects(*known).with_confounded(partly)
    return add_effects(add_half_widths(model), further)


def add_effects(model: MachineModel, effects: Sequence[Effect]) -> MachineModel:
    """Effects that the model has already, by name, are skipped."""
    return model.with_effects(*(e for e in effects if e.name not in model.slices))


def add_bends(model: MachineModel) -> MachineModel:
    """With the bending of each linear axis' carriage under acceleration."""
    axes = model.machine.linear_axes
    return add_effects(model, [InertialBend(axis) for axis in axes])


def add_half_widths(model: MachineModel) -> MachineModel:
    """With a half width for each error motion.

    None for a motion whose lost motion is an effect of the model already.
    """
    lost = {e.half_difference.symbol for e in model.effects if e.half_difference}
    motions = [m for m in model.identifiable_motions if m.symbol not in lost]
    return model.with_effects(*(make_half_width(m.symbol, m.axis) for m in motions))
