"""`result.json` and its tables: complete, exact, and refused where they are not."""

import csv
import io
import json
from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from results_fixtures import THREE_TARGETS, as_loaded, change_run
from truepath.answers.verification.positioning_figures import (
    HalfDifference,
    compute_positioning_figures,
)
from truepath.errors import BundleError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.model_file import model_to_json, pack_symmetric
from truepath.files.earlier.result_file import result_from_json
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.kinematics.effects import base, pose_timing_seats
from truepath.kinematics.machine.symbols import is_straightness, is_turn
from truepath.kinematics.model import EstimatedModel
from truepath.results.error_tables import (
    build_error_tables,
    choose_table_positions,
    error_tables_csv,
)
from truepath.results.prediction import predict
from truepath.results.result_json import result_json
from truepath.results.result_summary import state_findings

# Of result/1, beside the schema.
KEYS = (
    *("machine", "mode", "error_tables", "squareness_urad"),
    *("alignment", "residuals", "observability", "provenance"),
)
NOTHING = object()
FIRST = ("model", "effects", 0)


@pytest.fixture
def content(found):
    return json.loads(json.dumps(result_json(found), allow_nan=False))


def test_every_key_of_the_contract_is_there_and_names_its_unit(content, estimate):
    assert content["schema"] == "result/1"
    assert set(content) >= {*KEYS, "verdict"}
    assert content["mode"] == "otf"
    assert content["residuals"]["rms_um"] > 0.0
    assert set(content["observability"]) >= {"rank", "parameters", "unobservable"}
    assert content["provenance"]["input_sha256"] == "0" * 64
    assert content["provenance"]["software_version"] == "9.9"
    assert content["provenance"]["created"] == "2026-03-07T08:30:00+00:00"
    for symbol, table in content["error_tables"].items():
        unit = "um" if symbol[1] in "XYZ" else "urad"
        keys = {"position_mm", f"value_{unit}", f"uncertainty_{unit}"}
        assert set(table) == {*keys, "extrapolated"}
        assert len({len(column) for column in table.values()}) == 1
    for square in content["squareness_urad"].values():
        assert set(square) == {"value", "uncertainty"}
    assert machine_from_json(content["machine"]) == estimate.model.machine
    named = {text.split()[0] for text in content["observability"]["unobservable"]}
    assert named
    assert named.isdisjoint(content["error_tables"])  # what is not known has no table
    target = {"name": "", "on": "tool", "offset_mm": [20.0, 30.0, -150.0]}
    assert content["holds_for"] == {"any_tool": False, "targets": [target]}


def test_a_file_of_old_or_of_another_hand_is_read_as_it_was_stated(found, content):
    values = {"lines": "4, 9"}
    stated = Verdict((Reason("lines-without-data", "doubtful", values),))
    written = result_json(replace(found, verdict=stated))
    assert result_from_json(json.loads(json.dumps(written))).verdict == stated
    content["verdict"] = {"state": "not-usable", "reasons": ["The door was open."]}
    loaded = result_from_json(content)
    assert loaded.verdict.objection == "not to be used: The door was open."
    content["verdict"]["details"] = [{"why": "door"}]
    assert result_from_json(content).verdict == loaded.verdict
    assert loaded.states_direction
    for key in ("verdict", "left_out", "setup_steps", "runs", "direction"):
        del content[key]
    del content["model"]["confounded"]
    for target in content["machine"].get("targets", []):
        target.pop("seat_sigma_mm", None)
    loaded = result_from_json(content)
    assert loaded.verdict == Verdict()
    assert loaded.model.confounded == frozenset()
    assert not loaded.states_direction
    middle = np.array([[0.5 * (a.low + a.high) for a in loaded.machine.axes]])
    assert np.isfinite(predict(loaded, middle).uncertainty_um).all()


def test_rows_without_data_and_unknown_noise_say_so(estimate, provenance, across_only):
    left = estimate.runs[0].measured_rows - {4}
    thinned = change_run(estimate, measured_rows=left)
    alignment = result_json(state_findings(thinned, provenance))["alignment"]
    assert alignment["rows_without_data"] == [4]
    assert (alignment["matched_lines"], alignment["lines"]) == (11, 12)
    run = replace(provenance.runs[0], mode="standstill", feed_mm_min=None)
    found = state_findings(estimate, replace(provenance, runs=(run,)))
    content = result_json(found)
    assert content["mode"] == "standstill"
    assert content["alignment"]["rows_without_data"] == [0]
    assert content["provenance"]["feed_mm_min"] is None
    content = result_json(state_findings(across_only, provenance))
    assert content["noise"]["along_travel_um"] is None
    assert content["provenance"]["options"] == {"perpendicular_only": True}
    json.dumps(content, allow_nan=False)


def test_residuals_along_the_lines_are_those_of_the_rows_and_add_up(content, estimate):
    (run,) = content["runs"]
    lines, rows = run["residuals"]["along_lines"], content["residuals"]["by_line"]
    position_mm = estimate.runs[0].residuals.position_mm
    for line, of_row in zip(lines, rows, strict=True):
        parts = [line[f"{name}_um"] for name in ("beam", "azimuth", "elevation")]
        assert line["row"] == of_row["row"]
        assert line["along_mm"][0] == 0.0
        assert len(line["along_mm"]) == of_row["cells"]
        rms_um = np.sqrt(np.mean(np.square(parts)))
        assert rms_um == pytest.approx(of_row["rms_um"], abs=1e-2)
    second_mm = np.linalg.norm(position_mm[1] - position_mm[0])
    assert lines[0]["along_mm"][1] == pytest.approx(second_mm, abs=0.01)
    square = sum(r["cells"] * r["rms_um"] ** 2 for r in rows)
    whole = np.sqrt(square / sum(r["cells"] for r in rows))
    assert whole == pytest.approx(content["residuals"]["rms_um"])


def test_the_file_predicts_what_the_estimate_does(construct, provenance, travel_points):
    found = state_findings(construct(THREE_TARGETS), provenance)
    read = result_from_json(json.loads(json.dumps(result_json(found))))
    expected = predict(as_loaded(found.estimate), travel_points)
    got = predict(read, travel_points)
    assert got.error_um == pytest.approx(expected.error_um, abs=1e-9)
    assert got.uncertainty_um == pytest.approx(expected.uncertainty_um, rel=1e-9)


def test_parameters_and_tables_come_back_whatever_the_gauge(found, estimate, content):
    read = result_from_json(content)
    assert read.mode == "otf"
    assert read.unobservable == estimate.observability.unobservable
    assert read.provenance["run"] == "monday"
    tables = build_error_tables(read).tables
    for before, after in zip(found.tables.tables, tables, strict=True):
        assert after.symbol == before.symbol
        assert after.value == pytest.approx(before.value, abs=1e-9)
        assert after.uncertainty == pytest.approx(before.uncertainty, abs=1e-9)
    assert read.theta == pytest.approx(estimate.theta, abs=1e-15)
    covariance = found.estimate.covariance
    scale = np.sqrt(np.outer(*2 * [np.diag(covariance)]))
    assert read.covariance / scale == pytest.approx(covariance / scale, abs=1e-9)


def with_value(value, *path):
    def spoil(content):
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value
        if value is NOTHING:
            del content[path[-1]]

    return spoil


without = partial(with_value, NOTHING)


def repeated(content):
    effects = content["model"]["effects"]
    effects.append(deepcopy(effects[0]))


def with_negative_variance(content):
    size = content["model"]["covariance"]["size"]
    content["model"]["covariance"]["data"] = pack_symmetric(-np.eye(size))


def measured(low, high):
    return with_value({"from_mm": low, "to_mm": high}, "measured_range", "X")


def lost(position_mm, uncertainty_um):
    half = {"position_mm": position_mm, "value_um": [1.0, 2.0]}
    half |= {"uncertainty_um": uncertainty_um}
    return with_value(half, "direction", "half_difference", "EXX")


BAD = [
    (with_value("result/9", "schema"), "schema is not that of a result"),
    (without("schema"), "schema is missing"),
    *((without(key), f"{key} is missing") for key in KEYS),
    (without("model"), "model is missing, without which nothing can be predicted"),
    (with_value("flying", "mode"), 'mode is "flying"'),
    (with_value(3, "provenance"), "provenance is 3"),
    (with_value("x", "observability", "unobservable"), 'unobservable is "x"'),
    (with_value("fine", "verdict", "state"), 'verdict.state is "fine"'),
    (without("machine", "axes", "X", "max_mm"), "machine.axes.X.max_mm is missing"),
    (with_value("model/7", "model", "schema"), 'model.schema is "model/7"'),
    (with_value("magic", *FIRST, "effect"), 'effects[0].effect is "magic"'),
    (with_value("EXQ", *FIRST, "symbol"), 'effects[0].symbol is "EXQ"'),
    (with_value([0.0, 1.0], *FIRST, "knots_mm"), "knots_mm are 2"),
    (with_value([3.0, 2.0, 1.0], *FIRST, "knots_mm"), "not increasing"),
    (with_value([0.0, 1.0, 2.0], *FIRST, "knots_mm"), "for 3 knots"),
    (with_value([0.0, None], *FIRST, "values_um"), "values_um[1] is null"),
    (with_value(float("nan"), "model", "effects", -1, "value_urad"), "value_urad is"),
    (with_value("C9Q", "model", "effects", -1, "symbol"), 'symbol is "C9Q"'),
    (repeated, "repeats EXX"),
    (with_value(7, "model", "covariance", "size"), "covariance.size is 7"),
    (with_value("hex", "model", "covariance", "encoding"), 'encoding is "hex"'),
    (with_value("AAAA", "model", "covariance", "data"), "cannot be unpacked"),
    (with_negative_variance, "negative variance"),
    (measured(200.0, 100.0), "measured_range.X.to_mm is 100, below from_mm 200"),
    (measured(5e3, 6e3), "measured_range.X is 5000 to 6000 mm, beyond the travel"),
    (lost([50.0, 0.0], [0.1, 0.1]), "position_mm do not ascend"),
    (lost([0.0, 50.0], [0.1]), "uncertainty_um are 1 for 2 in position_mm"),
]


@pytest.mark.parametrize(("spoil", "said"), BAD)
def test_a_bad_result_is_one_clear_error(content, spoil, said):
    spoil(content)
    with pytest.raises(BundleError) as caught:
        result_from_json(content, file="r.json")
    assert str(caught.value).startswith("r.json: ")
    assert said in str(caught.value)


def test_what_is_no_object_is_no_result():
    with pytest.raises(BundleError, match="write an object"):
        result_from_json([1, 2])


def test_what_belongs_to_the_measurement_is_integrated_out_and_no_more(estimate):
    model = estimate.model.with_effects(pose_timing_seats.TrackerPose((0.0, 0.0, 0.0)))
    covariance = np.pad(estimate.covariance, (0, 6))
    covariance[:, -6:] = covariance[-6:, :] = 0.5
    theta = np.append(estimate.theta, np.ones(6))
    stated = model_to_json(EstimatedModel(model, theta, covariance))
    assert stated == model_to_json(estimate)

    class Unknown(pose_timing_seats.TrackerPose):
        @property
        def role(self):
            return base.Role.MACHINE

    model = estimate.model.with_effects(Unknown((0.0, 0.0, 0.0)))
    with pytest.raises(TypeError, match="tracker-pose has no form"):
        model_to_json(EstimatedModel(model, np.zeros(model.size), np.eye(model.size)))


@pytest.fixture(scope="module")
def tables(estimate):
    return build_error_tables(estimate)


def test_straightness_is_zero_at_both_ends_all_else_at_zero_or_the_lowest(tables):
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


def test_values_are_those_of_the_parameters_in_um_and_urad(estimate, tables):
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
    model = estimate.model.with_effects(pose_timing_seats.TrackerPose((0.0, 0.0, 0.0)))
    theta = np.append(estimate.theta, np.ones(6))
    covariance = np.pad(estimate.covariance, (0, 6))
    more = build_error_tables(EstimatedModel(model, theta, covariance))
    assert [t.symbol for t in more.tables] == [t.symbol for t in tables.tables]
    assert len(more.squareness) == 3


def test_uncertainty_is_the_spread_of_tables_the_covariance_allows(estimate, tables):
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


def test_what_merges_has_no_table_until_three_targets_tell(estimate, tables, construct):
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
