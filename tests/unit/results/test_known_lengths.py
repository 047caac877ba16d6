"""A length that is known otherwise settles the scale of all lengths."""

from dataclasses import replace

import numpy as np
import pytest

from results_fixtures import TRAVEL_MM
from truepath.estimation.solve.known_scale import settle_scale
from truepath.files.bundle.run import KnownLength
from truepath.files.environment.refraction import Refraction
from truepath.kinematics.estimated_model import find_stretch
from truepath.results.analysis import analyse
from truepath.results.error_tables import build_error_tables
from truepath.results.findings import state_findings
from truepath.results.result_json import result_json
from truepath.results.verdict import judge_scale

LONG_MM = 2300.0
WRONG = 60e-6  # as by a pressure in another unit
UNCORRECTED = Refraction("nobody", why="no light")


def bar(off, sigma_mm=0.0005, direction=(0.0, 1.0, 0.0)):
    """Return a scale bar as a tracker measures it whose ranges are too long."""
    middle_mm = np.array([2500.0, 300.0, -200.0])
    half_mm = 0.5 * (1.0 + off) * LONG_MM * np.array(direction)
    ends = tuple(tuple(middle_mm + sign * half_mm) for sign in (-1, 1))
    return KnownLength(ends, (1.0 + off) * LONG_MM, LONG_MM, sigma_mm)


@pytest.fixture(scope="module")
def recorded(record):
    return record(1, rows=24, travel_mm=TRAVEL_MM)[0]


@pytest.fixture(scope="module")
def as_it_is(recorded):
    return analyse(recorded)


def stretched(run, off):
    longer = replace(run.tracker, position_mm=(1.0 + off) * run.tracker.position_mm)
    return replace(run, tracker=longer)


def find_table(found, symbol):
    return next(table for table in found.tables.tables if table.symbol == symbol)


def list_kinds(found):
    return {reason.kind: reason.state for reason in found.verdict.reasons}


def test_a_known_length_takes_the_scale_of_the_air_out_of_all_lengths(
    recorded, as_it_is
):
    wrong = stretched(recorded, WRONG)
    told = analyse(replace(wrong, known_lengths=(bar(WRONG),)))
    assert list_kinds(told)["scale-known"] == "usable"
    for symbol in ("EXX", "EYY", "EZZ"):
        settled, true = find_table(told, symbol), find_table(as_it_is, symbol)
        off_um = np.abs(settled.value - true.value)
        assert (off_um <= 2.0 * np.hypot(settled.uncertainty, true.uncertainty)).all()
    content = result_json(told)["provenance"]
    assert content["known_lengths"]["count"] == 1
    assert content["known_lengths"]["off_ppm"] == pytest.approx(60.0, abs=3.0)


def test_uncorrected_ranges_with_a_known_length_state_what_the_length_is_known_to(
    recorded, as_it_is
):
    open_air = replace(recorded, refraction=UNCORRECTED)
    told = analyse(replace(open_air, known_lengths=(bar(0.0),)))
    assert analyse(open_air).length_scale_ppm > 250.0
    assert told.length_scale_ppm < 6.0
    far_um = [find_table(one, "EXX").uncertainty.max() for one in (told, as_it_is)]
    assert far_um[0] < far_um[1] + 1e-3 * 6.0 * TRAVEL_MM
    left_mm = [one.contributions.sigma_mm for one in (told, as_it_is)]
    assert left_mm[0] < 2.0 * left_mm[1]
    budget = told.budget.variance_mm2.sum()
    assert np.sqrt(budget) == pytest.approx(left_mm[0], rel=1e-3)


@pytest.mark.parametrize(
    ("off", "kinds"),
    [
        (None, {"all-axes-scaled": "doubtful"}),
        (68e-6, {"scale-known": "usable"}),
        (0.0, {"scale-known": "usable", "machine-scaled": "usable"}),
        (-68e-6, {"scale-known": "usable", "machine-scaled": "doubtful"}),
    ],
)
def test_axes_that_are_all_long_are_so_by_the_air_or_by_the_machine(
    estimate, provenance, off, kinds
):
    long = replace(estimate, theta=68e-6 * find_stretch(estimate.model))
    lengths = () if off is None else (bar(off),)
    runs = tuple(replace(one, known_lengths=lengths) for one in provenance.runs)
    found = state_findings(long, replace(provenance, runs=runs))
    said = judge_scale(found.estimate, found.known_scale).reasons
    assert {one.kind: one.state for one in said} == kinds


@pytest.mark.parametrize("sigma_mm", [0.001, 0.01])
def test_what_is_left_of_scale_and_machine_is_as_uncertain_as_stated(
    construct, sigma_mm
):
    estimate = construct()
    stretch, scale = find_stretch(estimate.model), 10e-6
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(estimate.covariance)
    off, wrong = [], []
    for _ in range(300):
        s = scale * rng.standard_normal()
        known = bar(s + sigma_mm / LONG_MM * rng.standard_normal(), sigma_mm)
        drawn = estimate.theta + root @ rng.standard_normal(len(root)) + s * stretch
        settled, left, told = settle_scale(
            replace(estimate, theta=drawn), scale, [[known]]
        )
        wrong.append((settled.theta - estimate.theta) @ stretch)
        off.append(not told.is_expected)
    stated = float(stretch @ settled.covariance @ stretch) ** 0.5
    assert np.std(wrong) < 1.1 * stated
    assert left < scale
    assert np.mean(off) < 0.01


def test_a_known_length_says_nothing_of_the_air_of_another_run(estimate, provenance):
    (run,) = (replace(one, refraction=UNCORRECTED) for one in provenance.runs)
    told = replace(run, known_lengths=(bar(0.0),))
    both, one, none = (
        state_findings(estimate, replace(provenance, runs=runs)).length_scale_ppm
        for runs in ((told, told), (told, run), (run, run))
    )
    assert both < 10.0
    assert one == pytest.approx(none, rel=1e-3)


def test_many_rows_of_one_bar_are_no_better_than_the_bar(construct):
    estimate = construct()
    rows = [bar(0.0, 0.01, d) for d in np.eye(3).tolist() * 5]
    _, left, told = settle_scale(estimate, 270e-6, [rows])
    assert told.lengths == 15
    assert left > 0.9 * 0.01 / LONG_MM


def test_without_a_known_length_the_scale_is_what_air_and_tracker_leave(construct):
    estimate = construct()
    settled, left, told = settle_scale(estimate, 5e-6, [[]])
    assert (left, told) == (5e-6, None)
    wider = build_error_tables(estimate.widen_by_scale(5e-6), estimate.measured)
    own = build_error_tables(settled, estimate.measured)
    for one, other in zip(own.tables, wider.tables, strict=True):
        np.testing.assert_allclose(one.uncertainty, other.uncertainty)


def test_short_lengths_beside_long_ones_say_no_more_than_the_long_ones(construct):
    estimate = construct()
    long = bar(0.0, 0.001)
    ends = tuple(tuple(0.8 * np.array(end)) for end in long.ends_mm)
    short = replace(
        long, ends_mm=ends, measured_mm=0.2 * LONG_MM, length_mm=0.2 * LONG_MM
    )
    _, _, alone = settle_scale(estimate, 270e-6, [[long] * 5])
    _, _, both = settle_scale(estimate, 270e-6, [[long] * 5 + [short] * 5])
    assert both.sigma > 0.99 * 0.001 / LONG_MM
    assert both.sigma == pytest.approx(alone.sigma, rel=0.1)


def test_what_one_run_had_wrong_may_be_in_the_lengths_of_a_joint_result(
    estimate, provenance
):
    (run,) = provenance.runs
    told = replace(run, refraction=UNCORRECTED, known_lengths=(bar(200e-6),))
    both = replace(provenance, runs=(told, run))
    assert state_findings(estimate, both).length_scale_ppm > 200.0
