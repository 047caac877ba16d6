"""What a file leaves is stated as it is, at any temperature; all unmeasured is said."""

import csv
import json
import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.stats import qmc

from known_machines import along, find_ends, tabulate
from temperature_world import DEGC, World
from truepath.answers.temperature import study_temperature
from truepath.answers.temperature_report import temperature_json
from truepath.compensation.export import export_files, export_result, write_output
from truepath.compensation.format_registry import list_formats, load_format
from truepath.compensation.residual_error import (
    compute_residual_error,
    remove_rigid_motion,
)
from truepath.compensation.tables.error_map import (
    Unmeasured,
    compute_measured_ranges,
    map_errors,
)
from truepath.compensation.tables.reference_temperature import (
    find_measured_degc,
    warn_of_lengths,
)
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.earlier.model_file import model_to_json
from truepath.files.earlier.result_file import (
    MODEL_SCHEMA,
    CalibrationResult,
    HalfDifference,
    result_from_json,
)
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects import elastic_sag, speed_error
from truepath.kinematics.effects.backlash import BacklashFamily, LateralBacklashFamily
from truepath.kinematics.effects.position_wave import ScrewCyclicFamily
from truepath.kinematics.machine.symbols import is_positioning
from truepath.kinematics.model import EstimatedModel, MachineModel, restore_effect
from truepath.results.error_tables import compute_half_differences
from truepath_simulators.machine_file import load_machine

FORMATS = ("isg-csv", "linuxcnc")
HALF_UM, AT_MM = 6.0, np.array([-200.0, 300.0])
DEMO = machine_from_json(load_machine("demo"), file="machine.json")
SAG = {"axis": "X", "by": "Y", "direction": "Z"}
EFFECTS = (
    (BacklashFamily(), {"axis": "X"}, {}, [-0.006]),
    (ScrewCyclicFamily(), {"axis": "Y"}, {"lead_mm": 60.0}, [0.004, 0.003, 0.0, 0.0]),
    (elastic_sag.ElasticSagFamily(), SAG, {}, [0.02]),
    (speed_error.ServoMismatchFamily(), {"axis": "Z"}, {}, [1e-4]),
)


@pytest.fixture(scope="module")
def source(loaded):
    return map_errors(loaded)


@pytest.fixture(scope="module")
def half_measured(source):
    measured = {"X": (-200.0, 50.0), "Y": (10.0, 400.0), "Z": (0.0, 310.0)}
    return replace(source, result=replace(source.result, measured=measured))


def read_back(errors, name, unmeasured=Unmeasured.HOLD):
    measured = compute_measured_ranges(
        errors.machine, errors.result.measured, unmeasured
    )
    made = replace(tabulate(errors, name, 10.0), measured=measured)
    return made.read_back(errors)


@pytest.mark.parametrize("name", FORMATS)
def test_the_truth_lies_within_what_is_stated_to_be_left(source, name):
    export = export_result(source, name, "comp")
    stated = export.account["volumetric_error_um"]["after"]
    correction = load_format(name).read(export.files, source.machine)
    rng = np.random.default_rng(77)
    low, high = find_ends(source)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
    place = np.vstack([rng.uniform(low, high, (900, 3)), corners])
    jacobian = source.volumetric_map.jacobian(make_standstill(source.machine, place))
    sigma = np.sqrt(np.diag(source.result.covariance))
    held = 0
    for _ in range(40):
        theta = source.result.theta + sigma * rng.standard_normal(len(sigma))
        left = jacobian @ theta + correction(place, 1.0)
        left -= left.mean(axis=0)
        mean_um = 1e3 * np.linalg.norm(left, axis=1).mean()
        spread = 2.0 * stated["mean_uncertainty"] + 0.08 * stated["mean"]
        held += abs(mean_um - stated["mean"]) < spread
    assert held >= 36


def test_the_mean_is_that_of_the_travel_and_not_of_the_positions_it_is_taken_at(source):
    correction = read_back(source, "linuxcnc")
    low, high = find_ends(source)
    unit = qmc.Sobol(3, rng=np.random.default_rng(41)).random(16384)
    place = low + unit * (high - low)
    error = source.error_mm(place, 1.0)
    measured = compute_measured_ranges(source.machine, {}, Unmeasured.HOLD)
    for done in (None, correction):
        stated = compute_residual_error(source, measured, done)
        left = error if done is None else error + done(place, 1.0)
        of_travel = np.linalg.norm(remove_rigid_motion(place, left), axis=1).mean()
        off_um = stated.summarise_map()["mean"] - 1e3 * of_travel
        assert abs(off_um) < 0.2 * stated.summarise()["mean_uncertainty"]


def test_what_is_left_comes_by_its_reasons(source):
    def left_um(name, spacing_mm=5.0):
        account = export_result(source, name, "c", spacing_mm=spacing_mm).account
        return account["left_um"]

    whole, wide = left_um("isg-csv"), left_um("isg-csv", 90.0)
    assert wide["between_rows"] > 20.0 * whole["between_rows"]
    assert wide["map"] > 3.0 * whole["map"]
    pitch, lec = left_um("fanuc"), left_um("siemens-lec")
    # Whole micrometres of three axes, each even over one: 3 / 12.
    assert pitch["rounding"] == pytest.approx(0.5)
    assert lec["rounding"] < 0.001
    # Straightness and angles are most of it: neither carries them, the volume's does.
    for one in (pitch, lec):
        assert one["not_carried"] > 0.9 * one["map"] > 10.0 * whole["map"]
    assert whole["not_carried"] < 0.1
    unknown = {one["not_known_by_the_measurement"] for one in (whole, wide, pitch, lec)}
    assert len(unknown) == 1


@pytest.mark.parametrize("name", FORMATS)
def test_beyond_the_measured_range_values_hold_or_fade(half_measured, source, name):
    faded = read_back(half_measured, name, unmeasured=Unmeasured.FADE)
    held, free = read_back(half_measured, name), read_back(source, name)
    at = along(half_measured, "X", np.array([50.0, 175.0, 300.0]))
    whole, part = held(at, 1.0)[:, 0], faded(at, 1.0)[:, 0]
    if name == "linuxcnc":  # the volume's other axes add nothing in X
        assert part == pytest.approx(whole * [1.0, 0.5, 0.0], abs=2e-6)
        assert np.ptp(held(at, 1.0), axis=0) == pytest.approx(0.0, abs=1e-6)
        assert np.ptp(free(at, 1.0), axis=0).max() > 1e-3
    assert part[0] == pytest.approx(whole[0], abs=1e-6)
    assert abs(part[2] - whole[2]) > 1e-3


def test_a_result_without_range_or_direction_says_so_in_account_and_file(source):
    result = replace(source.result, measured={}, states_direction=False)
    silent = replace(source, result=result)
    export = export_result(silent, "siemens-lec", "c")
    said = export.account["unmeasured"]
    assert [text.partition(":")[0] for text in said] == ["X", "Y", "Z"]
    assert all("does not state where it was measured" in text for text in said)
    assert f"; {said[0]}\n" in export.files["c.ini"]
    assert "valid over X what the result does not state" in export.files["c.ini"]
    assert export.account["unobservable"][-1].startswith("lost motion: the result")
    with pytest.raises(BadInput, match="X: the result does not state where"):
        export_result(silent, "siemens-lec", "c", unmeasured=Unmeasured.REFUSE)


@pytest.mark.parametrize("choice", [Unmeasured.HOLD, Unmeasured.FADE])
def test_unmeasured_ranges_are_said_or_the_file_is_refused(half_measured, choice):
    export = export_result(half_measured, "isg-csv", "c", unmeasured=choice)
    (said,) = export.account["unmeasured"]
    assert said.startswith("X not measured from 50 to 300 mm")
    (text,) = export.files.values()
    assert f"// {said}" in text.splitlines()
    assert export.account["tables"]["X"]["measured_to_mm"] == 50.0
    left = export.account["volumetric_error_um"]
    assert left["after_where_measured"]["mean"] < 0.5 * left["after"]["mean"]
    assert export.account["left_um"]["unmeasured_range"] > 1.0
    with pytest.raises(BadInput, match="X not measured from 50 to 300 mm"):
        export_result(half_measured, "isg-csv", "c", unmeasured=Unmeasured.REFUSE)


def test_what_nobody_measured_is_no_part_of_what_is_left_where_it_was_measured(source):
    middle = {"X": (-100.0, 200.0), "Y": (80.0, 330.0), "Z": (60.0, 250.0)}
    whole = {axis.name: (axis.low, axis.high) for axis in source.axes}
    results = (replace(source.result, measured=one) for one in (middle, whole))
    sources = (replace(source, result=result) for result in results)
    part, every = (export_result(x, "siemens", "c").account for x in sources)
    left = part["volumetric_error_um"]
    after = every["volumetric_error_um"]["after"]
    assert left["after"]["mean"] > 4.0 * left["after_where_measured"]["mean"]
    assert left["after_where_measured"]["mean"] < 1.2 * after["mean"]
    assert every["unmeasured"] == []  # of a result that was measured everywhere
    assert every["left_um"]["unmeasured_range"] == 0.0


def test_the_zero_is_where_the_axis_comes_to_it_in_plus_direction(loaded):
    errors = map_errors(lose_across(loaded, "EXX", 4.0))
    correction = read_back(errors, "linuxcnc")
    zero = along(errors, "X", np.array([0.0]))
    assert correction(zero, 1.0)[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert correction(zero, -1.0)[0, 0] == pytest.approx(0.008, abs=1e-6)


def test_no_file_is_written_without_its_account(tmp_path):
    source = tmp_path / "result.json"
    source.write_text("{}")
    account = {"volumetric_error_um": float("nan")}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_output({"c.csv": "1\n"}, account, tmp_path / "c.csv", "c", source=source)
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_lengths_are_of_the_scales_if_sensed_and_steel_is_off_by_kelvins():
    air = {"air": [18.0, 25.0], "spindle": [30.0, 31.0]}
    assert find_measured_degc({"temperature_degC": air}) == (18.0, 31.0)
    scales = {"X": [22.0, 22.5], "Y": [21.5, 22.0]}
    assert find_measured_degc({"temperature_degC": air | scales}) == (21.5, 22.5)
    assert find_measured_degc({}) is None
    for ends in ((20.0, 20.0), (19.0, 21.0), (20.4, 20.9)):
        assert warn_of_lengths(ends) is None
    assert "+4.0 K off 20 °C" in warn_of_lengths((21.0, 24.0))
    assert "46 µm/m" in warn_of_lengths((21.0, 24.0))
    assert "-2.0 K off" in warn_of_lengths((18.0, 20.0))
    assert "not known" in warn_of_lengths(None)


def test_account_and_comments_say_it_and_no_number_changes(loaded):
    provenance = {"temperature_degC": {"X": [23.0, 23.4]}}
    results = (replace(loaded, provenance=one) for one in (provenance, {}))
    exports = [export_result(map_errors(result), "csv", "c") for result in results]
    for export in exports:
        said = f"# {export.account['lengths']['text']}"
        assert said in export.files["c.csv"].splitlines()
    warm, unknown = (export.account for export in exports)
    lengths = warm["lengths"]
    assert lengths["measured_degC"] == [23.0, 23.4]
    assert "23.0 to 23.4 degC, not normalised to 20 degC" in lengths["text"]
    assert "+3.4 K" in lengths["warning"]
    assert "unknown temperature" in unknown["lengths"]["text"]
    assert warm["volumetric_error_um"] == unknown["volumetric_error_um"]


def lose_across(loaded, symbol, half, sigma=0.0) -> CalibrationResult:
    across = HalfDifference(AT_MM, np.full(2, half), np.full(2, sigma))
    own = {s: one for s, one in loaded.halves.items() if is_positioning(s)}
    return replace(loaded, halves=own | {symbol: across})


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
def test_straightness_that_depends_on_direction_is_stated_to_stay(loaded, source, name):
    without = export_result(source, name, "comp", spacing_mm=60.0).account
    lost = export(lose_across(loaded, "EYX", HALF_UM), name).account
    assert lost["volumetric_error_um"]["after"]["mean"] >= 5.9
    squares = [one["left_um"]["map"] ** 2 for one in (lost, without)]
    assert squares[0] - squares[1] == pytest.approx(HALF_UM**2, rel=1e-6)


def test_an_angle_that_depends_on_direction_acts_by_its_arm_and_has_u(loaded):
    errors = map_errors(lose_across(loaded, "EAX", 20.0))
    at = np.array([[0.0, 100.0, 200.0]])
    half_mm = 0.5 * (errors.error_mm(at, 1.0) - errors.error_mm(at, -1.0))
    arm_mm = np.array([0.0, 100.0 + 30.0, 200.0 - 150.0])
    expected_mm = np.cross([20e-6, 0.0, 0.0], arm_mm)
    assert half_mm[0] == pytest.approx(expected_mm, abs=1e-12)
    lost = (lose_across(loaded, "EYX", HALF_UM, sigma) for sigma in (0.0, 0.5))
    accounts = (export(one, "csv").account for one in lost)
    before, after = (one["volumetric_error_um"]["after"] for one in accounts)
    added = after["mean_uncertainty"] ** 2 - before["mean_uncertainty"] ** 2
    assert np.sqrt(added) == pytest.approx(0.5, rel=0.2)


def test_a_model_states_it_as_an_effect_that_no_table_has(loaded):
    keys, numbers = {"axis": "X", "motion": "EYX"}, {"turnover_mm": 0.02}
    effect = restore_effect(LateralBacklashFamily(), loaded.machine, keys, numbers)
    theta = np.append(loaded.theta, 1e-3 * HALF_UM)
    covariance = np.pad(loaded.covariance, (0, 1))
    result = CalibrationResult(loaded.model.with_effects(effect), theta, covariance)
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
    content = {"schema": MODEL_SCHEMA, "version": 1.0, "mode": "otf", "provenance": {}}
    content |= {"direction": {"model": "constant", "half_difference": halves}}
    content |= {"observability": {"unobservable": []}, "model": model_to_json(loaded)}
    content |= {"machine": machine_to_json(loaded.machine)}
    result = result_from_json(json.loads(json.dumps(content)))
    assert list(result.halves) == ["EXX", "ECC", "EYX", "EAZ"]
    across = {s: result.halves[s].value.tolist() for s in ("EYX", "EAZ")}
    assert across == {"EYX": [6.0, 6.0], "EAZ": [20.0, 21.0]}
    assert result.halves["EYX"].sigma.tolist() == [0.2, 0.3]
    turn = result.halves["ECC"]
    assert (turn.position.tolist(), turn.value.tolist()) == ([0.0, 90.0], [12.0, 13.0])
    assert turn.sigma is None


def have_effects(*described):
    effects = (restore_effect(f, DEMO, keys, n) for f, keys, n, _ in described)
    model = MachineModel(DEMO, tuple(effects))
    theta = np.concatenate([values for *_, values in described])
    covariance = 1e-12 * np.eye(len(theta))
    lost = compute_half_differences(EstimatedModel(model, theta, covariance))
    half = {
        f"E{one.symbol[2]}{one.symbol[2]}": HalfDifference(one.position_mm, one.value)
        for one in lost
    }
    result = CalibrationResult(model, theta, covariance, halves=half)
    return partial(export_result, map_errors(result), stem="comp")


@pytest.fixture(scope="module")
def catalogued():
    return cache(have_effects(*EFFECTS))


def find_left(account):
    effects = account["effects"]
    return {e["name"]: (e["rms_um"]["before"], e["rms_um"]["after"]) for e in effects}


def test_what_tables_of_one_or_both_directions_leave_is_stated(catalogued):
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


def test_two_cross_tables_or_blocks_of_two_axes_carry_the_sag_of_a_guide(catalogued):
    before, after = find_left(catalogued("siemens-cec").account)["elastic-sag"]
    assert after < 0.02 * before
    with pytest.raises(BadInput, match="choose another format"):
        have_effects(EFFECTS[2])("etalon-exchange")
    assert "sag" in load_format("etalon-exchange").not_carried
    export = catalogued("isg-csv")
    (text,) = export.files.values()
    assert "Y  X  EXX  EYX  EZX" in text
    found = find_left(export.account)
    assert found["elastic-sag"][1] < 0.01 * found["elastic-sag"][0]
    assert found["backlash"][1] == pytest.approx(found["backlash"][0], rel=1e-6)
    tables = [block for block in text.split("#") if "Y  X" in block]
    assert len(tables) == 1
    assert len(tables[0].splitlines()) <= 1010


GROWS_UM_PER_M_K = 11.0


@pytest.fixture(scope="module")
def study(loaded):
    world = World(loaded, 1e-6).grow(GROWS_UM_PER_M_K)
    times = 3600.0 * np.arange(len(DEGC))
    return study_temperature(world.draw(1, sigma_k=0.0, times=times))


@pytest.fixture
def model_file(study, tmp_path):
    file = tmp_path / "temperature.json"
    file.write_text(json.dumps(temperature_json(study)), encoding="utf-8")
    return file


def read_gradient(text, celsius):
    rows = re.findall(r"^; +([\d.]+) degC +SD43910 = (\S+)$", text, re.M)
    at, gradient = np.array(rows, float).T
    return float(np.interp(celsius, at, gradient))


def test_siemens_gets_growth_as_a_compensation_of_its_own(study, model_file, tmp_path):
    out = tmp_path / "out.ini"
    export_files(model_file, "siemens", out, at_temperature_degc=20.0)
    text = (tmp_path / "out-temperature.ini").read_text(encoding="ascii")
    assert "$MA_TEMP_COMP_TYPE[AX1]=2" in text
    assert "$SA_TEMP_COMP_REF_POSITION[AX1]=0.000000" in text
    assert "Y: no growth is seen" in text
    gradient = read_gradient(text, 23.5)
    assert gradient == pytest.approx(1e-6 * GROWS_UM_PER_M_K * 3.5, rel=1e-3)
    assert read_gradient(text, 20.0) == pytest.approx(0.0, abs=1e-12)


def test_tables_of_the_temperature_leave_less_than_those_of_another(study):
    truth = map_errors(study.model.at(23.5))
    ranges = compute_measured_ranges(truth.machine, {}, Unmeasured.HOLD)

    def correct(errors):
        return lambda at, side: -errors.error_mm(at, side)

    files = (map_errors(study.model.at(celsius)) for celsius in (20.0, 23.5))
    usual, own = (compute_residual_error(truth, ranges, correct(x)) for x in files)
    assert own.rms_um < 0.1 * usual.rms_um


def test_plain_tables_have_the_change_of_each_row(model_file, tmp_path):
    texts = {}
    for celsius in (20.0, 24.0):
        file = tmp_path / f"at{celsius:g}.csv"
        export_files(model_file, "csv", file, at_temperature_degc=celsius)
        lines = file.read_text(encoding="ascii").splitlines()
        said = f"# lengths at the machine's own temperature, {celsius:.1f} degC, not"
        assert any(line.startswith(said) for line in lines)
        texts[celsius] = [*csv.DictReader(x for x in lines if not x.startswith("#"))]
    pairs = list(zip(texts[20.0], texts[24.0], strict=True))
    assert len(pairs) > 100
    for cold, warm in pairs:
        expected = float(cold["x_um"]) + 4.0 * float(cold["x_um_per_K"])
        assert float(warm["x_um"]) == pytest.approx(expected, abs=1e-3)


def test_a_temperature_is_asked_for_and_formats_without_it_say_so(model_file, tmp_path):
    order = model_file, "fanuc", tmp_path / "f"
    for celsius, words in ((None, "state which by"), (27.0, "is beyond the 18")):
        with pytest.raises(BadInput, match=words):
            export_files(*order, at_temperature_degc=celsius)
    account = export_files(*order, at_temperature_degc=22.0)
    assert account["temperature"]["at_degC"] == 22.0
    assert account["temperature"]["carried"].startswith("nothing")
