"""A machine's errors as they depend on its temperature, from several results.

The results are restricted to the effects that all of them have. The line of each
parameter is in `estimation.solve.temperature_regression`; here it becomes
properties of the machine: tables at any temperature and per kelvin, which error motions
depend on temperature for sure, and by how much an axis grows. An error motion is said
to depend only if the largest |coefficient| / uncertainty of its table is more than
chance makes it, over the tables of all (Holm 1979): of a machine that does not depend,
any at all is named with a chance of 5 % at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from truepath.answers.trend import intersect_ranges
from truepath.errors import BadInput
from truepath.estimation.solve.temperature_regression import (
    Scatter,
    TableRows,
    TemperatureLine,
    fit_temperature_line,
)
from truepath.files.bundle.one_machine import have_same_targets, one_machine
from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.files.earlier.temperature_file import TemperatureModel
from truepath.files.earlier.verdict import STATED, Reason, State, Verdict
from truepath.files.units import UM_PER_MM, scale_of
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import find_unit, is_positioning
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.error_tables import choose_table_positions

REFERENCE_DEGC = 20.0
CHANCE = 0.05  # that any motion is named for a machine that does not depend
_FEWEST = 3
_POSITIONING = ("EXX", "EYY", "EZZ")
_DRAWS = 4_000
_DIFFERENT_K = 0.3  # temperatures that are less apart are one
_MATTERS_UM_PER_M_K = 2.0  # of the longest travel: a sixth of what steel grows
_ALIKE = 0.9  # correlation above which time and temperature are confounded


@dataclass(frozen=True)
class _CombinedResults:
    """Parameters of each result, in the effects that all of them have.

    result : the mean of what is no parameter; its parameters are those of the first
    left_out : sentences on what only some results have, with the state that allows
    """

    model: MachineModel
    theta: Float64[np.ndarray, "n p"]
    covariance: Float64[np.ndarray, "n p p"]
    result: CalibrationResult
    left_out: tuple[tuple[State, str], ...]


def combine_results(results: Sequence[CalibrationResult]) -> _CombinedResults:
    """Results restricted to common effects. Raises BadInput where none is.

    An effect is common where it has the same parameters in all. Lost motion is the mean
    over the results, where all have it.
    """
    first = results[0].model
    common = [
        effect
        for effect in first.effects
        if all(
            any(
                other.name == effect.name and other.parameters == effect.parameters
                for other in result.model.effects
            )
            for result in results[1:]
        )
    ]
    if not any(effect.iso_symbol for effect in common):
        raise BadInput("the results state no error motion in common")
    names = {e.name for e in common}
    model = replace(first, effects=tuple(common), confounded=first.confounded & names)
    thetas: list[Float64[np.ndarray, " p"]] = []
    covariances: list[Float64[np.ndarray, "p p"]] = []
    for result in results:
        every = np.arange(result.model.size)
        kept = np.concatenate([every[result.model.slices[e.name]] for e in common])
        thetas.append(result.theta[kept])
        covariances.append(result.covariance[np.ix_(kept, kept)])
    theta, covariance = np.stack(thetas), np.stack(covariances)
    ranges = [r.measured for r in results]
    names_of_runs = ", ".join(str(r.provenance.get("run", "")) for r in results)
    runs = [run for r in results for run in r.provenance.get("runs") or ()]
    combined = replace(
        results[0],
        model=model,
        theta=theta[0],
        covariance=covariance[0],
        unobservable=tuple(dict.fromkeys(s for r in results for s in r.unobservable)),
        provenance={**results[0].provenance, "run": names_of_runs, "runs": runs},
        measured=intersect_ranges(ranges),
        halves=_average_half_differences(results),
        verdict=Verdict.merge(r.verdict for r in results),
    )
    left_out = _list_excluded(results, names)
    return _CombinedResults(model, theta, covariance, combined, left_out)


def _average_half_differences(
    results: Sequence[CalibrationResult],
) -> dict[str, HalfDifference]:
    average: dict[str, HalfDifference] = {}
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
        average[symbol] = HalfDifference(at, np.mean(stated, axis=0), sigma)
    return average


def _list_excluded(
    results: Sequence[CalibrationResult], names: set[str]
) -> tuple[tuple[State, str], ...]:
    every = {e.name: None for r in results for e in r.model.effects}
    missing = [name for name in every if name not in names]
    halves = dict.fromkeys(symbol for r in results for symbol in r.halves)
    partly = sorted(s for s in halves if not all(s in r.halves for r in results))
    excluded = {
        "it alike:": missing,
        "lost motion of": [s[2] for s in partly if is_positioning(s)],
        "lost motion in": [s for s in partly if not is_positioning(s)],
    }
    return tuple(
        ("usable", f"Left out, as not all results state {what} {', '.join(symbols)}.")
        for what, symbols in excluded.items()
        if symbols
    )


@dataclass(frozen=True, slots=True)
class ResultAtTemperature:
    """A result, and the temperature of the machine.

    sigma_k : its standard uncertainty, without what all results share
    time_s : middle of its measurement from any origin; None where unknown
    """

    name: str
    result: CalibrationResult
    temperature_degc: float
    sigma_k: float
    time_s: float | None = None


@dataclass(frozen=True, slots=True)
class Dependence:
    """Whether an error motion, squareness or location depends on temperature.

    largest : |coefficient| / standard uncertainty of the entry of its table where that
        is largest; chance : that so large a one comes without dependence
    """

    symbol: str
    scatter: Scatter
    largest: float
    chance: float
    is_significant: bool


@dataclass(frozen=True, slots=True)
class Expansion:
    """Growth of an axis by its positioning, µm/(m·K), k = 1."""

    axis: str
    value_um_per_m_k: float
    uncertainty_um_per_m_k: float
    is_significant: bool


@dataclass(frozen=True)
class TemperatureStudy:
    """A temperature model with its evidence.

    dependences : of each error motion, squareness and location
    volumetric_um_per_k : root mean square of the coefficient over the travel;
        `volumetric_u_um_per_k` of its uncertainty (k = 1)
    """

    model: TemperatureModel
    results: tuple[ResultAtTemperature, ...]
    dependences: tuple[Dependence, ...]
    expansions: tuple[Expansion, ...]
    volumetric_um_per_k: float
    volumetric_u_um_per_k: float
    cautions: tuple[str, ...] = field(default=())


def study_temperature(
    results: Sequence[ResultAtTemperature],
    *,
    reference_degc: float = REFERENCE_DEGC,
    range_degc: tuple[float, float] | None = None,
    matters_um_per_k: float | None = None,
) -> TemperatureStudy:
    """Fit the dependence of a machine's errors on its temperature.

    range_degc : that the line is taken to hold for; the measured one if None
    matters_um_per_k : uncertainty (k = 2) of the coefficient, root mean square over the
        travel, above which BadInput is raised; if None 2 µm/(m·K) of the longest travel

    Raises BadInput for fewer than three temperatures, temperatures too close together,
    results that share a Run or hold for other targets; BundleError for those of
    different machines.
    """
    _require_independent(results)
    celsius = np.array([one.temperature_degc for one in results])
    sigma_k = np.array([one.sigma_k for one in results])
    _require_temperatures(celsius, sigma_k)
    combined = combine_results([one.result for one in results])
    tables: list[TableRows] = []
    for effect in combined.model.effects:
        part = combined.model.slices[effect.name]
        rows = np.eye(part.stop - part.start)
        if motion := effect.motion:
            rows = motion.rows(choose_table_positions(motion.axis))
        tables.append(TableRows(effect.name, part, rows))
    line = fit_temperature_line(
        combined.theta, combined.covariance, celsius - reference_degc, sigma_k, tables
    )
    dependences = _test_dependences(line, tables)
    # So that k = 2 covers 95 % of few results as well.
    widening = np.ones(len(line.value))
    for one in tables:
        widening[one.part] = line.scatter[one.name].coverage
    both = np.tile(widening, 2)
    covariance = line.covariance * both[:, None] * both
    count = combined.model.size
    coefficient = covariance[count:, count:]
    volumetric = _compute_volumetric(combined.model, line.per_kelvin, coefficient)
    _require_meaning(combined.model.machine, celsius, volumetric[1], matters_um_per_k)
    measured = float(celsius.min()), float(celsius.max())
    cautions = (*combined.left_out, *_list_cautions(results))
    texts = [Reason(STATED, state, {"text": text}) for state, text in cautions]
    verdict = Verdict.merge([combined.result.verdict, Verdict(tuple(texts))])
    between = covariance[:count, count:]
    model = TemperatureModel(
        replace(
            combined.result,
            theta=line.value,
            covariance=covariance[:count, :count],
            verdict=verdict,
        ),
        line.per_kelvin,
        coefficient,
        between + between.T,
        reference_degc,
        measured,
        range_degc or measured,
        frozenset(
            one.symbol[2]
            for one in dependences
            if one.is_significant and one.symbol in _POSITIONING
        ),
    )
    return TemperatureStudy(
        model,
        tuple(results),
        dependences,
        tuple(_list_expansions(model)),
        *volumetric,
        tuple(text for _, text in cautions),
    )


def _require_independent(results: Sequence[ResultAtTemperature]) -> None:
    names = [one.name for one in results]
    machines = [one.result.machine for one in results]
    if len(results) < _FEWEST:
        raise BadInput(
            f"{len(results)} results: a line in temperature needs three or more, at "
            "different temperatures"
        )
    one_machine(machines, names)
    seen: dict[str, str] = {}
    for one in results:
        if not have_same_targets(machines[0], one.result.machine):
            raise BadInput(
                f"{one.name} holds for other targets than {names[0]}, or another tool; "
                "give results that were measured with the same"
            )
        for run in one.result.provenance.get("runs") or ():
            digest = str(run["input_sha256"])
            if digest in seen:
                raise BadInput(
                    f"{one.name} and {seen[digest]} share a Run, so that they are not "
                    "independent; leave one out"
                )
            seen[digest] = one.name


def _require_temperatures(
    celsius: Float64[np.ndarray, " n"], sigma_k: Float64[np.ndarray, " n"]
) -> None:
    apart_k = max(_DIFFERENT_K, 3.0 * float(sigma_k.max(initial=0.0)))
    different: list[float] = []
    for one in np.sort(celsius):
        if not different or one - different[-1] > apart_k:
            different.append(float(one))
    if len(different) < _FEWEST:
        shown = ", ".join(f"{one:.1f}" for one in celsius)
        raise BadInput(
            f"the results are at {len(different)} different temperatures ({shown} °C; "
            f"less than {apart_k:.1f} K apart counts as one): measure at three or more"
        )


def _require_meaning(
    machine: Machine,
    celsius: Float64[np.ndarray, " n"],
    u_um_per_k: float,
    matters_um_per_k: float | None,
) -> None:
    longest_m = max(axis.high - axis.low for axis in machine.linear_axes) * 1e-3
    matters = matters_um_per_k or _MATTERS_UM_PER_M_K * longest_m
    if 2.0 * u_um_per_k > matters:
        raise BadInput(
            f"temperatures from {celsius.min():.1f} to {celsius.max():.1f} °C tell the "
            f"change per kelvin to {2.0 * u_um_per_k:.2f} µm/K only (k = 2, root mean "
            f"square over the travel), more than the {matters:.2f} µm/K that matter: "
            "measure further apart in temperature or more often, or set the machine up "
            "so that repeated results agree better"
        )


def _test_dependences(
    line: TemperatureLine, tables: Sequence[TableRows]
) -> tuple[Dependence, ...]:
    """Largest coefficient of each table, compared with samples without dependence."""
    count = len(line.value)
    rng = np.random.default_rng(1)
    found: list[tuple[str, float, float]] = []
    for one in tables:
        own = slice(count + one.part.start, count + one.part.stop)
        covariance = line.covariance[own, own]
        value, vector = np.linalg.eigh(covariance)
        rows = one.rows @ (vector * np.sqrt(np.maximum(value, 0.0)))
        sigma = np.linalg.norm(rows, axis=1)
        known = sigma > 1e-6 * sigma.max(initial=0.0)
        drawn = rows[known] @ rng.standard_normal((len(value), _DRAWS))
        highest = np.max(np.abs(drawn) / sigma[known, None], axis=0, initial=0.0)
        freedom = line.scatter[one.name].freedom
        if np.isfinite(freedom):
            highest /= np.sqrt(rng.chisquare(freedom, _DRAWS) / freedom)
        coefficient = one.rows[known] @ line.per_kelvin[one.part]
        largest = float(np.max(np.abs(coefficient) / sigma[known], initial=0.0))
        chance = (1.0 + np.count_nonzero(highest >= largest)) / (1.0 + _DRAWS)
        found.append((one.name, largest, float(chance)))
    sure = _select_significant([chance for _, _, chance in found])
    return tuple(
        Dependence(name, line.scatter[name], largest, chance, k in sure)
        for k, (name, largest, chance) in enumerate(found)
    )


def _select_significant(chances: Sequence[float]) -> list[int]:
    """Holm's step-down test."""
    chosen: list[int] = []
    for k in np.argsort(chances):
        if chances[k] * (len(chances) - len(chosen)) > CHANCE:
            break
        chosen.append(int(k))
    return chosen


def _compute_volumetric(
    model: MachineModel,
    per_kelvin: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[float, float]:
    volumetric = build_volumetric_map(model)
    columns = volumetric.jacobian(volumetric.volume)
    columns *= UM_PER_MM * np.sqrt(volumetric.weight)[:, None, None]
    columns = columns.reshape(-1, model.size)
    gram = columns.T @ columns
    value = float(np.sqrt(max(per_kelvin @ gram @ per_kelvin, 0.0)))
    return value, float(np.sqrt(np.sum(gram * covariance)))


def _list_expansions(model: TemperatureModel) -> Iterator[Expansion]:
    """The straight part of each axis' positioning, per kelvin."""
    result = model.coefficients.reduce_to_targets
    for motion in result.model.identifiable_motions:
        axis = motion.axis
        if motion.symbol not in _POSITIONING:
            continue
        at_mm = choose_table_positions(axis)
        centred = at_mm - at_mm.mean()
        row = centred / (centred @ centred) @ motion.rows(at_mm)
        theta, covariance = result.part(motion.name)
        scale = scale_of(find_unit(motion.symbol)) * 1e3
        yield Expansion(
            axis.name,
            float(scale * row @ theta),
            float(scale * np.sqrt(row @ covariance @ row)),
            axis.name in model.grows,
        )


def _list_cautions(
    results: Sequence[ResultAtTemperature],
) -> Iterator[tuple[State, str]]:
    times = [one.time_s for one in results if one.time_s is not None]
    if len(times) < len(results):
        yield (
            "usable",
            "When the results were measured is not known, so a drift over time cannot "
            "be told from temperature: state the times, or measure temperatures in no "
            "order.",
        )
        return
    celsius = np.array([one.temperature_degc for one in results])[np.argsort(times)]
    steps = np.diff(celsius)
    if (steps >= 0.0).all() or (steps <= 0.0).all():
        course = "rise" if steps.sum() > 0.0 else "fall"
        yield (
            "doubtful",
            f"The temperatures {course} from result to result: a drift over time would "
            "look the same as temperature. Measure once more at a temperature that was "
            "measured early.",
        )
        return
    alike = float(np.corrcoef(np.sort(times), celsius)[0, 1])
    if abs(alike) > _ALIKE:
        yield (
            "doubtful",
            "Temperature and time nearly go together (correlation "
            f"{alike:.2f}): a drift over time would look much the same. Measure once "
            "more at a temperature that was measured early.",
        )
