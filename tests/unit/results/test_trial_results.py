"""Every table and the map, held against trials; in the result file and the report."""

import json
from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate
from truepath.alignment.align import align
from truepath.answers.calibration_report import describe_trials, render_analysis
from truepath.answers.shown.page import render_part
from truepath.files.bundle.bundle import read_bundle
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.results.analysis import analyse
from truepath.results.error_tables import build_error_tables
from truepath.results.monte_carlo_results import MAP, run_trials, trials_json

PLAN = TrialPlan(seed=5, most_blocks=1)


@pytest.fixture(scope="module")
def run(small_run):
    return read_bundle(small_run)


@pytest.fixture(scope="module")
def estimated(run):
    return estimate(align(run))


@pytest.fixture(scope="module")
def held(estimated):
    return run_trials(estimated, PLAN)


def test_every_table_and_squareness_is_held_where_stated_and_agrees(estimated, held):
    by_name = {q.name: q for q in held.quantities}
    stated = build_error_tables(estimated)
    for table in stated.tables:
        quantity = by_name[table.symbol]
        np.testing.assert_array_equal(quantity.position[:, 0], table.position_mm)
        np.testing.assert_allclose(quantity.value, table.value, atol=1e-9)
        np.testing.assert_allclose(quantity.linear, table.uncertainty, atol=1e-6)
    for lean in stated.squareness:
        quantity = by_name[lean.symbol]
        assert quantity.value[0] == pytest.approx(lean.value)
        assert quantity.linear[0] == pytest.approx(lean.uncertainty)
    assert by_name[MAP].position.shape == (27, 3)
    assert by_name[MAP].value.shape == (81,)
    assert held.trials == 10_000
    assert held.disagreement < 0.05
    assert held.agreeing > 0.85 * held.numbers
    for quantity in held.quantities:
        width = (quantity.high - quantity.low)[quantity.linear > 1e-3]
        linear = quantity.linear[quantity.linear > 1e-3]
        assert width / (2 * 1.96 * linear) == pytest.approx(1.0, abs=0.08)


def test_trials_that_disagree_or_did_not_settle_validate_nothing(estimated, held):
    small = replace(estimated, covariance=0.25 * estimated.covariance)
    other = replace(run_trials(small, PLAN), settled=True)
    undecided = replace(held, settled=False)
    for one, words in ((other, ("not all of", "EXX")), (undecided, ("not decided",))):
        assert not one.agrees
        text = render_part("calibration/trials.html", {"trials": describe_trials(one)})
        assert all(word in text for word in words)
    with pytest.raises(ValueError, match="has not kept its fit"):
        run_trials(replace(estimated, fit=None), PLAN)


def test_the_file_states_trials_beside_the_linear_law(held):
    stated = json.loads(json.dumps(trials_json(held), allow_nan=False))
    assert (stated["seed"], stated["trials"]) == (5, 10_000)
    table = stated["error_tables"]["EXX"]
    lengths = {len(v) for v in table.values()}
    assert lengths == {len(table["position_mm"])}
    low, high = np.array(table["interval_95_low_um"]), table["interval_95_high_um"]
    assert (low <= np.array(table["value_um"]) + 1e-9).all()
    assert (np.array(high) >= np.array(table["value_um"]) - 1e-9).all()
    assert stated["squareness_urad"]["C0Y"]["agrees"] is True
    assert len(stated["volumetric_error"]["uncertainty_um"]) == 81


def test_an_analysis_carries_trials_into_file_and_report_or_is_silent(run, found):
    stages = []
    asked = {"monte_carlo": PLAN, "on_progress": lambda *report: stages.append(report)}
    analysis = render_analysis(analyse(run, **asked))
    assert analysis.result["monte_carlo"]["trials"] == 10_000
    assert "Uncertainty held against trials" in analysis.report_html
    shares = [share for share, _ in stages]
    assert shares == sorted(shares)
    order = list(dict.fromkeys(stage for _, stage in stages))
    assert order == ["aligning", "estimating", "validating", "reporting"]
    analysis = render_analysis(found)
    assert analysis.result["monte_carlo"] is None
    assert "held against trials" not in analysis.report_html
