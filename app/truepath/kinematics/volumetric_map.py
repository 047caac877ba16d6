"""The volumetric error anywhere, without the rigid motion of the whole volume.

The pose of the tracker is no error of the machine: map and uncertainty are given after
the best-fit rigid motion over the axis travel (uniform weight) is removed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, make_standstill
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.identifiable import Confounded, build_identifiable_model
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import MachineModel
from truepath.numerics.rigid import cross_matrix
from truepath.numerics.sobol import compute_sobol_points

# Shapes down to a fifth of the travel; finer ones the prior bridges.
SHAPE_INTERVALS = 5
_EVEN = 2**11  # points where there are rotary axes
_ROUNDING = 1e-12  # of the largest singular value: a motion without effect
_NODES = 16  # Gauss–Legendre nodes an axis: for the shapes that splines take


_Composed = dict[bytes, Float64[np.ndarray, "6"] | None]


@dataclass(frozen=True, slots=True)
class VolumetricMap:
    """Linear map from θ to the volumetric error less its rigid motion.

    rigid : (6, p) rigid motion of the whole volume per parameter
    volume, weight : points over the whole travel, and the weight of each
    """

    model: MachineModel
    rigid: Float64[np.ndarray, "6 p"]
    centre_mm: Float64[np.ndarray, "3"]
    volume: Conditions
    weight: Float64[np.ndarray, " n"]
    _composed: _Composed = field(default_factory=_Composed, repr=False, compare=False)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """∂(volumetric error, mm)/∂θ."""
        return (
            _machine_columns(self.model, at)
            - _rigid_columns(at, self.centre_mm) @ self.rigid
        )

    def error_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Volumetric error δ = actual − nominal, to second order of the motions."""
        linear = self.jacobian(at) @ theta
        rigid = self._find_composed_rigid(theta)
        if rigid is None:
            return linear
        added = compute_second_order_mm(self.model, at, theta)
        return linear + added - _rigid_columns(at, self.centre_mm) @ rigid

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """δ in the gauge of the error motions, its rigid motion not removed.

        Locations of rotary axes are given in that gauge.
        """
        moved = _machine_columns(self.model, at) @ theta
        if self._find_composed_rigid(theta) is None:
            return moved
        return moved + compute_second_order_mm(self.model, at, theta)

    def _find_composed_rigid(
        self, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "6"] | None:
        """None where displacements add up; found once per θ."""
        key = theta.tobytes()
        if key not in self._composed:
            rigid = None
            if not is_nearly_linear(self.model, self.volume, theta):
                added = compute_second_order_mm(self.model, self.volume, theta)
                rigid = _fit_rigid(self.volume, self.weight, self.centre_mm, added)
            self._composed.clear()
            self._composed[key] = rigid
        return self._composed[key]

    def sigma_mm(
        self, at: Conditions, covariance: Float64[np.ndarray, "p p"]
    ) -> Float64[np.ndarray, "n 3"]:
        # Two-dimensional, so that one product of matrices serves all points.
        J = self.jacobian(at).reshape(-1, self.model.size)
        variance = np.einsum("mp,mp->m", J @ covariance, J)
        return np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3)


def build_volumetric_map(model: MachineModel, target: str = "") -> VolumetricMap:
    """For one target, over the axis travel."""
    at, weight = _quadrature(model.machine, target)
    centre = weight @ at.point_mm
    fit = _fit_rigid(at, weight, centre, _machine_columns(model, at))
    return VolumetricMap(model, fit, centre, at, weight)


def compute_volumetric_gram(
    model: MachineModel, target: str = ""
) -> Float64[np.ndarray, "p p"]:
    """G with E|δ|² = tr(G C): mean square length over the axis travel, mm².

    C is the covariance of θ. It is the integral of the Gram matrix in closed form
    (brunn-hanebeck-2005, eq. 24–26 and 34–36), without the rigid motion.
    """
    return compute_component_grams(model, target).sum(axis=0)


def compute_component_grams(
    model: MachineModel, target: str = ""
) -> Float64[np.ndarray, "3 p p"]:
    """Gₖ with E δₖ² = tr(Gₖ C), k in x, y, z, as `compute_volumetric_gram`."""
    at, weight = _quadrature(model.machine, target)
    columns, centre = _machine_columns(model, at), weight @ at.point_mm
    columns -= _rigid_columns(at, centre) @ _fit_rigid(at, weight, centre, columns)
    columns *= np.sqrt(weight)[:, None, None]
    return np.array([columns[:, k].T @ columns[:, k] for k in range(3)])


@dataclass(frozen=True, slots=True)
class ShapeModel:
    """Error motions in few shapes each, for assessing measurements.

    confounded : motions that the targets do not determine
    gram : θᵀ G θ is the mean square of the volumetric error over the travel
    """

    model: MachineModel
    confounded: tuple[Confounded, ...]
    gram: Float64[np.ndarray, "p p"]


def build_shape_model(
    machine: Machine,
    *offsets_mm: Float64[np.ndarray, "_ 3"],
    intervals: int = SHAPE_INTERVALS,
) -> ShapeModel:
    """Model that the targets determine, in shapes of some intervals per axis.

    offsets_mm : (t, 3) offsets of the targets measured in a Run, one Run after another
    """
    model, confounded = build_identifiable_model(
        machine, *offsets_mm, intervals=intervals
    )
    return ShapeModel(model, confounded, compute_volumetric_gram(model))


def _machine_columns(
    model: MachineModel, at: Conditions
) -> Float64[np.ndarray, "n 3 p"]:
    """The machine alone: seats of targets are no error of it."""
    columns = model.jacobian(at)
    for effect in model.effects:
        if effect.role is Role.NUISANCE:
            columns[:, :, model.slices[effect.name]] = 0.0
    return columns


def _quadrature(
    machine: Machine, target: str
) -> tuple[Conditions, Float64[np.ndarray, " n"]]:
    if machine.rotary_axes:
        return _evenly_spread(machine, target)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    grid = np.meshgrid(*[node] * len(machine.axes), indexing="ij")
    weights = np.meshgrid(*[weight] * len(machine.axes), indexing="ij")
    low, high = machine.travel
    unit = np.stack([g.ravel() for g in grid], axis=1)
    position = low + (unit + 1.0) / 2.0 * (high - low)
    total = np.prod([w.ravel() for w in weights], axis=0)
    offset = np.tile(np.array(machine.target(target).offset_mm, float), (len(unit), 1))
    return make_standstill(machine, position, offset), total / total.sum()


def _evenly_spread(
    machine: Machine, target: str
) -> tuple[Conditions, Float64[np.ndarray, " n"]]:
    """A grid of five axes would have too many points."""
    unit = compute_sobol_points(len(machine.axes), _EVEN)
    low, high = machine.travel
    offset = np.tile(np.array(machine.target(target).offset_mm, float), (len(unit), 1))
    at = make_standstill(machine, low + unit * (high - low), offset)
    return at, np.full(len(unit), 1.0 / len(unit))


def _fit_rigid(
    at: Conditions,
    weight: Float64[np.ndarray, " n"],
    centre_mm: Float64[np.ndarray, "3"],
    moved: Float64[np.ndarray, "n 3 ..."],
) -> Float64[np.ndarray, "6 ..."]:
    root = np.repeat(np.sqrt(weight), 3)
    rigid = _rigid_columns(at, centre_mm).reshape(-1, 6) * root[:, None]
    # A pseudo-inverse of six columns: quick, however many displacements there are.
    fit = np.linalg.pinv(rigid, rcond=_ROUNDING) * root
    return fit @ moved.reshape(3 * len(at), *moved.shape[2:])


def _rigid_columns(
    at: Conditions, centre_mm: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "n 3 6"]:
    columns = np.zeros((len(at), 3, 6))
    columns[:, :, :3] = np.eye(3)
    columns[:, :, 3:] = cross_matrix(at.point_mm - centre_mm)
    return columns


_SMALL_MM = 1e-4
_FEW = 200
_ARM_MM = 100.0  # by which a target is moved to determine a turn


def compute_second_order_mm(
    model: MachineModel, at: Conditions, theta: Float64[np.ndarray, " p"]
) -> Float64[np.ndarray, "n 3"]:
    """Difference between the composed motions and their linear sum."""
    by_axis = _group_by_axis(model)
    added, beyond = np.zeros((len(at), 3)), np.zeros((len(at), 3))
    for axis in reversed(_order_from_observer(at.machine, at.observer)):
        if axis in by_axis:
            turn = _find_turn(model, by_axis[axis], at, theta)
            arc = np.cross(turn, _arm_mm(at, axis))
            added += np.cross(turn, beyond + 0.5 * arc)
            beyond += _displace(model, by_axis[axis], at, theta)
    return added


def is_nearly_linear(
    model: MachineModel, at: Conditions, theta: Float64[np.ndarray, " p"]
) -> bool:
    """Whether displacements add to 0.1 µm, checked at a few moments."""
    few = at.select(np.arange(0, len(at), max(1, len(at) // _FEW)))
    added_mm = compute_second_order_mm(model, few, theta)
    return bool(np.abs(added_mm).max(initial=0.0) < _SMALL_MM)


def _group_by_axis(model: MachineModel) -> dict[str, list[Effect]]:
    found: dict[str, list[Effect]] = {}
    for effect in model.effects:
        curve = effect.half_difference
        symbol = effect.iso_symbol or (curve.symbol if curve else "")
        if symbol:
            found.setdefault(symbol[2], []).append(effect)
    return found


def _order_from_observer(machine: Machine, observer: str) -> tuple[str, ...]:
    """From the base the chain goes to the tool, or backwards to the workpiece."""
    if observer == "base":
        return (*reversed(machine.workpiece_side), *machine.tool_side)
    return (*machine.workpiece_side, *machine.tool_side)


def _displace(
    model: MachineModel,
    effects: list[Effect],
    at: Conditions,
    theta: Float64[np.ndarray, " p"],
) -> Float64[np.ndarray, "n 3"]:
    moved = np.zeros((len(at), 3))
    for effect in effects:
        moved += effect.displacement_mm(at, theta[model.slices[effect.name]])
    return moved


def _arm_mm(at: Conditions, axis: str) -> Float64[np.ndarray, "n 3"]:
    lever = at.chain.lever(axis)
    # Seen from the base, the workpiece turns the other way.
    sign = np.sign(np.linalg.det(lever.frame))
    arm = np.einsum("nij,nj->ni", lever.frame, lever.lever_mm)
    return sign[:, None] * arm


def _find_turn(
    model: MachineModel,
    effects: list[Effect],
    at: Conditions,
    theta: Float64[np.ndarray, " p"],
) -> Float64[np.ndarray, "n 3"]:
    frame = at.chain.tool_frame + at.chain.workpiece_frame
    here = _displace(model, effects, at, theta)
    turn = np.zeros((len(at), 3))
    for k in range(3):
        farther = at.offset_mm + _ARM_MM * np.eye(3)[k]
        there = _displace(model, effects, replace(at, offset_mm=farther), theta)
        # Σ a × (Ω × a) = 2 Ω over three directions a that are square to each other.
        turn += 0.5 * np.cross(frame[:, :, k], (there - here) / _ARM_MM)
    return turn
