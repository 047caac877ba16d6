"""Compensation files: what a controller makes of them, by rule and by other hands."""

import re
import runpy
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from pyLSV2 import NCTable

from known_machines import along, tabulate
from plugin_site import NAME, install
from truepath.compensation.conformance import CHECKS
from truepath.compensation.export import export_result, write_output
from truepath.compensation.format_registry import load_format
from truepath.compensation.formats.fanuc import Fanuc
from truepath.compensation.formats.heidenhain import Heidenhain
from truepath.compensation.tables.error_map import map_errors
from truepath.errors import BadInput
from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.kinematics.identifiable import build_identifiable_model
from written_tables import LEADSCREW

SIEMENS = ("siemens", "siemens-cec", "siemens-lec")
PLAIN = ("csv", "json")
OTHERS = ("etalon-exchange", "fanuc", "heidenhain", "isg-csv", "linuxcnc")
OURS = (*PLAIN, *OTHERS, *SIEMENS)
SETTLED = (*PLAIN, "linuxcnc", "siemens-lec")
every_format = pytest.mark.parametrize("name", OURS)


PROVENANCE = {"run": "morning", "created": "2026-11-26", "input_sha256": "f00d" * 16}
ISG = "X  EXX  EYY  EZX  EAX  EBX  ECX\n0  0  0  0  0  0  0\n100  0.01  0  0  0  0  0\n"
CSV = """axis,direction,position_mm,x_mm,y_um,z_um,a_urad,b_urad,c_urad
X,+,0,0,0,0,0,0,0
X,+,100,10,20,0,0,0,100
"""
LEC, ETALON = "siemens-lec", "etalon-exchange"
FILE = {"linuxcnc": "c-X.tbl", LEC: "x.ini", ETALON: "c.txt"}
TWO_SYSTEMS = "$AA_ENC_COMP[0,0,X1]=0.0\n$AA_ENC_COMP[1,1,X1]=0.01\n"
GRID = "[EXX]\nGridpoints = {\n0 0\nROW\n}\n"
BROKEN = """
    import math
    from truepath.compensation.formats.generic import GenericCsv

    class Broken(GenericCsv):
        def {verb}(self, *given):
            return {answer}
"""
TIMES = "lambda at, side: {} * GenericCsv.read(self, *given)(at, side)"
TEXTS = "for name, text in super().write(*given).items()"


@pytest.fixture(scope="module")
def source(loaded):
    whole = {axis.name: (axis.low, axis.high) for axis in loaded.machine.linear_axes}
    return map_errors(replace(loaded, provenance=PROVENANCE, measured=whole))


@pytest.fixture(scope="module")
def export(source):
    return cache(lambda name: export_result(source, name, "comp"))


@pytest.fixture(scope="module")
def with_backlash(source):
    """The same machine, 8 µm of lost motion in X: half of it each way."""
    axis = source.axes[0]
    half = HalfDifference(np.array([axis.low, axis.high]), np.full(2, 4.0))
    result = replace(source.result, halves={"EXX": half})
    return replace(source, result=result)


@pytest.fixture(scope="module")
def losing(source):
    def make(length_mm, middle_mm=0.0):
        low, high = middle_mm - length_mm / 2, middle_mm + length_mm / 2
        axes = tuple(replace(x, low=low, high=high) for x in source.machine.linear_axes)
        machine = replace(source.machine, axes=axes)
        offsets, spacing = np.array([machine.target().offset_mm]), length_mm / 4
        model, _ = build_identifiable_model(machine, offsets, knot_spacing_mm=spacing)
        size = np.array([4e-3 if p.unit == "mm" else 1e-5 for p in model.parameters])
        theta = size * np.random.default_rng(6).standard_normal(model.size)
        half = HalfDifference(np.array([low, high]), np.full(2, 4.0))
        halves = {f"E{axis.name}{axis.name}": half for axis in axes}
        covariance = np.diag((1e-2 * size) ** 2)
        result = CalibrationResult(model, theta, covariance)
        return map_errors(replace(result, halves=halves))

    return make


def flat(values):
    """Values without their mean: where an axis is 0 is a convention."""
    return values - values.mean(axis=0)


@every_format
def test_what_is_left_is_stated_and_less_than_before(export, source, name):
    account = export(name).account
    stated = account["volumetric_error_um"]
    assert 0.0 < stated["after"]["mean"] < stated["before"]["mean"]
    assert stated["after"]["largest"] < 1.05 * stated["before"]["largest"]
    assert account["interpolation_loss_um"] < 0.5
    assert account["sign"]["verified"] == (name in SETTLED)
    assert account["unobservable"] == list(source.result.unobservable)
    assert account["target_offset_mm"]
    held = account["holds_for"]
    assert held["offset_mm"] == list(source.machine.target().offset_mm)
    assert held["confounded"] == sorted(source.result.model.confounded)


@every_format
def test_files_are_ascii_and_say_where_they_come_from(export, source, name):
    files, account = export(name).files, export(name).account
    machine, lengths = source.machine, account["lengths"]["text"]
    assert all(text.isascii() and text.endswith("\n") for text in files.values())
    commented = name in ("isg-csv", "etalon-exchange", *SIEMENS, *PLAIN)
    for line in ("target offset", lengths):
        assert all(line in text for text in files.values()) == commented
    units = f"units {load_format(name).units}; directions of travel: "
    if commented:
        (text, *_) = files.values()
        assert f"{units}{load_format(name).directions}" in text
        assert "mm" in account["units"]
    stamp = "\n".join(account["stamp"])
    travels = (f"{axis.name} {axis.low:g} to {axis.high:g} mm" for axis in source.axes)
    whose = f"machine {machine.name}, chain {machine.chain}"
    run = "run morning, analysed 2026-11-26", "input f00df00df00df00d", "measured at "
    others = "for the tool at target offset", units, "sign (", lengths
    for said in (whose, *run, *travels, *others):
        assert said in stamp


def test_cross_tables_correct_the_whole_volume_as_far_as_there_is_room(export, source):
    left = {}
    for control in ("840d-sl", "828d"):
        choices = {"control": control, "measuring_system": "2"}
        account = export_result(source, "siemens", "c", choices=choices).account
        left[control] = account["left_um"]["map"]
        assert account["choices"].items() >= choices.items()
        assert "MD32700[1] = 0" in account["note"]
    before = export("siemens").account["volumetric_error_um"]["before"]["mean"]
    assert left["840d-sl"] < 0.01 * before
    assert left["840d-sl"] < left["828d"] < 0.6 * before


@pytest.mark.parametrize("control", ["828d", "808d"])
def test_a_small_control_gets_no_more_tables_and_points_than_it_has(source, control):
    files = tabulate(source, "siemens", 0.5, control=control).write(source)
    cross = [line for line in files["c-cec.ini"].splitlines() if "$AN_CEC[" in line]
    places = [line.partition("]")[0].partition("[")[2].split(",") for line in cross]
    assert max(int(table) for table, _ in places) == 7
    assert max(int(index) for _, index in places) == 199
    factors = [line for line in cross if line.startswith("$AN_CEC[7,")]
    assert max(abs(float(line.partition("=")[2])) for line in factors) <= 0.1


def test_formats_choices_and_errors_of_no_use_are_refused_with_what_there_is(source):
    def refused(said, name="siemens", **choices):
        with pytest.raises(BadInput, match=said):
            export_result(source, name, "c", choices=choices)

    refused("installed: csv, etalon-exchange, fanuc", "vcs")
    refused("control of siemens: '802d' is none of 840d", control="802d")
    refused("no choice of control; it has nothing", "linuxcnc", control="828d")
    refused("control of siemens: 'X=828d' is none", control="X=828d")
    refused("no axis A; it has X, Y, Z", measuring_system="A=2")
    for word in ("3", "", "X=3", "X=1,X=2", "x=1", "X=1,", "X=1;Y=2", "=1", "X=1/../2"):
        refused("1, 2", measuring_system=word)
    for name, word in product(("siemens", "siemens-lec"), ("2", "X=1,Y=2")):
        small = {"control": "808d", "measuring_system": word}
        refused("the 808D has 1 alone, not 2", name, **small)
    tiny = replace(source.result, theta=2e-3 * source.result.theta)
    with pytest.raises(BadInput, match="below what it resolves"):
        export_result(map_errors(tiny), "fanuc", "comp")


def test_only_formats_with_all_motions_correct_the_whole_volume(export):
    accounts, share = {name: export(name).account for name in OURS}, {}
    for name, one in accounts.items():
        before_um = one["volumetric_error_um"]["before"]["mean"]
        share[name] = one["left_um"]["map"] / before_um
    whole = ("isg-csv", "etalon-exchange", *PLAIN)
    alone = min(share["siemens-lec"], share["siemens-cec"])
    assert max(share[one] for one in whole) < 0.01
    assert share["isg-csv"] < share["heidenhain"] < alone
    assert share["linuxcnc"] == pytest.approx(share["siemens-lec"], rel=1e-3)
    siemens = (accounts[name]["volumetric_error_um"]["after"] for name in SIEMENS)
    both, *each = (one["mean"] for one in siemens)
    assert both < 0.8 * min(each)


@pytest.mark.parametrize("name", ["fanuc", "heidenhain", "linuxcnc", "siemens-lec"])
def test_positioning_along_the_middle_is_gone_between_rows_too(export, source, name):
    correction = load_format(name).read(export(name).files, source.machine)
    for own, travel in enumerate(source.axes):
        place = along(source, travel.name, np.linspace(travel.low, travel.high, 333))
        error = flat(source.error_mm(place))[:, own]
        left = error + flat(correction(place, 1.0))[:, own]
        assert np.abs(error).max() > 0.002
        assert np.abs(left).max() < (0.0025 if name == "fanuc" else 0.0003)
        if name in ("fanuc", "siemens-lec"):  # zero at the reference point
            zero = 0.0 if travel.low <= 0 <= travel.high else travel.low
            added = correction(along(source, travel.name, np.array([zero])), 1.0)
            assert abs(added[0, own]) < 6e-5


@pytest.mark.parametrize("name", ["linuxcnc", "heidenhain", "siemens", "csv", "json"])
def test_lost_motion_is_corrected_in_both_directions(with_backlash, name):
    correction = tabulate(with_backlash, name, 10.0).read_back(with_backlash)
    travel = with_backlash.axes[0]
    at = np.linspace(travel.low + 1, travel.high - 1, 101)
    place = along(with_backlash, "X", at)
    lost = np.array([with_backlash.error_mm(place, d)[:, 0] for d in (1.0, -1.0)])
    up, down = lost + [correction(place, d)[:, 0] for d in (1.0, -1.0)]
    np.testing.assert_allclose(up, down, atol=3e-5)
    np.testing.assert_allclose(lost[0] - lost[1], 0.008, atol=1e-9)


@every_format
def test_rows_fit_into_the_controller(source, name):
    most = {"linuxcnc": 256, "heidenhain": 256, "fanuc": 300}
    most |= {"siemens": 500, "siemens-cec": 500, "csv": 10_000, "json": 10_000}
    for table in tabulate(source, name, 0.1).tabulate(source).tables:
        assert len(table.position_mm) <= most.get(name, 1000)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        # The control ignores the first three in silence.
        ("linuxcnc", "# head\n0 0 0\n", "c-X"),
        ("linuxcnc", "0,0,0\n1,1,1\n", "c-X"),
        ("linuxcnc", "1 1 1\n0 0 0\n", "c-X"),
        (LEC, LEADSCREW.replace("[0,1,", "[0,3,"), "lacks points"),
        (LEC, LEADSCREW.replace("=0.0 ;", "=O.O ;"), "row 2"),
        (LEC, TWO_SYSTEMS, r"x\.ini, row 2: X1 .* measuring system 1"),
        (ETALON, "[EXX]\nVALUES = 1\n", "begins no block"),
        (ETALON, GRID.replace("ROW", "0 1"), "ascending"),
        (ETALON, GRID.replace("ROW", "1"), "two numbers"),
        (ETALON, "[EXC]\nVALUE = 1\n", "no axis has the parameter EXC"),
        ("isg-csv", ISG, "six motions"),
        ("csv", CSV, "the columns are to be axis, direction"),
    ],
)
def test_a_file_that_the_control_cannot_read_is_refused(source, name, text, said):
    with pytest.raises(BadInput, match=said):
        load_format(name).read({FILE.get(name, "c.csv"): text}, source.machine)


@pytest.mark.parametrize("name", ["siemens", "siemens-lec"])
@pytest.mark.parametrize(
    ("system", "index", "said", "noted"),
    [
        ("1", "000", "1: $AA_ENC_COMP[0,", "1 ($AA_ENC_COMP[0, |MD32700[0] = 0"),
        ("2", "111", "2: $AA_ENC_COMP[1,", "2 ($AA_ENC_COMP[1, |MD32700[1] = 0"),
        ("Y=2,Z=1", "010", "2 of Y, 1 of Z, 1 of others: ", "MD32700[e] = 0"),
    ],
)
def test_leadscrew_tables_are_of_the_measuring_system_of_each_axis(
    export, source, name, system, index, said, noted
):
    choices = {"measuring_system": system}
    made = tabulate(source, name, 10.0, **choices)
    files = made.write(source)
    (text,) = (t for t in files.values() if "$AA_ENC_COMP[" in t)
    assert f"; tables of measuring system {said}" in text
    found = set(re.findall(r"^\$AA_ENC_COMP\[(\d),\d+,(\w)1\]", text, re.M))
    assert found == set(zip(index, "XYZ", strict=True))
    assert f"$AA_ENC_COMP_STEP[{index[1]},Y1]=" in text
    assert all(one in made.kind.note for one in noted.split("|"))
    place = np.array(source.middle_mm) + np.linspace(-90.0, 90.0, 7)[:, None]
    usual = load_format(name).read(export(name).files, source.machine)
    chosen = made.kind.read(files, source.machine)
    np.testing.assert_array_equal(chosen(place, 1.0), usual(place, 1.0))


def test_a_fanuc_table_rounds_the_sum_and_keeps_small_steps(export, source):
    steps = re.findall(r"\bN\d+P(-?\d+)", export("fanuc").files["comp-pitch.txt"])
    assert max(abs(int(step)) for step in steps) <= 7
    larger = replace(source.result, theta=60.0 * source.result.theta)
    account = export_result(map_errors(larger), "fanuc", "comp").account
    after = account["volumetric_error_um"]
    assert after["after"]["mean"] < after["before"]["mean"]


def test_fanuc_tables_of_both_directions_stand_on_both_ends_of_travel(with_backlash):
    files = tabulate(with_backlash, "fanuc", 10.0).write(with_backlash)
    correction = Fanuc().read(files, with_backlash.machine)
    place = along(with_backlash, "X", np.linspace(-200.0, 300.0, 51))
    lost = [correction(place, d)[:, 0] for d in (1.0, -1.0)]
    np.testing.assert_allclose(lost[1] - lost[0], 0.008, atol=0.0011)
    words = files["c-parameters.txt"].split()
    assert words[1] == "N03605A1P00000001A2P00000000A3P00000000"
    assert next(w for w in words if w.startswith("N03624A1P10.000A2P10.000"))
    mean = tabulate(with_backlash, "fanuc", 10.0, directions="mean")
    assert "N03605A1P00000000" in mean.write(with_backlash)["c-parameters.txt"]


def read_fanuc(files):
    data = re.findall(r"N1(\d{4})P(-?\d+)", files["c-pitch.txt"])
    words = files["c-parameters.txt"].split()[1:-1]
    values = (map(float, re.findall(r"A\dP([\d.-]+)", word)) for word in words)
    numbers = (int(word[1:6]) for word in words)
    return np.array(data, int), dict(zip(numbers, map(list, values), strict=True))


@pytest.mark.parametrize(
    ("directions", "length_mm", "spacing_mm"),
    [("both", 4000.0, 10.0), ("mean", 500.0, 0.1)],
)
def test_fanuc_axes_share_points_0_to_1023(losing, directions, length_mm, spacing_mm):
    errors = losing(length_mm)
    made = tabulate(errors, "fanuc", spacing_mm, directions=directions)
    files = made.write(errors)
    steps, words = read_fanuc(files)
    points = steps[:, 0]
    assert len(set(points)) == len(points) > 850  # no number twice, most in use
    assert min(words[3620]) >= 0
    assert max(points) <= 1023
    correction = Fanuc().read(files, errors.machine)
    middle = along(errors, "Z", np.linspace(-1.0, 1.0, 9) * length_mm / 4)
    error = flat(errors.error_mm(middle))[:, 2]
    left = error + flat(0.5 * sum(correction(middle, d) for d in (1.0, -1.0)))[:, 2]
    assert np.abs(left).max() < max(0.003, 0.5 * np.abs(error).max())


@pytest.mark.parametrize("middle_mm", [430.0, -430.0])
def test_fanuc_points_count_from_machine_position_0_out_of_travel(losing, middle_mm):
    errors = losing(400.0, middle_mm)
    files = tabulate(errors, "fanuc", 10.0).write(errors)
    data, words = read_fanuc(files)
    steps, words = dict(data), {number: of[0] for number, of in words.items()}
    # The section of a point ends at it, and comes out in its middle.
    numbers = np.arange(int(words[3621]), int(words[3622]) + 1)
    middles = (numbers - words[3620] - 0.5) * words[3624]
    place = along(errors, "X", np.linspace(middle_mm - 200.0, middle_mm + 200.0, 41))
    step_mm = 1e-3 * np.array([steps[number] for number in numbers])
    added = (middles < place[:, :1]) @ step_mm
    left = errors.error_mm(place, 1.0)[:, 0] + added
    assert np.abs(flat(left)).max() < 0.0015
    assert np.abs(flat(added)).max() > 0.004


def test_fanuc_tables_with_more_points_than_numbers_are_refused_by_axis(losing):
    errors = losing(500.0)
    content = tabulate(errors, "linuxcnc", 2.0).tabulate(errors)
    with pytest.raises(BadInput, match="X 250 sections of 2 mm, twice") as refusal:
        Fanuc().write(content)
    assert "1023" in str(refusal.value)
    assert "wider spacing" in str(refusal.value)
    Fanuc("mean").write(content)


def test_heidenhain_tables_are_read_by_others_and_when_active(with_backlash, tmp_path):
    source = with_backlash
    files = tabulate(source, "heidenhain", 10.0).write(source)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    active, cut = files["config.cma"], "NR ACTIVE\n"
    wrong = {active.replace("*", "-"): "no line is active", cut: r"ends with \[END\]"}
    for config, said in wrong.items():
        with pytest.raises(BadInput, match=said):
            Heidenhain().read({**files, "config.cma": config}, source.machine)
    config = NCTable.parse_table(tmp_path / "config.cma").rows[0]
    assert config["ACTIVE"] == "*"
    for axis in source.axes:
        table = NCTable.parse_table(tmp_path / config[axis.name])
        lost = ["BACKLASH"] if axis.name == "X" else []  # no column without need
        assert table.column_names == ["NR", "AXISPOS", *lost, "X", "Y", "Z"]
        at = np.array([float(row["AXISPOS"]) for row in table.rows])
        value = np.array([float(row[axis.name]) for row in table.rows])
        error = source.error_mm(along(source, axis.name, at))
        own = flat(error)[:, "XYZ".index(axis.name)]
        np.testing.assert_allclose(flat(value), own, atol=2e-5)


REVERSED = "with the opposite sign it would be .* reverses the sign.*plugins --check"
GROWN = "they make it worse: choose another format, and run"
BREAKS = {
    "climbing": ("write", f'{{"../" + name: text {TEXTS}}}', "no plain file name"),
    "hollow": ("write", f'{{name: text.replace("0.0", "nan", 1) {TEXTS}}}', "nan"),
    "raising": ("write", "1 / 0", "division"),
    "nothing": ("write", "None", r"write\(\)"),
    "blind": ("read", "lambda at, side: math.nan * at[:, :3]", "finite"),
    "unread": ("read", '{}["X"]', r"read\(\)"),
    "turned": ("read", TIMES.format(-1), REVERSED),
    "grown": ("read", TIMES.format(1000), GROWN),
}


def export_broken(folder, loaded):
    made = export_result(map_errors(loaded), "broken", "c", spacing_mm=50.0)
    place, source = folder / "deep" / "out" / "c", folder / "result.json"
    write_output(made.files, made.account, place, "c", source=source)


@pytest.mark.fault_row(49)
@pytest.mark.parametrize("how", BREAKS)
def test_a_format_that_breaks_writes_nothing_and_is_named(
    loaded, tmp_path, monkeypatch, how
):
    verb, answer, said = BREAKS[how]
    points = {"compensation_formats": {"broken": "formats_here:Broken"}}
    code = BROKEN.format(verb=verb, answer=answer)
    monkeypatch.syspath_prepend(install(tmp_path / "site", points, formats_here=code))
    named = "" if how in ("turned", "grown") else f"broken. of {NAME}.*"
    with pytest.raises(BadInput, match=named + said):
        export_broken(tmp_path, loaded)
    assert not [*tmp_path.rglob("*.csv")]


def test_the_format_of_the_page_is_read_back_and_exported(
    source, tmp_path, monkeypatch
):
    page = Path(__file__).parents[3] / "docs" / "compensation.md"
    written, test = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.S)
    points = {"compensation_formats": {"othermake-c7": "othermake.c7:OthermakeC7"}}
    site = tmp_path / "site"
    monkeypatch.syspath_prepend(install(site, points))
    (site / "othermake").mkdir()
    (site / "othermake" / "c7.py").write_text(written, encoding="utf-8")
    (tmp_path / "test_c7.py").write_text(test, encoding="utf-8")
    found = runpy.run_path(str(tmp_path / "test_c7.py"))
    for check in CHECKS:
        found["test_a_c7_conforms"](check)
    made = export_result(source, "othermake-c7", "comp")
    stated = made.account["volumetric_error_um"]
    assert list(made.files) == ["comp.lst"]
    assert stated["after"]["mean"] < stated["before"]["mean"]
