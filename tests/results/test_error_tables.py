"""Tables in the gauge of the file formats, with the uncertainty of the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.kinematics.machine.symbols import is_straightness, is_turn
from truepath.results.error_tables import build_error_tables, choose_table_positions


@pytest.fixture
def tables(estimate):
    return build_error_tables(estimate)


def test_straightness_is_zero_at_both_ends_of_the_travel(tables):
    straight = [t for t in tables.tables if is_straightness(t.symbol)]
    assert len(straight) == 6
    for table in straight:
        assert table.value[[0, -1]] == pytest.approx(0.0, abs=1e-9)
        assert table.uncertainty[[0, -1]] == pytest.approx(0.0, abs=1e-9)
        assert np.abs(table.value).max() > 1.0


def test_positioning_and_turns_are_zero_at_the_axis_zero_else_at_the_lowest(tables):
    zero = {"X": 0.0, "Y": 10.0, "Z": 0.0}
    others = [t for t in tables.tables if not is_straightness(t.symbol)]
    assert {t.symbol for t in others} >= {"EXX", "EYY", "EZZ", "EAX", "EBX", "ECX"}
    for table in others:
        at_zero = np.isclose(table.position_mm, zero[table.symbol[2]])
        assert at_zero.sum() == 1
        assert table.value[at_zero] == pytest.approx(0.0, abs=1e-9)
        assert table.uncertainty[at_zero] == pytest.approx(0.0, abs=1e-9)


def test_positions_are_equidistant_and_hold_both_ends(tables):
    for table in tables.tables:
        step = np.diff(table.position_mm)
        assert step == pytest.approx(step[0])
        assert 20.0 < step[0] < 30.0
    x = tables.table("EXX").position_mm
    assert (x[0], x[-1], len(x)) == (-200.0, 300.0, 21)


def test_a_short_axis_still_has_five_positions(estimate):
    axis = estimate.model.machine.linear_axes[0]
    short = type(axis)("X", 0.0, 8.0)
    assert choose_table_positions(short).tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]


def test_values_are_those_of_the_spline_in_micrometres_and_microradians(
    estimate, tables
):
    for motion in estimate.model.effects[:-3]:
        table = tables.table(motion.name)
        theta = estimate.theta[estimate.model.slices[motion.name]]
        scale = 1e6 if is_turn(motion.name) else 1e3
        assert table.unit == ("urad" if is_turn(motion.name) else "um")
        assert table.value == pytest.approx(
            scale * motion.rows(table.position_mm) @ theta
        )


def test_uncertainty_is_the_spread_of_tables_drawn_from_the_covariance(
    estimate, tables, rng
):
    """A way to the numbers that shares nothing with the propagation."""
    drawn = rng.multivariate_normal(
        estimate.theta, estimate.covariance, 1500, method="eigh"
    )
    of_draws = [build_error_tables(replace(estimate, theta=t)) for t in drawn]
    for k, table in enumerate(tables.tables):
        spread = np.std([d.tables[k].value for d in of_draws], axis=0)
        assert table.uncertainty == pytest.approx(spread, rel=0.09, abs=1e-9)
    for k, square in enumerate(tables.squareness):
        spread = np.std([d.squareness[k].value for d in of_draws])
        assert square.uncertainty == pytest.approx(spread, rel=0.09)


def test_squarenesses_are_the_angles_of_the_parameters(estimate, tables):
    assert [s.symbol for s in tables.squareness] == ["C0Y", "B0Z", "A0Z"]
    for square in tables.squareness:
        angle = estimate.theta[estimate.model.slices[square.symbol]][0]
        assert square.value == pytest.approx(1e6 * angle)


def test_what_merges_has_no_table_and_is_named_instead(estimate, tables):
    known = {t.symbol for t in tables.tables}
    assert len(known) == 14
    assert tables.table("ECZ") is None
    assert not tables.any_tool
    named = {s.split()[0] for s in estimate.observability.unobservable}
    assert known.isdisjoint(named)
    assert len(known | named) == 18


def test_three_targets_off_one_line_give_tables_for_any_tool(construct, three_targets):
    estimate = construct(three_targets)
    tables = build_error_tables(estimate)
    assert len(tables.tables) == 18
    assert tables.any_tool
    assert tables.targets == three_targets


def test_an_effect_that_is_no_error_motion_has_no_table(estimate, tables):
    model = estimate.model.with_effects(TrackerPose((0.0, 0.0, 0.0)))
    theta = np.append(estimate.theta, np.ones(6))
    covariance = np.pad(estimate.covariance, (0, 6))
    more = build_error_tables(EstimatedModel(model, theta, covariance))
    assert [t.symbol for t in more.tables] == [t.symbol for t in tables.tables]
    assert len(more.squareness) == 3
