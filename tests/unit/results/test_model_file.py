"""What was found becomes part of the machine's model, and of what is made from it."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.discovery import build_next_model, build_reference
from truepath.discovery.discover import discover
from truepath.errors import BundleError
from truepath.estimation.problem.prior_model import PriorModel
from truepath.files.earlier.result_file import result_from_json
from truepath.kinematics.model import CatalogueEffect
from truepath.results.prediction import predict
from truepath_simulators.hidden.structure import ElasticSag
from truepath_simulators.worlds.synthetic import Setting

SAG = ElasticSag("X", "Y", "Z", 14.0)


@pytest.fixture(scope="module")
def sagging(record):
    return record(7, rows=40, travel_mm=200.0, setting=Setting(hidden=(SAG,)))


@pytest.fixture(scope="module")
def grown(sagging):
    return build_next_model(discover([sagging[0]]), None)


@pytest.fixture(scope="module")
def content(grown):
    # As it comes back from disk.
    return json.loads(json.dumps(grown.content, allow_nan=False))


@pytest.fixture(scope="module")
def loaded(content):
    return result_from_json(content, file="model.json")


def test_the_model_states_version_parent_difference_effect_and_evidence(content):
    assert content["schema"] == "extended-model/1"
    assert content["version"] == 2
    assert content["parent"]["version"] == 1
    first = content["difference"][0]
    assert first["kind"] == "added"
    assert first["text"].startswith("elastic-sag X Y Z: amplitude 1")
    assert first["text"].endswith("µm")
    (effect,) = content["effects"]
    assert effect["part_of"] == "machine"
    assert effect["evidence"]["log_bayes_factor"] > 4.0
    (value,), (variance,) = effect["linear"]["values"], effect["linear"]["covariance"]
    said = effect["parameters"]["amplitude_um"]
    assert value == pytest.approx(said["value"])
    assert variance[0] == pytest.approx(said["uncertainty"] ** 2)
    assert abs(said["value"] - SAG.amplitude_um) < 3.0 * said["uncertainty"]


def test_the_file_comes_back_as_the_model_that_was_written(grown, loaded):
    model = grown.extended
    names = [e.name for e in loaded.model.effects]
    assert names == [e.name for e in model.model.effects]
    (sag,) = (e for e in loaded.model.effects if isinstance(e, CatalogueEffect))
    part = loaded.model.slices[sag.name]
    assert loaded.theta[part] == pytest.approx(model.theta[part], rel=1e-12)
    scale = np.sqrt(np.diag(model.covariance))
    apart = (loaded.covariance - model.covariance) / np.outer(scale, scale)
    assert np.abs(apart).max() < 1e-6
    assert loaded.version == 2


def test_prediction_from_the_model_has_the_sag(sagging, loaded, volume, rigid_free):
    run, truth = sagging
    at = volume(run.machine)
    low, high = np.array([(a.low, a.high) for a in run.machine.linear_axes[:2]]).T
    u, v = ((at[:, :2] - low) / (high - low)).T
    sag_mm = np.outer(-4.0 * u * (1.0 - u) * v, [0.0, 0.0, 1e-3 * SAG.amplitude_um])
    true_um = 1e3 * rigid_free(at, truth.deviation_mm(at) + sag_mm)
    told = predict(loaded, at)
    left = true_um - rigid_free(at, told.error_um)
    assert np.std(left) < 0.2 * np.std(true_um)
    assert np.mean(np.abs(left) < 3.0 * told.uncertainty_um + 0.5) > 0.9
    # The parameters of the sag come last.
    rigid = np.append(loaded.theta[:-1], 0.0)
    without = predict(replace(loaded, theta=rigid), at)
    assert np.std(true_um - rigid_free(at, without.error_um)) > 2.0 * np.std(left)


def test_nothing_is_missing_then_and_the_next_knows_its_parent(sagging, loaded):
    given = build_reference(PriorModel(loaded, "model.json", "0"), sagging[0])
    again = discover([sagging[0]], given)
    assert again.findings == ()
    assert again.gap.before_um < 1.05 * again.gap.noise_floor_um
    content = build_next_model(again, PriorModel(loaded, "a.json", "digest")).content
    assert content["version"] == 3
    assert content["parent"] == {"version": 2, "source": "a.json", "sha256": "digest"}
    assert not [c for c in content["difference"] if c["kind"] != "changed"]
    kept = [e["effect"] for e in content["model"]["effects"]]
    assert kept.count("catalogued") == 1


@pytest.mark.long
def test_a_model_that_lost_a_squareness_gets_it_back(sagging, loaded):
    run, _ = sagging
    square = loaded.model.slices["B0Z"]
    theta = loaded.theta.copy()
    theta[square] -= 60e-6
    bent = replace(loaded, theta=theta)
    found = discover([run], build_reference(PriorModel(bent, "model.json", "0"), run))
    (first, *_) = found.findings
    assert first.candidate.label == "squareness B0Z"
    said = first.parameters["value_urad"]
    assert abs(said.value - 60.0) < 3.0 * said.uncertainty + 3.0
    grown = build_next_model(found, None).extended
    back = grown.theta[grown.model.slices["B0Z"]]
    assert back == pytest.approx(loaded.theta[square], abs=10e-6)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"axis": "Q"}, "does not fit this machine"),
        ({"name": "no-such-effect"}, "no effects called"),
        ({"name": "table-drift"}, "belongs to the Run"),
        ({"values": [1.0, 2.0]}, "are 2, the effect has 1"),
        ({"direction": "W"}, "does not fit this machine"),
    ],
)
def test_an_effect_that_cannot_be_is_refused_with_its_place(content, change, problem):
    spoilt = copy.deepcopy(content)
    spoilt["model"]["effects"][-1].update(change)
    with pytest.raises(BundleError, match=problem) as refused:
        result_from_json(spoilt, file="model.json")
    assert "model.json: model.effects[" in str(refused.value)


def test_a_model_of_another_machine_is_refused(record, loaded):
    other, _ = record(3, rows=12, chain="w-X-b-Y-Z-t")
    with pytest.raises(BundleError, match=r"machine.kinematic_chain: w-b-X-Y-Z-t"):
        build_reference(PriorModel(loaded, "model.json", "0"), other)
