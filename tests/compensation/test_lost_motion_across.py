"""Lost motion across or about an axis stays in what files leave: no table has it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.export import export_result
from truepath.compensation.installed import list_formats
from truepath.compensation.tables.error_map import map_errors
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import (
    MODEL_SCHEMA,
    CalibrationResult,
    result_from_json,
)
from truepath.kinematics.effects.backlash import LateralBacklashFamily
from truepath.kinematics.model import restore_effect

FORMATS = list(list_formats())
HALF_UM, AT_MM = 6.0, np.array([-200.0, 300.0])


@pytest.fixture(scope="module")
def source(loaded):
    return map_errors(loaded)


def lose_across(loaded, symbol, half, sigma=0.0) -> CalibrationResult:
    return replace(
        loaded,
        half_across={symbol: (AT_MM, np.full(2, half))},
        half_across_u={symbol: np.full(2, sigma)},
    )


def export(result, name):
    return export_result(map_errors(result), name, "comp", spacing_mm=60.0)


@pytest.mark.parametrize("name", FORMATS)
def test_a_straightness_that_depends_on_direction_stays(loaded, source, name):
    without = export_result(source, name, "comp", spacing_mm=60.0)
    lost = export(lose_across(loaded, "EYX", HALF_UM), name)
    assert lost.files == without.files  # no table has it
    stated = lost.account["volumetric_error_um"]["after"]
    assert stated["mean"] >= 5.9
    squares = [one.account["left_um"]["map"] ** 2 for one in (lost, without)]
    assert squares[0] - squares[1] == pytest.approx(HALF_UM**2, rel=1e-6)
    assert any(
        words in lost.account["not_carried"]
        for words in ("lost motion across", "what depends on direction", "straightness")
    )


def test_an_angle_that_depends_on_direction_acts_by_its_arm(loaded):
    """EAX turns about X what is beyond the axis: Y and Z, with the tool's offset."""
    errors = map_errors(lose_across(loaded, "EAX", 20.0))
    at = np.array([[0.0, 100.0, 200.0]])
    half_mm = 0.5 * (errors.error_mm(at, 1.0) - errors.error_mm(at, -1.0))
    arm_mm = np.array([0.0, 100.0 + 30.0, 200.0 - 150.0])
    expected_mm = np.cross([20e-6, 0.0, 0.0], arm_mm)
    assert half_mm[0] == pytest.approx(expected_mm, abs=1e-12)


def test_its_uncertainty_is_in_what_is_stated(loaded):
    sure, doubtful = (
        export(lose_across(loaded, "EYX", HALF_UM, sigma), "csv").account
        for sigma in (0.0, 0.5)
    )
    before, after = (one["volumetric_error_um"]["after"] for one in (sure, doubtful))
    added = after["mean_uncertainty"] ** 2 - before["mean_uncertainty"] ** 2
    assert np.sqrt(added) == pytest.approx(0.5, rel=0.2)


def test_a_model_states_it_as_an_effect_that_no_table_has(loaded):
    """Of a model file that has the effect alone, and no table of it."""
    keys, numbers = {"axis": "X", "motion": "EYX"}, {"turnover_mm": 0.02}
    effect = restore_effect(LateralBacklashFamily(), loaded.machine, keys, numbers)
    size = len(loaded.theta) + 1
    covariance = np.zeros((size, size))
    covariance[:-1, :-1] = loaded.covariance
    result = replace(
        loaded,
        model=loaded.model.with_effects(effect),
        theta=np.append(loaded.theta, 1e-3 * HALF_UM),
        covariance=covariance,
    )
    account = export(result, "csv").account
    (stated,) = account["effects"]
    assert stated["rms_um"]["before"] == pytest.approx(HALF_UM, rel=1e-6)
    assert stated["rms_um"]["after"] == pytest.approx(HALF_UM, rel=1e-6)
    assert stated["note"] == ""
    assert account["volumetric_error_um"]["after"]["mean"] >= 5.9


def test_a_file_is_read_with_all_that_it_states(loaded):
    at = {"position_mm": [0.0, 100.0]}
    halves = {
        "EXX": at | {"value_um": [1.0, 2.0], "uncertainty_um": [0.1, 0.1]},
        "EYX": at | {"value_um": [6.0, 6.0], "uncertainty_um": [0.2, 0.3]},
        "EAZ": at | {"value_urad": [20.0, 21.0], "uncertainty_urad": [1.0, 1.0]},
        "ECC": {"position_deg": [0.0, 90.0], "value_urad": [12.0, 13.0]},
    }
    content = {
        "schema": MODEL_SCHEMA,
        "version": 1.0,
        "machine": machine_to_json(loaded.machine),
        "mode": "otf",
        "direction": {"model": "constant", "half_difference": halves},
        "observability": {"unobservable": []},
        "provenance": {},
        "model": model_to_json(loaded),
    }
    result = result_from_json(json.loads(json.dumps(content)))
    assert set(result.half_difference_um) == {"X"}
    assert {s: v.tolist() for s, (_, v) in result.half_across.items()} == {
        "EYX": [6.0, 6.0],
        "EAZ": [20.0, 21.0],
    }
    assert result.half_across_u["EYX"].tolist() == [0.2, 0.3]
    assert [one.tolist() for one in result.half_turn_urad["C"]] == [
        [0.0, 90.0],
        [12.0, 13.0],
    ]
    assert result.half_turn_u_urad == {}
