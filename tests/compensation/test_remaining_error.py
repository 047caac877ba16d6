"""What a controller's files take away of each effect that a model has."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import map_errors
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.effects.backlash import BacklashFamily
from truepath.kinematics.effects.elastic_sag import ElasticSagFamily
from truepath.kinematics.effects.position_wave import ScrewCyclicFamily
from truepath.kinematics.effects.servo_mismatch import ServoMismatchFamily
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.kinematics.model import MachineModel, restore_effect
from truepath.results.error_tables import compute_half_differences
from truepath_simulators.scenario import load_machine

MACHINE = machine_from_json(load_machine("demo"), file="machine.json")
EFFECTS = (
    (BacklashFamily(), {"axis": "X"}, {}, [-0.006]),
    (ScrewCyclicFamily(), {"axis": "Y"}, {"lead_mm": 60.0}, [0.004, 0.003, 0.0, 0.0]),
    (
        ElasticSagFamily(),
        {"axis": "X", "by": "Y", "direction": "Z"},
        {},
        [0.02],
    ),
    (ServoMismatchFamily(), {"axis": "Z"}, {}, [1e-4]),
)


@pytest.fixture(scope="module")
def source():
    effects = tuple(restore_effect(f, MACHINE, keys, n) for f, keys, n, _ in EFFECTS)
    model = MachineModel(MACHINE, effects)
    theta = np.concatenate([values for *_, values in EFFECTS])
    covariance = 1e-12 * np.eye(len(theta))
    half = {
        one.symbol[2]: (one.position_mm, one.value)
        for one in compute_half_differences(EstimatedModel(model, theta, covariance))
    }
    result = CalibrationResult(model, theta, covariance, half_difference_um=half)
    return map_errors(result)


def left(source, name) -> dict[str, tuple[float, float]]:
    """Return root mean squares before and after, by effect."""
    said = export_result(source, name, "comp").account["effects"]
    return {e["name"]: (e["rms_um"]["before"], e["rms_um"]["after"]) for e in said}


def test_tables_of_both_directions_carry_lost_motion_and_waves_but_no_sag(source):
    found = left(source, "linuxcnc")
    lost, wave, sag = (found[n] for n in ("backlash", "screw-cyclic", "elastic-sag"))
    assert lost[0] == pytest.approx(6.0, rel=1e-3)
    assert lost[1] < 0.01 * lost[0]
    assert wave[1] < 0.1 * wave[0]
    assert sag[1] == pytest.approx(sag[0], rel=1e-6)


def test_blocks_of_two_axes_carry_the_sag_of_a_guide(source):
    export = export_result(source, "isg-csv", "comp")
    (text,) = export.files.values()
    assert "Y  X  EXX  EYX  EZX" in text
    found = left(source, "isg-csv")
    assert found["elastic-sag"][1] < 0.01 * found["elastic-sag"][0]
    assert found["backlash"][1] == pytest.approx(found["backlash"][0], rel=1e-6)
    tables = [block for block in text.split("#") if "Y  X" in block]
    assert len(tables) == 1
    assert len(tables[0].splitlines()) <= 1010


def test_a_table_of_the_mean_leaves_lost_motion(source):
    found = left(source, "siemens-lec")
    assert found["backlash"][1] == pytest.approx(found["backlash"][0], rel=1e-6)
    assert found["screw-cyclic"][1] < 0.1 * found["screw-cyclic"][0]


def test_what_depends_on_speed_is_said_to_be_in_no_table(source):
    said = export_result(source, "linuxcnc", "comp").account["effects"]
    lag = next(e for e in said if e["name"] == "servo-mismatch")
    assert lag["rms_um"] == {"before": 0.0, "after": 0.0}
    assert "no table has it" in lag["note"]
