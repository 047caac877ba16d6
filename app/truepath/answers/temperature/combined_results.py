"""Results of one machine in the parameters that all of them have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.files.earlier.verdict import State, Verdict
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.machine.symbols import is_positioning
from truepath.kinematics.model import MachineModel


@dataclass(frozen=True)
class CombinedResults:
    """Parameters of each result, in the effects that all of them have.

    result : the mean of what is no parameter; its parameters are those of the first
    left_out : sentences on what only some results have, with the state that allows
    """

    model: MachineModel
    theta: Float64[np.ndarray, "n p"]
    covariance: Float64[np.ndarray, "n p p"]
    result: CalibrationResult
    left_out: tuple[tuple[State, str], ...]


def combine_results(results: Sequence[CalibrationResult]) -> CombinedResults:
    """Results restricted to common effects. Raises BadInput where none is.

    An effect is common where it has the same parameters in all. Lost motion is the mean
    over the results, where all have it.
    """
    first = results[0].model
    common = [e for e in first.effects if all(_has(r.model, e) for r in results[1:])]
    if not any(effect.iso_symbol for effect in common):
        raise BadInput("the results state no error motion in common")
    names = {e.name for e in common}
    model = replace(first, effects=tuple(common), confounded=first.confounded & names)
    parts = [_select(result, model) for result in results]
    theta = np.stack([theta for theta, _ in parts])
    covariance = np.stack([covariance for _, covariance in parts])
    joined = replace(
        results[0],
        model=model,
        theta=theta[0],
        covariance=covariance[0],
        unobservable=tuple(dict.fromkeys(s for r in results for s in r.unobservable)),
        provenance=_join_provenance(results),
        measured=_join_ranges(results),
        halves=_average_half_differences(results),
        verdict=Verdict.merge(r.verdict for r in results),
    )
    left_out = _list_excluded(results, names)
    return CombinedResults(model, theta, covariance, joined, left_out)


def _has(model: MachineModel, effect: Effect) -> bool:
    other = next((e for e in model.effects if e.name == effect.name), None)
    if other is None or other.parameters != effect.parameters:
        return False
    return (effect.name in model.compensated_turns) == (
        other.name in model.compensated_turns
    )


def _select(
    result: CalibrationResult, model: MachineModel
) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, "p p"]]:
    every = np.arange(result.model.size)
    kept = np.concatenate([every[result.model.slices[e.name]] for e in model.effects])
    return result.theta[kept], result.covariance[np.ix_(kept, kept)]


def _average_half_differences(
    results: Sequence[CalibrationResult],
) -> dict[str, HalfDifference]:
    joined: dict[str, HalfDifference] = {}
    for symbol, first in results[0].halves.items():
        halves = [r.halves[symbol] for r in results if symbol in r.halves]
        if len(halves) < len(results):
            continue
        at, sigma = first.position, None
        stated = [np.interp(at, half.position, half.value) for half in halves]
        own = [
            np.interp(at, half.position, half.sigma)
            for half in halves
            if half.sigma is not None
        ]
        if len(own) == len(halves):
            squares = np.mean(np.square(own), axis=0) + np.var(stated, axis=0, ddof=1)
            sigma = np.sqrt(squares / len(results))
        joined[symbol] = HalfDifference(at, np.mean(stated, axis=0), sigma)
    return joined


def _join_ranges(
    results: Sequence[CalibrationResult],
) -> dict[str, tuple[float, float]]:
    return {
        axis: (
            max(r.measured[axis][0] for r in results),
            min(r.measured[axis][1] for r in results),
        )
        for axis in results[0].measured
        if all(axis in r.measured for r in results)
    }


def _join_provenance(results: Sequence[CalibrationResult]) -> dict[str, object]:
    first = dict(results[0].provenance)
    names = [str(r.provenance.get("run", "")) for r in results]
    runs = [run for r in results for run in r.provenance.get("runs") or ()]
    return {**first, "run": ", ".join(names), "runs": runs}


def _list_excluded(
    results: Sequence[CalibrationResult], names: set[str]
) -> tuple[tuple[State, str], ...]:
    every = {e.name: None for r in results for e in r.model.effects}
    told: list[tuple[State, str]] = []
    if missing := [name for name in every if name not in names]:
        text = f"Left out, as not all results state it alike: {', '.join(missing)}."
        told.append(("usable", text))
    halves = dict.fromkeys(symbol for r in results for symbol in r.halves)
    partly = sorted(s for s in halves if not all(s in r.halves for r in results))
    some = [symbol[2] for symbol in partly if is_positioning(symbol)]
    if some:
        text = f"Left out, as not all results state lost motion of {', '.join(some)}."
        told.append(("usable", text))
    some = [symbol for symbol in partly if not is_positioning(symbol)]
    if some:
        text = f"Left out, as not all results state lost motion in {', '.join(some)}."
        told.append(("usable", text))
    return tuple(told)
