"""What files of a temperature model have of temperature, and what that leaves."""

import csv
import json
import re

import numpy as np
import pytest

from temperature_world import DEGC, World
from truepath.answers.temperature.temperature_json import temperature_json
from truepath.answers.temperature.temperature_model import study_temperature
from truepath.compensation.account.residual_error import compute_residual_error
from truepath.compensation.export import export_files
from truepath.compensation.tables import error_map, unmeasured_range
from truepath.errors import BadInput

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
    truth = error_map.map_errors(study.model.at(23.5))
    ranges = unmeasured_range.compute_measured_ranges(
        truth.machine, {}, unmeasured_range.Unmeasured.HOLD
    )

    def correct(errors):
        return lambda at, side: -errors.error_mm(at, side)

    files = (error_map.map_errors(study.model.at(celsius)) for celsius in (20.0, 23.5))
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
