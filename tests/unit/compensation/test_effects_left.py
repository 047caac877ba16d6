"""What files leave of each effect: lost motion across or about an axis stays."""

import json
import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from known_machines import tabulate
from truepath.compensation.export import export_result
from truepath.compensation.installed import list_formats
from truepath.compensation.tables.error_map import map_errors
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import (
    MODEL_SCHEMA,
    CalibrationResult,
    result_from_json,
)
from truepath.kinematics.effects.backlash import BacklashFamily, LateralBacklashFamily
from truepath.kinematics.effects.elastic_sag import ElasticSagFamily
from truepath.kinematics.effects.position_wave import ScrewCyclicFamily
from truepath.kinematics.effects.servo_mismatch import ServoMismatchFamily
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.kinematics.model import MachineModel, restore_effect
from truepath.results.error_tables import compute_half_differences
from truepath_simulators.scenario import load_machine

HALF_UM, AT_MM = 6.0, np.array([-200.0, 300.0])


@pytest.fixture(scope="module")
def source(loaded):
    return map_errors(loaded)


def lose_across(loaded, symbol, half, sigma=0.0) -> CalibrationResult:
    half_across = {symbol: (AT_MM, np.full(2, half))}
    sigmas = {symbol: np.full(2, sigma)}
    return replace(loaded, half_across=half_across, half_across_u=sigmas)


def export(result, name):
    return export_result(map_errors(result), name, "comp", spacing_mm=60.0)


@pytest.mark.parametrize("name", list_formats())
def test_no_table_has_a_straightness_that_depends_on_direction(loaded, source, name):
    lost = map_errors(lose_across(loaded, "EYX", HALF_UM))
    made = tabulate(source, name, 60.0)
    assert made.write(lost) == made.write(source)
    words = "lost motion across|what depends on direction|straightness"
    assert re.search(words, made.kind.not_carried)


@pytest.mark.parametrize("name", ["linuxcnc", "csv"])
def test_a_straightness_that_depends_on_direction_is_stated_to_stay(
    loaded, source, name
):
    without = export_result(source, name, "comp", spacing_mm=60.0).account
    lost = export(lose_across(loaded, "EYX", HALF_UM), name).account
    assert lost["volumetric_error_um"]["after"]["mean"] >= 5.9
    squares = [one["left_um"]["map"] ** 2 for one in (lost, without)]
    assert squares[0] - squares[1] == pytest.approx(HALF_UM**2, rel=1e-6)


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
    result = replace(
        loaded,
        model=loaded.model.with_effects(effect),
        theta=np.append(loaded.theta, 1e-3 * HALF_UM),
        covariance=np.pad(loaded.covariance, (0, 1)),
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
    across = {s: v.tolist() for s, (_, v) in result.half_across.items()}
    assert across == {"EYX": [6.0, 6.0], "EAZ": [20.0, 21.0]}
    assert result.half_across_u["EYX"].tolist() == [0.2, 0.3]
    at_deg, half_urad = result.half_turn_urad["C"]
    assert (at_deg.tolist(), half_urad.tolist()) == ([0.0, 90.0], [12.0, 13.0])
    assert result.half_turn_u_urad == {}


DEMO = machine_from_json(load_machine("demo"), file="machine.json")
SAG = {"axis": "X", "by": "Y", "direction": "Z"}
EFFECTS = (
    (BacklashFamily(), {"axis": "X"}, {}, [-0.006]),
    (ScrewCyclicFamily(), {"axis": "Y"}, {"lead_mm": 60.0}, [0.004, 0.003, 0.0, 0.0]),
    (ElasticSagFamily(), SAG, {}, [0.02]),
    (ServoMismatchFamily(), {"axis": "Z"}, {}, [1e-4]),
)


@pytest.fixture(scope="module")
def catalogued():
    """A machine of four effects, and how a format exports it."""
    effects = tuple(restore_effect(f, DEMO, keys, n) for f, keys, n, _ in EFFECTS)
    model = MachineModel(DEMO, effects)
    theta = np.concatenate([values for *_, values in EFFECTS])
    covariance = 1e-12 * np.eye(len(theta))
    half = {
        one.symbol[2]: (one.position_mm, one.value)
        for one in compute_half_differences(EstimatedModel(model, theta, covariance))
    }
    result = CalibrationResult(model, theta, covariance, half_difference_um=half)
    return cache(partial(export_result, map_errors(result), stem="comp"))


def find_left(account):
    """Return root mean squares before and after, by effect."""
    effects = account["effects"]
    return {e["name"]: (e["rms_um"]["before"], e["rms_um"]["after"]) for e in effects}


def test_a_table_of_the_mean_leaves_lost_motion_and_those_of_both_directions_sag(
    catalogued,
):
    account = catalogued("linuxcnc").account
    found = find_left(account)
    lost, wave, sag = (found[n] for n in ("backlash", "screw-cyclic", "elastic-sag"))
    assert lost[0] == pytest.approx(6.0, rel=1e-3)
    assert lost[1] < 0.01 * lost[0]
    assert wave[1] < 0.1 * wave[0]
    assert sag[1] == pytest.approx(sag[0], rel=1e-6)
    assert found["servo-mismatch"] == (0.0, 0.0)  # it depends on speed
    lag = next(e for e in account["effects"] if e["name"] == "servo-mismatch")
    assert "no table has it" in lag["note"]
    found = find_left(catalogued("siemens-lec").account)
    assert found["backlash"][1] == pytest.approx(found["backlash"][0], rel=1e-6)
    assert found["screw-cyclic"][1] < 0.1 * found["screw-cyclic"][0]


def test_blocks_of_two_axes_carry_the_sag_of_a_guide(catalogued):
    export = catalogued("isg-csv")
    (text,) = export.files.values()
    assert "Y  X  EXX  EYX  EZX" in text
    found = find_left(export.account)
    assert found["elastic-sag"][1] < 0.01 * found["elastic-sag"][0]
    assert found["backlash"][1] == pytest.approx(found["backlash"][0], rel=1e-6)
    tables = [block for block in text.split("#") if "Y  X" in block]
    assert len(tables) == 1
    assert len(tables[0].splitlines()) <= 1010
