"""`result.json`: complete, exact, and refused where it is not."""

import json
from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from results_fixtures import THREE_TARGETS, as_loaded, change_run
from truepath.errors import BundleError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.covariance_file import pack_symmetric
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import result_from_json
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.results.error_tables import build_error_tables
from truepath.results.prediction import predict
from truepath.results.result_json import result_json
from truepath.results.result_summary import state_findings

# Of result/1, beside the schema.
KEYS = (
    *("machine", "mode", "error_tables", "squareness_urad"),
    *("alignment", "residuals", "observability", "provenance"),
)


@pytest.fixture
def content(found):
    """The result as it comes back from a file."""
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


def test_rows_that_left_no_data_are_named_points_count_from_the_first_no_noise_is_null(
    estimate, provenance, across_only
):
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
    # Without data along the travel their noise is not known.
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


def test_the_file_predicts_what_the_estimate_of_three_targets_predicts(
    construct, provenance, travel_points
):
    found = state_findings(construct(THREE_TARGETS), provenance)
    read = result_from_json(json.loads(json.dumps(result_json(found))))
    expected = predict(as_loaded(found.estimate), travel_points)
    got = predict(read, travel_points)
    assert got.error_um == pytest.approx(expected.error_um, abs=1e-9)
    assert got.uncertainty_um == pytest.approx(expected.uncertainty_um, rel=1e-9)


def test_parameters_and_tables_come_back_whatever_basis_the_gauge_had(
    found, estimate, content
):
    """The file holds values at knots; a gauge brings its own basis when it is read."""
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


NOTHING = object()
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


FIRST = ("model", "effects", 0)
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


def test_what_belongs_to_the_measurement_is_integrated_out_and_nothing_else_dropped(
    estimate,
):
    model = estimate.model.with_effects(TrackerPose((0.0, 0.0, 0.0)))
    covariance = np.pad(estimate.covariance, (0, 6))
    covariance[:, -6:] = covariance[-6:, :] = 0.5
    theta = np.append(estimate.theta, np.ones(6))
    stated = model_to_json(EstimatedModel(model, theta, covariance))
    assert stated == model_to_json(estimate)

    class Unknown(TrackerPose):
        @property
        def role(self):
            return Role.MACHINE

    model = estimate.model.with_effects(Unknown((0.0, 0.0, 0.0)))
    with pytest.raises(TypeError, match="tracker-pose has no form"):
        model_to_json(EstimatedModel(model, np.zeros(model.size), np.eye(model.size)))
