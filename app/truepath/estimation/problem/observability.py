"""Shapes that a measurement determines poorly or not at all, by name.

The exact null space is spanned by singular vectors of the whitened problem. A shape
outside it is rated by the generalised eigenvalues of posterior against prior covariance
of a typical machine: 0 where the data determine it, 1 where they contain nothing on it.
Tables contain such shapes with an uncertainty that comes more from the prior than from
the measurement.

Confounded motions come with the target that would separate them. A turn of an axis that
carries the target at a constant arm moves it like a displacement of the same axis. Two
arms separate them: the turn is the difference of both displacements over the difference
of the arms, so its standard uncertainty is √2 u / ΔL, u that of the displacement found
with one tool. ΔL follows from the requirement that the turn is known as well as the
turns that one tool determines; where no tool is long enough for that, to half of a
typical one (k = 2). Arms of a rotary axis turn with it, and such a length means
nothing: there a trial target shows whether one more is enough, by the rank that it
adds, and which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.linalg import eigh

from truepath.estimation.problem.confounded_prior import straight_precision
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior import diagonal_precision, guess_prior
from truepath.kinematics.effects.base import Effect, ErrorCurve
from truepath.kinematics.effects.error_motion import (
    ErrorMotion,
    get_typical_size,
    make_error_motion,
)
from truepath.kinematics.identifiable import Confounded, build_identifiable_model
from truepath.kinematics.machine.machine import Machine, Target
from truepath.kinematics.machine.symbols import (
    DIRECTION,
    SQUARENESS,
    describe_symbol,
    is_turn,
)
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import SHAPE_INTERVALS, ShapeModel

USUAL = {"mm": 0.1, "rad": 1e-3}  # of shapes without bending: slopes, squarenesses
_POOR = 0.5  # remaining share of a typical machine's standard deviation
_RELEVANT_MM = 1e-3  # at the tool; smaller shapes are harmless
_BLIND = 0.9999  # remaining: all but rounding
_TAKES_PART = 0.25  # of the largest part, at the tool
_MOST = 3  # shapes that are named
_MOST_PARTNERS = 3  # more motions than these are not named
_STRAIGHT = 0.05  # of a slope's square: below it a motion is straight
_BLIND_SHARE = 1e-10  # of the best determined straight shape: rounding
_STILL = 0.02  # of its travel: an axis that rests
_GRID = 41  # positions of an axis at which its form is evaluated


@dataclass(frozen=True, slots=True)
class Observability:
    """Shapes that the measurement determines, and those that it does not.

    parameters : shapes of all error motions and squarenesses in the gauge of the tables
    rank : number of them that the data determine
    unobservable : one sentence for each that they do not determine
    poorly_observable : one sentence for each that is hardly determined
    """

    parameters: int
    rank: int
    unobservable: tuple[str, ...]
    poorly_observable: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PoorlyObservableShape:
    """A combination of error motions that the data hardly determine.

    symbols : motions that take part, the largest first
    remaining : posterior standard deviation over that of a typical machine
    sigma_mm : the undetermined part, root mean square at the tool over the travel
    form : form of the first motion along its axis
    """

    symbols: tuple[str, ...]
    remaining: float
    sigma_mm: float
    form: str

    def __str__(self) -> str:
        who = self.symbols[0]
        others = self.symbols[1 : 1 + _MOST_PARTNERS]
        if others:
            who += f" together with {', '.join(others)}"
            who += " and others" if len(self.symbols) > 1 + len(others) else ""
        return (
            f"{who}: {self.form} is poorly observable; "
            f"{100 * self.remaining:.0f} % of what a usual machine may have "
            f"stays open, {2e3 * self.sigma_mm:.1f} µm at the tool (k = 2)"
        )


def typical_precision_matrix(
    model: MachineModel, prior_precision: Mapping[str, float] | None = None
) -> Float64[np.ndarray, "p p"]:
    """Prior precision of a typical machine, proper in every direction.

    prior_precision : of effects, by name, where it is known better
    """
    prior = guess_prior(model)
    known = {n: s for n, s in (prior_precision or {}).items() if n in prior.precision}
    prior = replace(prior, precision={**prior.precision, **known})
    slack = diagonal_precision(model.parameters, USUAL)
    for effect in model.effects:
        part = model.slices[effect.name]
        if effect.name in model.confounded:
            slack[part, part] = straight_precision(effect)
        elif (penalty := prior.penalties.get(effect.name)) and penalty.is_known:
            slack[part, part] = 0.0
    return prior.precision_matrix(model.size) + slack


def detect_poorly_observable(
    information: Float64[np.ndarray, "p p"],
    model: MachineModel,
    gram: Float64[np.ndarray, "p p"],
    *,
    blind: bool = True,
) -> tuple[PoorlyObservableShape, ...]:
    """Poorly observable shapes that matter, the worst first.

    information : of the data on the model, everything else integrated out
    gram : θᵀ G θ is the mean square of the volumetric error over the travel
    blind : include shapes that the data do not determine at all
    """
    prior = typical_precision_matrix(model)
    # Vᵀ P V = 1: each shape is one standard deviation of a typical machine.
    value, vector = eigh(information, prior)
    remaining = 1.0 / np.sqrt(1.0 + np.maximum(value, 0.0))
    size = remaining * np.sqrt(
        np.einsum("ps,pq,qs->s", vector, gram, vector, optimize=True)
    )
    order = np.argsort(-size)
    most = 1.0 if blind else _BLIND
    poor = [i for i in order if _POOR < remaining[i] <= most and size[i] > _RELEVANT_MM]
    return tuple(
        _name_shape(model, gram, vector[:, i], float(remaining[i]), float(size[i]))
        for i in poor[:_MOST]
    )


def _name_shape(
    model: MachineModel,
    gram: Float64[np.ndarray, "p p"],
    shape: Float64[np.ndarray, " p"],
    remaining: float,
    sigma_mm: float,
) -> PoorlyObservableShape:
    part = {
        e.name: float(np.sqrt(max(shape[own] @ gram[own, own] @ shape[own], 0.0)))
        for e in model.effects
        if e.motion or e.iso_symbol in SQUARENESS
        for own in (model.slices[e.name],)
    }
    largest = max(part.values())
    names = sorted(part, key=lambda name: -part[name])
    taking = tuple(n for n in names if part[n] > _TAKES_PART * largest)
    first = next(e for e in model.effects if e.name == taking[0])
    form = "the angle"
    if first.motion:
        form = describe_form(first.motion, shape[model.slices[first.name]])
    return PoorlyObservableShape(taking, remaining, sigma_mm, form)


def describe_form(motion: ErrorCurve, theta: Float64[np.ndarray, " p"]) -> str:
    axis = motion.axis
    at = np.linspace(axis.low, axis.high, _GRID)
    value = motion.rows(at) @ theta
    unit = np.linspace(-1.0, 1.0, _GRID)
    bow, bend = (np.polynomial.legendre.Legendre.basis(k)(unit) for k in (2, 3))
    straight = np.polynomial.Polynomial.fit(unit, value, 1)(unit)
    rest = value - straight
    what = "turning" if is_turn(motion.symbol) else "error"
    if np.sum(rest**2) < _STRAIGHT * np.sum((straight - straight.mean()) ** 2):
        return f"a slope of the {what} along {axis.name}"
    even, odd = (_share(rest, form) for form in (bow, bend))
    if max(even, odd) < 0.5:
        return f"a wave of the {what} along {axis.name}"
    return f"{'a bow' if even > odd else 'an S'} of the {what} along {axis.name}"


def _share(value: Float64[np.ndarray, " n"], form: Float64[np.ndarray, " n"]) -> float:
    square = float(value @ form) ** 2 / float(form @ form)
    return square / max(float(value @ value), 1e-300)


def name_undetermined(shapes: ShapeModel, runs: Sequence[RunInput]) -> str:
    """Sentence on undetermined straight shapes, and lines that would determine them.

    Empty if all are determined. A prior on bending alone contains nothing on straight
    shapes: errors that grow along an axis, squarenesses. So all is determined where the
    data determine those, and only there. Raises Unidentifiable if not even the set-up
    is determined.
    """
    model, gram = shapes.model, shapes.gram
    found = combine_runs(collect_information(runs, model)).matrix
    unit = np.diag(diagonal_precision(model.parameters, USUAL)) ** -0.5
    straight = np.concatenate(
        [
            np.pad(
                _list_free_shapes(effect),
                ((part.start, model.size - part.stop), (0, 0)),
            )
            for effect in model.effects
            for part in (model.slices[effect.name],)
        ],
        axis=1,
    )
    basis = unit[:, None] * straight
    value, vector = np.linalg.eigh(basis.T @ found @ basis)
    blind = basis @ vector[:, value < _BLIND_SHARE * value[-1]]
    if not blind.shape[1]:
        return ""
    named = [_name_shape(model, gram, shape, 1.0, 0.0).symbols for shape in blind.T]
    symbols = sorted({symbol for each in named for symbol in each})
    return (
        f"the lines do not determine {', '.join(symbols)}; "
        f"add lines {_find_mending_lines(symbols, model.machine, runs)}"
    )


def _find_mending_lines(
    symbols: Sequence[str], machine: Machine, runs: Sequence[RunInput]
) -> str:
    position = np.concatenate([run.observations.at.position_mm for run in runs])
    pairs = zip(machine.axes, np.ptp(position, axis=0), strict=True)
    still = [a.name for a, moved in pairs if moved < _STILL * (a.high - a.low)]
    if still:
        return f"that move {' and '.join(still)} over the travel"
    axes = sorted({symbol[2] for symbol in symbols})
    return f"along {' and '.join(axes)} where the other axes stand elsewhere"


def _list_free_shapes(effect: Effect) -> Float64[np.ndarray, "p f"]:
    penalty, size = effect.prior(), len(effect.parameters)
    if penalty is None:
        return np.eye(size)
    _, shapes = np.linalg.eigh(penalty.form)
    return shapes[:, : size - penalty.rank]


_NULL_SPACE = 1e-6  # singular value relative to the largest, columns scaled to one


def assess_observability(shapes: ShapeModel, runs: Sequence[RunInput]) -> Observability:
    model, confounded = shapes.model, shapes.confounded
    found = collect_information(runs, model)
    information = combine_runs(found).matrix
    alone = np.sum([np.diag(run.data.matrix)[: model.size] for run in found], 0)
    scale = 1.0 / np.sqrt(np.maximum(alone, 1e-300))
    value, vector = np.linalg.eigh(information * scale[:, None] * scale)
    blind = value < _NULL_SPACE**2 * value[-1] + 1e-13
    covariance = np.linalg.inv(information + typical_precision_matrix(model))
    offsets_mm = np.concatenate([run.observations.at.offset_mm for run in runs])
    said = describe_confounded(offsets_mm, confounded, model, covariance)
    said += _blind_shapes(model, vector[:, blind] * scale[:, None])
    poor = detect_poorly_observable(information, model, shapes.gram, blind=False)
    return Observability(
        model.size + sum(_count_shapes(m.symbol, model.machine) for m in confounded),
        int(model.size - blind.sum()),
        said,
        tuple(str(shape) for shape in poor),
    )


def _blind_shapes(
    model: MachineModel, shapes: Float64[np.ndarray, "p b"]
) -> tuple[str, ...]:
    count = shapes.shape[1]
    if not count:
        return ()
    typical = np.linalg.norm(shapes) / np.sqrt(len(model.effects))
    part = [
        effect.name
        for effect in model.effects
        if np.linalg.norm(shapes[model.slices[effect.name]]) > 0.1 * typical
    ]
    many = f"{count} common shapes are" if count > 1 else "a common shape is"
    return (
        f"{', '.join(part)}: {many} not seen at the measured places; more lines or "
        "points that are not corner to corner show them",
    )


def _count_shapes(symbol: str, machine: Machine) -> int:
    """Number of shapes that the gauge leaves to an error motion; 1 for an angle."""
    if not symbol.startswith("E"):
        return 1
    axis = machine.axes[machine.axis_names.index(symbol[2])]
    return len(make_error_motion(symbol, axis, SHAPE_INTERVALS).parameters)


_ENOUGH_RAD = get_typical_size("EAX") / 4.0  # k = 1: half of a typical turn at k = 2
_STEP_MM = 10.0  # resolution of lengths in sentences
_TRIAL_MM = 93.7  # by which a trial target is farther: no target is likely there
_SHAPES = 4  # intervals of the knots: confounding does not depend on them
_AVERAGED = 25  # positions of an axis, to average over
# Trials in this order: the first that separates is proposed.
_TRIALS = {
    "tool{} longer or shorter": (0.0, 0.0, 1.0),
    "target{} to the side, in X or Y,": (0.6, 0.8, 0.0),
}
_LONGEST_MM = 500.0  # longest proposal


def describe_confounded(
    offsets_mm: Float64[np.ndarray, "n 3"],
    merged: Sequence[Confounded],
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[str, ...]:
    """One sentence for each confounded motion: its partners and what separates them.

    offsets_mm : of the measured targets
    model, covariance : of the determined effects, to find the required length
    """
    measured = np.unique(offsets_mm, axis=0)
    still = {
        what: _find_still_merged(model.machine, measured, np.array(way))
        for what, way in (_TRIALS.items() if merged else ())
    }
    return tuple(_statement(m, len(measured), still, model, covariance) for m in merged)


def _find_still_merged(
    machine: Machine,
    measured: Float64[np.ndarray, "t 3"],
    way: Float64[np.ndarray, "3"],
) -> set[str]:
    on_tool = next((t for t in machine.targets if t.on == "tool"), None)
    added = np.array(on_tool.offset_mm if on_tool else (0.0, 0.0, 0.0))
    added = added + _TRIAL_MM * way
    x, y, z = (float(v) for v in added)
    second = Target("second", "tool", (x, y, z))
    tried = replace(machine, targets=(*machine.targets, second))
    _, merged = build_identifiable_model(
        tried, np.vstack([measured, added]), intervals=_SHAPES
    )
    return {m.symbol for m in merged}


def _statement(
    merged: Confounded,
    tools: int,
    still: dict[str, set[str]],
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> str:
    said = f"{merged.symbol} ({describe_symbol(merged.symbol)})"
    if merged.partners:
        with_what = "one tool length" if tools == 1 else "the measured tool offsets"
        partners = " and ".join(merged.partners)
        said += f" is not distinguishable from {partners} with {with_what}"
    else:
        said += " does not move the target"
    machine, axis = model.machine, merged.symbol[2]
    has_table_target = any(t.on == "workpiece" for t in machine.targets)
    # A tracker on the base sees an axis of the table by targets on it alone.
    is_blind = machine.tracker.stands_on == "base" and not has_table_target
    if is_blind and axis in machine.workpiece_side:
        return f"{said}; targets on the workpiece, three off one line, show it"
    cure = next((w for w, names in still.items() if merged.symbol not in names), "")
    if not cure:
        return f"{said}; other targets, off one line with these, separate it"
    asked = f"a {'second' if tools == 1 else 'further'} {cure}"
    does = "separates them" if merged.partners else "shows it"
    linear = {each.name for each in machine.linear_axes}
    if not is_turn(merged.symbol) or axis not in linear:
        return f"{said}; {asked.format('')} {does}"
    way = np.array(_TRIALS[cure])
    turns = [motion for motion in model.error_motions if is_turn(motion.symbol)]
    known = [_mean_sigma(motion, model, covariance) for motion in turns] or [np.inf]
    for wanted in (min(float(np.median(known)), _ENOUGH_RAD), _ENOUGH_RAD):
        length_mm = _required_length_mm(merged.symbol, way, wanted, model, covariance)
        if length_mm <= _LONGEST_MM:
            return (
                f"{said}; {asked.format(f' at least {length_mm:.0f} mm')} {does} "
                f"(to {2e6 * wanted:.1f} µrad, k = 2, on the same path)"
            )
    return (
        f"{said}; the lines or points determine too little for any tool to change that"
    )


def _required_length_mm(
    symbol: str,
    way: Float64[np.ndarray, "3"],
    wanted_rad: float,
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> float:
    """Required additional length, rounded up.

    Along each direction the turn is known to √2 u / ΔL; directions add information.
    """
    moves = np.cross(np.eye(3)[DIRECTION[symbol[1]]], way)
    information = sum(
        (float(moves[DIRECTION[m.symbol[1]]]) / _mean_sigma(m, model, covariance)) ** 2
        for m in model.error_motions
        if m.axis.name == symbol[2] and not is_turn(m.symbol)
    )
    if information <= 0.0:
        return np.inf
    exact = np.sqrt(2.0 / information) / wanted_rad
    return float(max(_STEP_MM, _STEP_MM * np.ceil(exact / _STEP_MM)))


def _mean_sigma(
    motion: ErrorMotion, model: MachineModel, covariance: Float64[np.ndarray, "p p"]
) -> float:
    part = model.slices[motion.name]
    rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, _AVERAGED))
    variance = np.einsum("np,np->n", rows @ covariance[part, part], rows)
    return max(float(np.sqrt(np.maximum(variance, 0.0).mean())), 1e-9)
