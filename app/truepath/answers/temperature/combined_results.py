"""Results of one machine in the parameters that all of them have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.files.earlier.result_file import CalibrationResult, Sigmas, Tables
from truepath.files.earlier.verdict import State, Verdict
from truepath.kinematics.effects.base import Effect
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
    half, half_u = _average_half_differences(
        [(r.half_difference_um, r.half_difference_u_um) for r in results]
    )
    turn, turn_u = _average_half_differences(
        [(r.half_turn_urad, r.half_turn_u_urad) for r in results]
    )
    across, across_u = _average_half_differences(
        [(r.half_across, r.half_across_u) for r in results]
    )
    joined = replace(
        results[0],
        model=model,
        theta=theta[0],
        covariance=covariance[0],
        unobservable=tuple(dict.fromkeys(s for r in results for s in r.unobservable)),
        provenance=_join_provenance(results),
        measured=_join_ranges(results),
        half_difference_um=half,
        half_difference_u_um=half_u,
        half_turn_urad=turn,
        half_turn_u_urad=turn_u,
        verdict=Verdict.merge(r.verdict for r in results),
        half_across=across,
        half_across_u=across_u,
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
    results: Sequence[tuple[Tables, Sigmas]],
) -> tuple[Tables, Sigmas]:
    mean: Tables = {}
    sigma: Sigmas = {}
    for name, (at, _) in results[0][0].items():
        if not all(name in tables for tables, _ in results):
            continue
        stated = [np.interp(at, *tables[name]) for tables, _ in results]
        mean[name] = at, np.mean(stated, axis=0)
        if all(name in sigmas for _, sigmas in results):
            own = [
                np.interp(at, tables[name][0], sigmas[name])
                for tables, sigmas in results
            ]
            squares = np.mean(np.square(own), axis=0) + np.var(stated, axis=0, ddof=1)
            sigma[name] = np.sqrt(squares / len(results))
    return mean, sigma


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
    lost: list[set[str]] = [{*r.half_difference_um, *r.half_turn_urad} for r in results]
    some = sorted(set[str]().union(*lost) - lost[0].intersection(*lost))
    if some:
        text = f"Left out, as not all results state lost motion of {', '.join(some)}."
        told.append(("usable", text))
    across = dict.fromkeys(symbol for r in results for symbol in r.half_across)
    some = sorted(s for s in across if not all(s in r.half_across for r in results))
    if some:
        text = f"Left out, as not all results state lost motion in {', '.join(some)}."
        told.append(("usable", text))
    return tuple(told)
