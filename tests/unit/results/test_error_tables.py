"""Tables in the gauge of the file formats, with the uncertainty of the covariance."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from results_fixtures import THREE_TARGETS
from truepath.answers.verification.places.positioning_figures import (
    HalfDifference,
    compute_positioning_figures,
)
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.kinematics.machine.symbols import is_straightness, is_turn
from truepath.results.error_table_files import error_tables_csv
from truepath.results.error_tables import build_error_tables, choose_table_positions


@pytest.fixture(scope="module")
def tables(estimate):
    return build_error_tables(estimate)


def test_straightness_is_zero_at_both_ends_all_else_at_the_axis_zero_or_the_lowest(
    tables,
):
    straight = [t for t in tables.tables if is_straightness(t.symbol)]
    assert len(straight) == 6
    for table in straight:
        assert table.value[[0, -1]] == pytest.approx(0.0, abs=1e-9)
        assert table.uncertainty[[0, -1]] == pytest.approx(0.0, abs=1e-9)
        assert np.abs(table.value).max() > 1.0
    zero = {"X": 0.0, "Y": 10.0, "Z": 0.0}
    others = [t for t in tables.tables if not is_straightness(t.symbol)]
    assert {t.symbol for t in others} >= {"EXX", "EYY", "EZZ", "EAX", "EBX", "ECX"}
    for table in others:
        at_zero = np.isclose(table.position_mm, zero[table.symbol[2]])
        assert at_zero.sum() == 1
        assert table.value[at_zero] == pytest.approx(0.0, abs=1e-9)
        assert table.uncertainty[at_zero] == pytest.approx(0.0, abs=1e-9)


def test_positions_are_equidistant_and_hold_both_ends_five_at_least(tables, estimate):
    for table in tables.tables:
        step = np.diff(table.position_mm)
        assert step == pytest.approx(step[0])
        assert 20.0 < step[0] < 30.0
    x = tables.table("EXX").position_mm
    assert (x[0], x[-1], len(x)) == (-200.0, 300.0, 21)
    axis = estimate.model.machine.linear_axes[0]
    short = type(axis)("X", 0.0, 8.0)
    assert choose_table_positions(short).tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]


def test_values_are_those_of_the_parameters_in_micrometres_and_microradians(
    estimate, tables
):
    for motion in estimate.model.effects[:-3]:
        table = tables.table(motion.name)
        theta = estimate.theta[estimate.model.slices[motion.name]]
        scale = 1e6 if is_turn(motion.name) else 1e3
        assert table.unit == ("urad" if is_turn(motion.name) else "um")
        value = scale * motion.rows(table.position_mm) @ theta
        assert table.value == pytest.approx(value)
    assert [s.symbol for s in tables.squareness] == ["C0Y", "B0Z", "A0Z"]
    for square in tables.squareness:
        angle = estimate.theta[estimate.model.slices[square.symbol]][0]
        assert square.value == pytest.approx(1e6 * angle)
    model = estimate.model.with_effects(TrackerPose((0.0, 0.0, 0.0)))
    # An effect that is no error motion has no table.
    theta = np.append(estimate.theta, np.ones(6))
    covariance = np.pad(estimate.covariance, (0, 6))
    more = build_error_tables(EstimatedModel(model, theta, covariance))
    assert [t.symbol for t in more.tables] == [t.symbol for t in tables.tables]
    assert len(more.squareness) == 3


def test_uncertainty_is_the_spread_of_tables_that_the_covariance_allows(
    estimate, tables
):
    """A way to the numbers that shares nothing with the propagation."""

    def values(theta):
        found = build_error_tables(replace(estimate, theta=theta))
        of_tables = [table.value for table in found.tables]
        return np.concatenate([*of_tables, [one.value for one in found.squareness]])

    # Tables are linear in the parameters: the columns of a root make all spreads.
    root = np.linalg.cholesky(estimate.covariance)
    middle = values(estimate.theta)
    moved = [values(estimate.theta + column) - middle for column in root.T]
    stated = [table.uncertainty for table in tables.tables]
    stated.append([square.uncertainty for square in tables.squareness])
    spread = np.linalg.norm(moved, axis=0)
    assert np.concatenate(stated) == pytest.approx(spread, rel=1e-6, abs=1e-9)


def test_what_merges_has_no_table_until_three_targets_give_tables_for_any_tool(
    estimate, tables, construct
):
    known = {t.symbol for t in tables.tables}
    assert len(known) == 14
    assert tables.table("ECZ") is None
    assert not tables.any_tool
    named = {s.split()[0] for s in estimate.observability.unobservable}
    assert known.isdisjoint(named)
    assert len(known | named) == 18
    every = build_error_tables(construct(THREE_TARGETS))
    assert len(every.tables) == 18
    assert every.any_tool
    assert every.targets == THREE_TARGETS


def test_each_row_of_the_file_has_value_uncertainty_unit_and_verdict(found):
    text = error_tables_csv(found.tables, found.verdict)
    assert "-0.00000" not in text
    rows = list(csv.DictReader(io.StringIO(text)))
    for table in found.tables.tables:
        mine = [r for r in rows if r["error"] == table.symbol]
        assert {r["unit"] for r in mine} == {table.unit}
        for column in ("position_mm", "value", "uncertainty"):
            read = np.array([float(r[column]) for r in mine])
            assert read == pytest.approx(getattr(table, column), abs=1e-4)
    squares = [r for r in rows if r["error"] in ("C0Y", "B0Z", "A0Z")]
    assert {(r["position_mm"], r["unit"]) for r in squares} == {("", "urad")}
    # Nothing is said of what is not known.
    assert {r["error"] for r in rows}.isdisjoint({"EAZ", "EBZ", "ECZ"})
    assert len(squares) == 3
    assert len(rows) == sum(len(t.value) for t in found.tables.tables) + 3
    assert {r["verdict"] for r in rows} == {"usable"}
    spoilt = Verdict((Reason("fit-beyond-noise", "not-usable", {}),))
    read = [*csv.DictReader(io.StringIO(error_tables_csv(found.tables, spoilt)))]
    assert {r["verdict"] for r in read} == {"not-usable"}
    assert len(read) == len(rows)


def test_the_figures_of_iso_230_2_are_ranges_of_the_tables(estimate, tables, rng):
    halves = {}
    for symbol in ("EXX", "EYY", "EZZ"):
        at = tables.table(symbol).position_mm
        half = rng.normal(size=len(at))
        halves[symbol] = HalfDifference(at, half, np.full(len(at), 0.1))
    found = compute_positioning_figures(estimate, halves, {})
    assert [one.symbol for one in found] == ["EXX", "EYY", "EZZ"]
    for one in found:
        mean, half = tables.table(one.symbol).value, halves[one.symbol].value
        both = np.concatenate([mean + half, mean - half])
        assert np.isclose(one.mean_range.value, np.ptp(mean))
        assert np.isclose(one.reversal.value, 2.0 * np.abs(half).max())
        assert np.isclose(one.systematic_range.value, np.ptp(both))
        assert one.mean_range.uncertainty > 0.0
    at = tables.table("EXX").position_mm
    half = HalfDifference(at, np.full(len(at), 3.0), np.full(len(at), 0.1))
    (one, *_) = compute_positioning_figures(estimate, {"EXX": half}, {})
    assert one.reversal.value == 6.0
    assert np.isclose(one.reversal.uncertainty, 0.2, rtol=0.2)
    for one in compute_positioning_figures(estimate, {}, {}):  # without directions
        assert one.reversal is None
        assert one.systematic_range == one.mean_range


def test_what_nobody_measured_is_not_in_the_figures(estimate):
    """X measured from -60 to 140 of its -200 to 300 mm, between rows of its table."""
    low, high = -60.0, 140.0
    (motion,) = (m for m in estimate.model.error_motions if m.symbol == "EXX")
    own = estimate.theta[estimate.model.slices[motion.name]]
    value_um = 1e3 * motion.rows(np.linspace(low, high, 401)) @ own
    half_at = np.array([-200.0, low, high, 300.0])
    half = HalfDifference(half_at, np.array([90.0, 3.0, 3.0, 90.0]), np.zeros(4))
    measured = {"X": (low, high)}
    (one, *others) = compute_positioning_figures(estimate, {"EXX": half}, measured)
    assert one.range == (low, high)
    assert np.isclose(one.mean_range.value, np.ptp(value_um), rtol=0.03)
    assert np.isclose(one.reversal.value, 6.0)
    assert [other.range for other in others] == [(10.0, 400.0), (0.0, 310.0)]
