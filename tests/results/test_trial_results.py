"""Every table and the map, held against trials; in the result file and the report."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.answers.calibration.analysis_files import render_analysis
from truepath.answers.calibration.measurement_sections import describe_trials
from truepath.answers.shown.templating import render_part
from truepath.files.bundle.bundle import read_bundle
from truepath.numerics.adaptive_trials import TrialPlan
from truepath.results.analysis import analyse
from truepath.results.error_tables import build_error_tables
from truepath.results.trial_results import MAP, run_trials, trials_json

PLAN = TrialPlan(seed=5, most_blocks=2)


@pytest.fixture(scope="module")
def run(small_run):
    return read_bundle(small_run)


@pytest.fixture(scope="module")
def estimated(run):
    return estimate(align(run), keep_fit=True)


@pytest.fixture(scope="module")
def held(estimated):
    return run_trials(estimated, PLAN)


def report_of(held):
    return render_part("calibration/trials.html", {"trials": describe_trials(held)})


def named(held, name):
    return next(q for q in held.quantities if q.name == name)


def test_every_table_and_squareness_is_held_where_it_is_stated(estimated, held):
    stated = build_error_tables(estimated)
    for table in stated.tables:
        quantity = named(held, table.symbol)
        np.testing.assert_array_equal(quantity.position[:, 0], table.position_mm)
        np.testing.assert_allclose(quantity.value, table.value, atol=1e-9)
        np.testing.assert_allclose(quantity.linear, table.uncertainty, atol=1e-6)
    for lean in stated.squareness:
        quantity = named(held, lean.symbol)
        assert quantity.value[0] == pytest.approx(lean.value)
        assert quantity.linear[0] == pytest.approx(lean.uncertainty)
    assert named(held, MAP).position.shape == (27, 3)
    assert named(held, MAP).value.shape == (81,)


def test_the_trials_agree_with_the_linear_law_in_tables_and_map(held):
    assert held.trials == 20_000
    assert held.disagreement < 0.05
    assert held.agreeing > 0.85 * held.numbers
    for quantity in held.quantities:
        width = (quantity.high - quantity.low)[quantity.linear > 1e-3]
        linear = quantity.linear[quantity.linear > 1e-3]
        assert width / (2 * 1.96 * linear) == pytest.approx(1.0, abs=0.08)


def test_trials_of_too_small_a_law_do_not_agree_and_the_report_names_what(estimated):
    small = replace(estimated, covariance=0.25 * estimated.covariance)
    held = run_trials(small, PLAN)
    held = replace(held, settled=True)
    assert not held.agrees
    text = report_of(held)
    assert "not all of" in text
    assert "EXX" in text


def test_trials_that_did_not_settle_validate_nothing(held):
    undecided = replace(held, settled=False)
    assert not undecided.agrees
    assert "not decided" in report_of(undecided)


def test_the_file_states_trials_beside_the_linear_law(held):
    stated = json.loads(json.dumps(trials_json(held), allow_nan=False))
    assert (stated["seed"], stated["trials"]) == (5, 20_000)
    table = stated["error_tables"]["EXX"]
    lengths = {len(v) for v in table.values()}
    assert lengths == {len(table["position_mm"])}
    low, high = np.array(table["interval_95_low_um"]), table["interval_95_high_um"]
    assert (low <= np.array(table["value_um"]) + 1e-9).all()
    assert (np.array(high) >= np.array(table["value_um"]) - 1e-9).all()
    assert stated["squareness_urad"]["C0Y"]["agrees"] is True
    assert len(stated["volumetric_error"]["uncertainty_um"]) == 81


def test_an_analysis_carries_the_trials_into_file_and_report(run):
    stages: list[tuple[float, str]] = []
    asked = {"monte_carlo": PLAN, "on_progress": lambda *report: stages.append(report)}
    analysis = render_analysis(analyse(run, **asked))
    assert analysis.result["monte_carlo"]["trials"] == 20_000
    assert "Uncertainty held against trials" in analysis.report_html
    shares = [share for share, _ in stages]
    assert shares == sorted(shares)
    order = list(dict.fromkeys(stage for _, stage in stages))
    assert order == ["aligning", "estimating", "validating", "reporting"]


def test_an_analysis_without_trials_says_nothing_of_them(run):
    analysis = render_analysis(analyse(run))
    assert analysis.result["monte_carlo"] is None
    assert "held against trials" not in analysis.report_html


def test_an_estimate_without_its_fit_has_no_trials(estimated):
    with pytest.raises(ValueError, match="has not kept its fit"):
        run_trials(replace(estimated, fit=None), PLAN)
