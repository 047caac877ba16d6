"""Checks of the contract of effects and families, for any author to run.

A check takes a family and conditions in which it proposes something; it raises
NotConforming with what was not kept. With pytest:

    from truepath.kinematics.effects.conformance import CHECKS, example_conditions

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_my_effect_conforms(check):
        check(MyFamily(), example_conditions())
"""

from __future__ import annotations

import json
import pickle
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import (
    Conditions,
    RecordedState,
    make_standstill,
)
from truepath.kinematics.effects.base import Effect, Role
from truepath.kinematics.effects.family import (
    LANGUAGES,
    Candidate,
    CandidateEstimate,
    Family,
)
from truepath.kinematics.machine.machine import (
    Axis,
    LinearAxis,
    Machine,
    RotaryAxis,
    Target,
)
from truepath.kinematics.machine.tracker_noise import TrackerNoise

UNITS = ("mm", "rad", "s", "mm/s", "1/mm", "1/s", "1/K", "1")
_STEP = 1e-3
_CLOSE = 1e-9
_CELL_MM, _CELL_DEG, _CELL_S = 8.0, 3.0, 0.08  # the longest way of an axis in a cell
_MOMENTS = 21
_OFF = 0.03  # of the largest value
_FEW = 0.05  # share of the cells: a step or a kink meets few, a wave most


class NotConforming(AssertionError):
    """An effect breaks the contract of `Effect` or `Family`."""


def require(kept: bool, otherwise: str) -> None:
    """Raises NotConforming."""
    if not kept:
        raise NotConforming(otherwise)


def example_conditions(count: int = 400) -> Conditions:
    """Cells of a machine of four axes that moves, turns and warms."""
    axes: tuple[Axis, ...] = tuple(LinearAxis(name, 0.0, 500.0) for name in "XYZ")
    axes += (RotaryAxis("C", 0.0, 500.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),)
    target = Target("T", "tool", (20.0, 30.0, -100.0))
    chain = ("X", "Y", "Z", "C")
    machine = Machine("example", (), chain, axes, (target,), TrackerNoise())
    rng = np.random.default_rng(1)
    still = make_standstill(machine, rng.uniform(0.0, 500.0, (count, 4)))
    rate = rng.uniform(-100.0, 100.0, (count, 4))
    recorded = RecordedState(
        rate,
        np.full(count, 0.05),
        rng.uniform(0.0, 200.0, (count, 4)),
        still.position_mm[:, :3] + np.array([1500.0, -800.0, 300.0]),
        np.eye(3),
        ("X", "Y", "Z"),
        20.0 + np.linspace(0.0, 3.0, count)[:, None] * np.ones(3),
    )
    return replace(
        still,
        time_s=np.linspace(0.0, 120.0, count),
        line=np.arange(count) // 20,
        velocity_mm_s=rate[:, :3],
        approach=np.sign(rate),
        recorded=recorded,
    )


def jacobian_is_the_slope_of_the_displacement(family: Family, at: Conditions) -> None:
    """The Jacobian equals differences of the displacement, which is 0 at θ = 0."""
    for effect in _effects(family, at):
        J = _find_columns(effect, at)
        size = int(J.shape[2])
        require(bool(np.isfinite(J).all()), f"{effect.name} has columns not finite")
        zero = np.asarray(effect.displacement_mm(at, np.zeros(size)))
        require(
            zero.shape == (len(at), 3),
            f"{effect.name}: displacement_mm returns the shape {zero.shape}, expected "
            f"{(len(at), 3)}",
        )
        require(not zero.any(), f"{effect.name} moves the target at θ = 0")
        for k in range(size):
            theta = np.zeros(size)
            theta[k] = _STEP
            up = effect.displacement_mm(at, theta)
            down = effect.displacement_mm(at, -theta)
            apart = np.abs((up - down) / (2.0 * _STEP) - J[:, :, k]).max()
            limit = _CLOSE * max(float(np.abs(J).max()), 1.0)
            require(apart < limit, f"{effect.name}: column {k} is not the slope")


def each_cell_is_for_itself(family: Family, at: Conditions) -> None:
    """Columns of some cells are those rows of the columns of all."""
    rows = np.arange(0, len(at), 3)
    for effect in _effects(family, at):
        every, some = (_find_columns(effect, one) for one in (at, at.select(rows)))
        same = np.allclose(some, every[rows])
        require(same, f"{effect.name} depends on which other cells are asked for")


def a_cell_is_the_mean_over_its_span(family: Family, at: Conditions) -> None:
    """Columns of a cell are the mean of those at the moments within `span_s`.

    Not asked of a fast function of time alone, which is estimated otherwise.
    """
    some = at.select(np.arange(0, len(at), 3))
    if some.recorded is None:
        return
    cells, moments = _move_steadily(some, some.recorded)
    for effect in _effects(family, at):
        if effect.jacobian_in_time(np.zeros(1)) is not None:
            continue
        _, found, every = (_find_columns(effect, x) for x in (at, cells, moments))
        every = every.reshape(len(cells), _MOMENTS, *found.shape[1:])
        mean, middle = every.mean(axis=1), every[:, _MOMENTS // 2]
        limit = _OFF * np.abs(every).max(axis=(0, 1, 2))
        off = np.abs(found - mean) - limit
        if (off > 0.0).any(axis=(1, 2)).mean() <= _FEW:
            continue
        worst = int(off.argmax())
        shown, is_middle = f"{found.flat[worst]:.4g}", np.allclose(found, middle)
        shown = f"the value at its middle ({shown})" if is_middle else shown
        raise NotConforming(
            f"{effect.name}: expected the mean over the cell "
            f"({mean.flat[worst]:.4g}), found {shown}: multiply sine and cosine of a "
            "wave by attenuate_wave(2π / period * axis_rate, span_s)"
        )


def parameters_have_names_and_units(family: Family, at: Conditions) -> None:
    """One parameter per column, each with a unique name and a known unit."""
    for candidate in _propose(family, at):
        effect = candidate.effect
        names = [p.name for p in effect.parameters]
        _find_columns(effect, at)
        require(len(set(names)) == len(names), f"{effect.name}: {names} repeat")
        for p in effect.parameters:
            require(p.unit in UNITS, f"{p.name} has the unit {p.unit}; known: {UNITS}")


def effects_are_values(family: Family, at: Conditions) -> None:
    """Equal effects have one hash; different ones have different names."""
    effects = _effects(family, at)
    for effect in effects:
        again = pickle.loads(pickle.dumps(effect))  # noqa: S301 (made on this line)
        require(again == effect, f"{effect.name} is not equal to its copy")
        require(hash(again) == hash(effect), f"{effect.name} has a hash by identity")
    names = {effect.name for effect in effects}
    require(len(names) == len(effects), f"effects of {family.name} share names")


def files_bring_it_back(family: Family, at: Conditions) -> None:
    """An effect restored from its keys and numbers is equal, if it outlasts its Run."""
    for candidate in _propose(family, at):
        numbers = family.list_numbers(candidate)
        keys, numbers = json.loads(json.dumps([candidate.keys, numbers]))
        require(list(keys) == list(family.keys), f"{candidate.label}: keys {keys}")
        again = family.restore(at.machine, keys, numbers)
        if again is not None:
            require(again == candidate.effect, f"{candidate.label} comes back changed")
            require(
                family.role is not Role.MEASUREMENT, f"{family.name} outlasts a Run"
            )


def it_states_its_numbers(family: Family, at: Conditions) -> None:
    """Every number of `state` is finite and has an uncertainty."""
    for candidate in _propose(family, at):
        count = len(candidate.effect.parameters)
        require(
            type(family).state is not Family.state or len(family.stated) == count,
            f"{family.name}: stated has {len(family.stated)} entries, expected "
            f"{count}: one for each of units, or override state",
        )
        found = CandidateEstimate(
            candidate,
            candidate.prior_sigma,
            np.diag((0.1 * candidate.prior_sigma) ** 2),
            0.1,
        )
        stated = family.state(found)
        require(bool(stated), f"{candidate.label} states nothing")
        for name, quantity in stated.items():
            both = np.array([quantity.value, quantity.uncertainty])
            fine = bool(np.isfinite(both).all()) and quantity.uncertainty >= 0.0
            require(fine, f"{candidate.label}: {name} is {quantity}")


def words_are_there(family: Family, at: Conditions) -> None:
    """Title and sentences exist in every language; a title contains every key."""
    for language in LANGUAGES:
        require(language in family.words, f"{family.name} has no words in {language}")
        for what, text in asdict(family.words[language]).items():
            place = f"{family.name}, {language}: {what}"
            require(bool(text), f"{place} is empty")
            require((what == "title") != text.endswith("."), f"{place} is {text!r}")
    titles = [family.title(candidate.keys) for candidate in _propose(family, at)]
    require(len(set(titles)) == len(titles), f"titles repeat: {titles}")


CHECKS = (
    jacobian_is_the_slope_of_the_displacement,
    each_cell_is_for_itself,
    a_cell_is_the_mean_over_its_span,
    parameters_have_names_and_units,
    effects_are_values,
    files_bring_it_back,
    it_states_its_numbers,
    words_are_there,
)


def _move_steadily(
    at: Conditions, recorded: RecordedState
) -> tuple[Conditions, Conditions]:
    """Cells in which every axis moves at constant rate, and the moments within them."""
    axes, count = at.machine.axes, len(at)
    ways = [_CELL_DEG if isinstance(a, RotaryAxis) else _CELL_MM for a in axes]
    low, high = np.array([[axis.low, axis.high] for axis in axes]).T
    position = np.clip(at.position_mm, low + ways, high - ways)
    recorded = replace(
        recorded,
        rate=np.sign(recorded.rate) * ways / _CELL_S,
        span_s=np.full(count, _CELL_S),
        since_reversal=np.maximum(recorded.since_reversal, ways),
    )
    cells = replace(at, position_mm=position, recorded=recorded)
    rows = np.repeat(np.arange(count), _MOMENTS)
    steps_s = _CELL_S * ((np.arange(_MOMENTS) + 0.5) / _MOMENTS - 0.5)
    late_s, every = np.tile(steps_s, count), cells.select(rows)
    moving, way = recorded.select(rows), recorded.rate[rows] * late_s[:, None]
    every = replace(
        every,
        position_mm=every.position_mm + way,
        time_s=every.time_s + late_s,
        line_time_s=every.line_time_s + late_s,
    )
    point = every.point_mm.reshape(count, _MOMENTS, 3)
    velocity = (point[:, -1] - point[:, 0]) / (steps_s[-1] - steps_s[0])
    moved = (point - point[:, [_MOMENTS // 2]]).reshape(-1, 3) @ recorded.rotation.T
    moving = replace(
        moving,
        span_s=np.zeros(len(rows)),
        since_reversal=moving.since_reversal + np.abs(way) * np.sign(late_s)[:, None],
        tracker_mm=moving.tracker_mm + moved,
    )
    return (
        replace(cells, velocity_mm_s=velocity),
        replace(every, velocity_mm_s=velocity[rows], recorded=moving),
    )


def _propose(family: Family, at: Conditions) -> list[Candidate]:
    found = list(family.propose(at) or ())
    require(bool(found), f"{family.name} proposes nothing in these conditions")
    for candidate in found:
        shape = np.shape(candidate.prior_sigma)
        wanted = (len(candidate.effect.parameters),)
        require(
            shape == wanted,
            f"{candidate.label}: prior_sigma has the shape {shape}, expected {wanted}: "
            "a size for each entry of units",
        )
    return found


def _effects(family: Family, at: Conditions) -> list[Effect]:
    return [candidate.effect for candidate in _propose(family, at)]


def _find_columns(effect: Effect, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
    wanted = (len(at), 3, len(effect.parameters))
    expected = f"expected the shape {wanted}: conditions, X Y Z, entries of units"
    try:
        columns = np.asarray(effect.jacobian(at))
    except (ValueError, TypeError, IndexError) as error:
        failure = f"{effect.name}: jacobian fails ({error}); {expected}"
        raise NotConforming(failure) from error
    require(
        columns.shape == wanted,
        f"{effect.name}: jacobian returns the shape {columns.shape}, {expected}",
    )
    return columns
