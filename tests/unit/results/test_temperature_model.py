"""Errors over temperature, on results that are drawn about a constructed truth."""

import json
from dataclasses import replace

import numpy as np
import pytest

from results_fixtures import as_loaded
from temperature_world import SHIFTED, World
from truepath.answers.temperature.combined_results import combine_results
from truepath.answers.temperature.temperature_json import temperature_json
from truepath.answers.temperature.temperature_model import study_temperature
from truepath.errors import BadInput
from truepath.files.earlier.result_file import HalfDifference
from truepath.files.earlier.temperature_file import temperature_model_from_json

KINDS = {  # of half differences: a symbol of each, and its name in a sentence
    "half_difference_um": ("EXX", "X"),
    "half_turn_urad": ("ECC", "C"),
    "half_across": ("EYX", "EYX"),
}
AT, OWN = np.array([0.0, 100.0]), 0.5


@pytest.fixture
def world(estimate):
    return World(estimate, 1e-3)  # U of a coefficient is then what matters


def name_dependent(study):
    return {one.symbol for one in study.dependences if one.is_significant}


def find_expansion(study):
    return next(one for one in study.expansions if one.axis == "X")


@pytest.mark.parametrize("scatter", [0.0, 3.0])
@pytest.mark.parametrize(
    # More would come with a chance of 0.6 and 3 % where 5 % are stated.
    ("rounds", "most"),
    [(8, 2), pytest.param(150, 12, marks=pytest.mark.long)],
)
def test_a_machine_is_said_to_depend_and_grow_as_it_does(world, rounds, most, scatter):
    steady = (study_temperature(world.draw(k, scatter=scatter)) for k in range(rounds))
    assert sum(bool(name_dependent(study)) for study in steady) <= most
    world.grow(11.0)
    grown = (study_temperature(world.draw(k, scatter=scatter)) for k in range(rounds))
    found = [find_expansion(study) for study in grown]
    off_um = [abs(one.value_um_per_m_k - 11.0) for one in found]
    u_um = [2.0 * one.uncertainty_um_per_m_k for one in found]
    assert np.sum(np.less(off_um, u_um)) >= rounds - most


def test_only_what_depends_on_temperature_is_named_and_comes_back_from_a_file(world):
    study = study_temperature(world.grow(11.0).draw(1))
    assert name_dependent(study) == {SHIFTED}
    assert study.model.grows == {"X"}
    model = study.model
    content = json.loads(json.dumps(temperature_json(study)))
    again = temperature_model_from_json(content, file="temperature.json")
    for celsius in (19.0, 24.0):
        one, other = model.at(celsius), again.at(celsius)
        np.testing.assert_allclose(other.theta, one.theta, rtol=1e-6, atol=1e-12)
        pair = other.covariance, one.covariance
        np.testing.assert_allclose(*pair, rtol=1e-6, atol=1e-20)
    assert again.grows == {"X"}


def test_a_wide_scatter_of_set_ups_is_not_taken_for_temperature(world):
    steady, loose = (study_temperature(world.draw(3, scatter=s)) for s in (0.0, 30.0))
    assert name_dependent(loose) == set()
    u, more = (find_expansion(x).uncertainty_um_per_m_k for x in (steady, loose))
    assert more > 3.0 * u


def test_an_unseen_temperature_is_told_better_by_the_line_than_by_the_mean(world):
    results = world.grow(11.0).draw(5, (18.0, 25.0, 20.0))
    at = study_temperature(results).model.at(23.5)
    truth = world.estimate.theta + 3.5 * world.coefficient
    mean = np.mean([one.result.theta for one in results], axis=0)
    part = world.model.slices[SHIFTED]
    off = at.theta - truth, mean - truth
    line_off, mean_off = (np.linalg.norm(one[part]) for one in off)
    assert line_off < 0.3 * mean_off


def test_results_that_tell_no_temperatures_apart_or_share_a_run_are_refused(world):
    with pytest.raises(BadInput, match="2 different temperatures"):
        study_temperature(world.draw(1, (20.0, 20.1, 24.0), sigma_k=0.0))
    first, second, third = world.draw(1, (18.0, 20.0, 22.0))
    same = replace(third.result, provenance=first.result.provenance)
    with pytest.raises(BadInput, match="share a Run"):
        study_temperature([first, second, replace(third, result=same)])
    world.covariance *= 50.0
    world.root *= 50.0**0.5
    with pytest.raises(BadInput, match="measure further apart in temperature"):
        study_temperature(world.draw(1, (19.6, 20.4, 20.0), sigma_k=0.0))


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (None, "is not known"),
        ((0.0, 30.0, 10.0, 20.0), "rise from result to result"),
        ((0.0, 10.0, 20.0, 30.0), ""),
    ],
)
def test_a_drift_over_time_that_would_look_the_same_is_named(world, times, words):
    study = study_temperature(world.draw(1, times=times))
    said = " ".join(study.cautions)
    assert (words in said) if words else not said
    doubtful = study.model.reference.verdict.state == "doubtful"
    assert doubtful == words.startswith("rise")


def test_beyond_the_measured_temperatures_nothing_is_told_unless_asked(world):
    results = world.draw(1, sigma_k=0.0)
    with pytest.raises(BadInput, match="is beyond the 18"):
        study_temperature(results).model.at(27.0)
    wide = study_temperature(results, range_degc=(15.0, 30.0)).model
    at = {celsius: wide.at(celsius).covariance.trace() for celsius in (21.0, 27.0)}
    assert at[27.0] > 2.0 * at[21.0]


def state(result, half):
    one = HalfDifference(AT, np.full(2, half), np.full(2, OWN))
    return replace(result, halves={symbol: one for symbol, _ in KINDS.values()})


@pytest.mark.parametrize("kind", KINDS)
def test_lost_motion_is_the_mean_and_as_uncertain_as_results_scatter(estimate, kind):
    results = [state(as_loaded(estimate), half) for half in (1.0, 2.0, 3.0)]
    joined = combine_results(results).result
    symbol, name = KINDS[kind]
    half = joined.halves[symbol]
    np.testing.assert_array_equal(half.position, AT)
    np.testing.assert_allclose(half.value, 2.0)
    expected = np.sqrt((OWN**2 + 1.0) / 3.0)  # 1 is the scatter of 1, 2 and 3
    np.testing.assert_allclose(half.sigma, expected)
    others = {s: one for s, one in results[1].halves.items() if s != symbol}
    lacking = replace(results[1], halves=others)
    combined = combine_results([results[0], lacking, results[2]])
    assert list(combined.result.halves) == list(others)
    ((_, words),) = combined.left_out
    assert words.rstrip(".").endswith(f" {name}")
