"""What no sensor can show is neither used nor passed over in silence, in any file."""

import json
import math

import numpy as np
import pytest

from api_builders import edited
from truepath.errors import BundleError
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.run import summarize_run

pytestmark = pytest.mark.fault_row(43)
HENE = {"wavelength_nm": 633, "is_group": False, "assumed_index": 1.0}
WORDS = "environment.csv", "row 2", "pressure_hPa", "746", "120 m", "mmHg"


@pytest.fixture
def surround(bundle):
    """Write `environment.csv` from functions of 0 to 1; return the bundle."""

    def write(machine=None, **columns):
        stream = read_bundle(bundle).tracker.device_time_s
        share = np.linspace(0.0, 1.0, 61)
        time_s = stream[0] + share * (stream[-1] - stream[0])
        shown = [[one(s) for s in share] for one in columns.values()]
        table, header = np.column_stack([time_s, *shown]), ",".join(["t_s", *columns])
        file = bundle / "environment.csv"
        np.savetxt(file, table, "%.17g", ",", header=header, comments="")
        with edited(bundle / "machine.json") as content:
            content |= machine or {}
        return bundle

    return write


def noisy(level, sigma=0.02, seed=0):
    draws = np.random.default_rng(seed)
    return lambda _: level + draws.normal(0.0, sigma)


def broken(good, bad):
    return lambda share: good(share) if share < 0.5 else bad(share)


@pytest.mark.long
@pytest.mark.timeout(240)
def test_a_result_that_had_to_do_without_a_sensor_says_so(surround, tmp_path, command):
    dies = broken(noisy(20.0), lambda _: -2.4e-41)
    place = surround(X_degC=dies, Y_degC=noisy(20.0), Z_degC=noisy(20.3))
    verdict = command.json("analyse", place, "-o", tmp_path / "out")["verdict"]
    assert verdict["state"] == "doubtful"
    assert any("X_degC: 31 of 61 readings" in why for why in verdict["reasons"])
    (one,) = json.loads((tmp_path / "out" / "result.json").read_text())["runs"]
    used = {s["name"]: s["used"] for s in one["environment"]["sensors"]}
    assert used == {"X_degC": False, "Y_degC": True, "Z_degC": True}
    # What is handed on says it once more.
    write_bundle(read_bundle(place), tmp_path / "again")
    told = summarize_run(read_bundle(tmp_path / "again")).sensors_told
    assert any("X_degC: 31 of 61 readings" in why for why in told)


def draw_swapped(level):
    draws = np.random.default_rng(3)

    def show(_):
        high, low = np.array([level + draws.normal(0.0, 0.02)], ">f4").view(">u2")
        return np.array([low, high], ">u2").view(">f4")[0]

    return lambda share: v if math.isfinite(v := show(share)) else 1e30


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("X_degC", draw_swapped(20.0)),
        ("X_degC", lambda _: 0.0),
        ("X_degC", lambda _: -5.0),
        ("X_degC", lambda share: -0.1 if share < 0.6 else 0.0),
        ("air_degC", lambda _: 55.0),
        ("pressure_hPa", lambda _: 590.0),
        ("humidity_percent", lambda _: 101.5),
    ],
)
def test_nothing_of_a_sensor_that_has_failed_is_used_at_once(surround, name, bad):
    level = {"pressure_hPa": 1000.0, "humidity_percent": 45.0}.get(name, 20.0)
    columns = {name: broken(noisy(level), bad), "spindle_degC": noisy(21.0)}
    read = read_bundle(surround(**columns))
    (shown,) = (one for one in summarize_run(read).sensors if one.name == name)
    assert abs(shown.low - level) < 1.0
    assert abs(shown.high - level) < 1.0 or name == "X_degC"
    told = summarize_run(read).sensors_told
    assert any(text.startswith(f"{name}: ") for text in told)


def test_what_was_wrong_from_the_start_or_all_others_contradict_is_not_used(surround):
    """Words in the wrong order; another reads the register of the humidity, say."""
    usual = {n: noisy(20.0, seed=i) for i, n in enumerate(("Y_degC", "Z_degC"))}
    wrong = {"X_degC": noisy(45.0), "U_degC": draw_swapped(20.0)}
    read = read_bundle(surround(**usual, air_degC=noisy(21.0), **wrong))
    assert read.temperature.names[3:] == ("X", "U")
    assert np.isnan(read.temperature.celsius[:, 3:]).all()
    assert np.isfinite(read.temperature.celsius[:, :3]).all()


def test_what_a_cold_hall_a_coarse_sensor_and_a_warm_spindle_show_is_kept(surround):
    columns = {
        "X_degC": lambda s: round(2.0 - 4.0 * s, 1),  # through 0, in steps of 0.1
        "Y_degC": lambda s: round(1.5 - 3.0 * s, 1),
        "spindle_degC": lambda s: 2.0 + 55.0 * s,
        "air_degC": lambda s: 3.0,
        "humidity_percent": lambda s: 30.0 + 40.0 * (s > 0.5) * (s - 0.5),
    }
    read = read_bundle(surround(**columns))
    assert np.isfinite(read.temperature.celsius).all()
    assert not summarize_run(read).sensors_told


def test_units_are_taken_by_the_names_of_columns_one_for_each_sensor(surround):
    columns = {"pressure_mmHg": 756.9, "X_degF": 68.0, "humidity_percent": 45.0}
    read = read_bundle(surround(**{n: noisy(v, 1e-3) for n, v in columns.items()}))
    assert read.temperature.names == ("X",)
    assert np.allclose(read.temperature.celsius, 20.0, atol=0.01)
    assert np.allclose(read.air.pressure_hpa, 1009.1, atol=0.1)
    with pytest.raises(BundleError, match="column X_degF"):
        read_bundle(surround(X_degC=noisy(20.0), X_degF=noisy(68.0)))


@pytest.mark.parametrize(
    ("altitude_m", "words"),
    [("high", ["site.altitude_m"]), (1e5, ["site.altitude_m"]), (120, WORDS)],
)
def test_no_altitude_and_a_pressure_of_another_are_refused(surround, altitude_m, words):
    columns = {"air_degC": noisy(20.0), "pressure_hPa": noisy(746.0)}
    with pytest.raises(BundleError) as refused:
        read_bundle(surround({"site": {"altitude_m": altitude_m}}, **columns))
    assert [word for word in words if word in str(refused.value)] == [*words]


@pytest.mark.parametrize(
    ("altitude_m", "column", "value", "is_believed"),
    [
        (None, "pressure_hPa", 746.0, False),
        (None, "pressure_mmHg", 746.0, True),
        (None, "pressure_hPa", 955.0, True),
        (2500.0, "pressure_hPa", 746.0, True),
        (120.0, "pressure_mmHg", 746.0, True),
    ],
)
def test_no_range_is_corrected_by_millimetres_of_mercury(
    surround, tmp_path, altitude_m, column, value, is_believed
):
    asked = {"environment": {"refraction": {"by": "nobody", "light": HENE}}}
    if altitude_m is not None:
        asked["site"] = {"altitude_m": altitude_m}
    columns = {"air_degC": noisy(20.0), column: noisy(value)}
    read = read_bundle(surround(asked, **columns))
    assert ("pressure_hPa" in read.refraction.assumed) != is_believed
    told = summarize_run(read).sensors_told
    assert any("altitude" in text for text in told) != is_believed
    write_bundle(read, tmp_path / "again")
    machine = json.loads((tmp_path / "again" / "machine.json").read_text())
    assert machine.get("site") == asked.get("site")
