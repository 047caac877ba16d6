"""Compensation files: what a controller makes of them, by rule and by other hands."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from pyLSV2 import NCTable

from truepath.compensation.export import export_result
from truepath.compensation.formats.etalon_exchange import EtalonExchange
from truepath.compensation.formats.fanuc import Fanuc
from truepath.compensation.formats.generic import GenericCsv, GenericJson
from truepath.compensation.formats.heidenhain import Heidenhain
from truepath.compensation.formats.isg_csv import IsgCsv
from truepath.compensation.formats.linuxcnc import LinuxCnc
from truepath.compensation.formats.siemens_all import SiemensOrder
from truepath.compensation.formats.siemens_lec_cec import SiemensCec, SiemensLec
from truepath.compensation.installed import list_formats, load_format
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured import find_measured_ranges
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.effects.elastic_sag import ElasticSagFamily
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.model import MachineModel, restore_effect
from truepath_simulators.scenario import load_machine

SIEMENS = ("siemens", "siemens-cec", "siemens-lec")
PLAIN = ("csv", "json")
OURS = (
    *PLAIN,
    "etalon-exchange",
    "fanuc",
    "heidenhain",
    "isg-csv",
    "linuxcnc",
    *SIEMENS,
)
SETTLED = (*PLAIN, "linuxcnc", "siemens-lec")
every_format = pytest.mark.parametrize("name", OURS)


@pytest.fixture(scope="module")
def source(loaded):
    return map_errors(loaded)


@pytest.fixture(scope="module")
def with_backlash(source):
    """The same machine, 8 µm of lost motion in X: half of it each way."""
    axis = source.axes[0]
    half_um = np.array([axis.low, axis.high]), np.full(2, 4.0)
    result = replace(source.result, half_difference_um={"X": half_um})
    return replace(source, result=result)


@pytest.fixture(scope="module")
def losing(source):
    """Make the same machine of other travels, 8 µm of lost motion in each axis."""

    def make(length_mm, middle_mm=0.0):
        ends = middle_mm + np.array([-length_mm / 2, length_mm / 2])
        axes = tuple(
            replace(axis, low=float(ends[0]), high=float(ends[1]))
            for axis in source.machine.linear_axes
        )
        machine = replace(source.machine, axes=axes)
        offsets = np.array([target.offset_mm for target in machine.targets])
        model, _ = build_identifiable_model(
            machine, offsets, knot_spacing_mm=length_mm / 4
        )
        size = np.array([4e-3 if p.unit == "mm" else 1e-5 for p in model.parameters])
        theta = size * np.random.default_rng(6).standard_normal(model.size)
        half_um = {axis.name: (ends, np.full(2, 4.0)) for axis in axes}
        return map_errors(
            CalibrationResult(
                model,
                theta,
                np.diag((1e-2 * size) ** 2),
                half_difference_um=half_um,
            )
        )

    return make


@pytest.fixture(scope="module")
def sagging():
    """A machine that does nothing but sag: X under Y."""
    machine = machine_from_json(load_machine("demo"), file="machine.json")
    keys = {"axis": "X", "by": "Y", "direction": "Z"}
    effect = restore_effect(ElasticSagFamily(), machine, keys, {})
    model = MachineModel(machine, (effect,))
    return map_errors(CalibrationResult(model, np.array([0.02]), 1e-12 * np.eye(1)))


def along(source, axis, at):
    """Positions along the middle of the other axes."""
    place = np.tile(source.middle_mm, (len(at), 1))
    place[:, source.machine.axis_names.index(axis)] = at
    return place


def flat(values):
    """Values without their mean: where an axis is 0 is a convention."""
    return values - values.mean(axis=0)


def test_our_formats_are_installed():
    assert set(OURS) <= set(list_formats())


@every_format
def test_what_is_left_is_stated_and_less_than_before(source, name):
    account = export_result(source, name, "comp").account
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


def test_products_of_cross_tables_correct_the_whole_volume_as_far_as_there_is_room(
    source,
):
    left = {
        control: export_result(
            source, "siemens", "c", choices={"control": control}
        ).account["left_um"]["map"]
        for control in ("840d-sl", "828d")
    }
    before = export_result(source, "siemens", "c").account["volumetric_error_um"]
    assert left["840d-sl"] < 0.01 * before["before"]["mean"]
    assert left["840d-sl"] < left["828d"] < 0.6 * before["before"]["mean"]


@pytest.mark.parametrize("control", ["828d", "808d"])
def test_a_small_control_gets_no_more_tables_and_points_than_it_has(source, control):
    files = export_result(
        source, "siemens", "c", spacing_mm=0.5, choices={"control": control}
    ).files
    cross = [line for line in files["c-cec.ini"].splitlines() if "$AN_CEC[" in line]
    places = [line.partition("]")[0].partition("[")[2].split(",") for line in cross]
    assert max(int(table) for table, _ in places) == 7
    assert max(int(index) for _, index in places) == 199
    factors = [line for line in cross if line.startswith("$AN_CEC[7,")]
    assert max(abs(float(line.partition("=")[2])) for line in factors) <= 0.1


def test_sag_is_a_product_of_two_cross_tables(sagging):
    account = export_result(sagging, "siemens-cec", "c").account
    (effect,) = account["effects"]
    assert effect["name"] == "elastic-sag"
    assert effect["rms_um"]["after"] < 0.02 * effect["rms_um"]["before"]


def test_a_choice_that_a_format_does_not_have_is_answered_with_those_it_has(source):
    with pytest.raises(BadInput, match="control of siemens: '802d' is none of 840d"):
        export_result(source, "siemens", "c", choices={"control": "802d"})
    with pytest.raises(BadInput, match="no choice of control; it has nothing"):
        export_result(source, "linuxcnc", "c", choices={"control": "828d"})


def test_only_formats_with_all_motions_correct_the_whole_volume(source):
    accounts = {name: export_result(source, name, "c").account for name in OURS}
    share = {
        name: one["left_um"]["map"] / one["volumetric_error_um"]["before"]["mean"]
        for name, one in accounts.items()
    }
    assert (
        max(share[one] for one in ("isg-csv", "etalon-exchange", "csv", "json")) < 0.01
    )
    assert (
        share["isg-csv"]
        < share["heidenhain"]
        < min(share["siemens-lec"], share["siemens-cec"])
    )
    assert share["linuxcnc"] == pytest.approx(share["siemens-lec"], rel=1e-3)


@pytest.mark.parametrize("name", ["fanuc", "heidenhain", "linuxcnc", "siemens-lec"])
@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_positioning_along_the_middle_is_gone_between_the_rows_too(source, name, axis):
    kind = {"fanuc": Fanuc, "heidenhain": Heidenhain, "linuxcnc": LinuxCnc}
    read = kind.get(name, SiemensLec)().read
    correction = read(export_result(source, name, "comp").files, source.machine)
    own = "XYZ".index(axis)
    travel = source.axes[own]
    place = along(source, axis, np.linspace(travel.low, travel.high, 333))
    error = flat(source.error_mm(place))[:, own]
    left = error + flat(correction(place, 1.0))[:, own]
    assert np.abs(error).max() > 0.002
    assert np.abs(left).max() < (0.0025 if name == "fanuc" else 0.0003)


def test_tables_are_zero_at_the_reference_point(source):
    for kind, name in ((SiemensLec, "siemens-lec"), (Fanuc, "fanuc")):
        read = kind().read(export_result(source, name, "c").files, source.machine)
        for axis in source.axes:
            zero = 0.0 if axis.low <= 0 <= axis.high else axis.low
            added = read(along(source, axis.name, np.array([zero])), 1.0)
            assert abs(added[0, "XYZ".index(axis.name)]) < 6e-5


def test_both_siemens_tables_in_one_order_leave_less_than_either(source):
    left = {
        name: export_result(source, name, "c").account["volumetric_error_um"]["after"]
        for name in SIEMENS
    }
    alone = min(left["siemens-lec"]["mean"], left["siemens-cec"]["mean"])
    assert left["siemens"]["mean"] < 0.8 * alone


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("linuxcnc", LinuxCnc),
        ("heidenhain", Heidenhain),
        ("siemens", SiemensOrder),
        ("csv", GenericCsv),
        ("json", GenericJson),
    ],
)
def test_lost_motion_is_corrected_in_both_directions(with_backlash, name, kind):
    files = export_result(with_backlash, name, "comp").files
    correction = kind().read(files, with_backlash.machine)
    travel = with_backlash.axes[0]
    at = np.linspace(travel.low + 1, travel.high - 1, 101)
    place = along(with_backlash, "X", at)
    up, down = (
        with_backlash.error_mm(place, d)[:, 0] + correction(place, d)[:, 0]
        for d in (1.0, -1.0)
    )
    np.testing.assert_allclose(up, down, atol=3e-5)
    lost = with_backlash.error_mm(place, 1.0) - with_backlash.error_mm(place, -1.0)
    np.testing.assert_allclose(lost[:, 0], 0.008, atol=1e-9)


@pytest.fixture(scope="module")
def export_stamped(source):
    """Export the result with Run, date, hash and measured ranges, once a format."""
    provenance = {
        "run": "morning",
        "created": "2026-11-26",
        "input_sha256": "f00d" * 16,
    }
    measured = {axis.name: (axis.low, axis.high) for axis in source.axes}
    result = replace(source.result, provenance=provenance, measured=measured)
    return cache(partial(export_result, replace(source, result=result), stem="comp"))


@every_format
def test_every_file_is_ascii_and_says_where_it_comes_from(export_stamped, name):
    export = export_stamped(name=name)
    files, lengths = export.files, export.account["lengths"]["text"]
    assert all(text.isascii() and text.endswith("\n") for text in files.values())
    commented = name in ("isg-csv", "etalon-exchange", *SIEMENS, *PLAIN)
    for line in ("target offset", lengths):
        assert all(line in text for text in files.values()) == commented
    if commented:
        (text, *_) = files.values()
        kind = load_format(name)
        assert f"units {kind.units}; directions of travel: {kind.directions}" in text
        assert "mm" in export.account["units"]


@every_format
def test_the_account_has_every_line_that_a_file_says_or_cannot_say(
    export_stamped, source, name
):
    account, machine = export_stamped(name=name).account, source.machine
    stamp = "\n".join(account["stamp"])
    for said in (
        f"machine {machine.name}, chain {machine.chain}",
        "for the tool at target offset",
        "run morning, analysed 2026-11-26",
        "input f00df00df00df00d",
        "measured at ",
        *(f"{axis.name} {axis.low:g} to {axis.high:g} mm" for axis in source.axes),
        f"units {load_format(name).units}; directions of travel: ",
        "sign (",
        account["lengths"]["text"],
    ):
        assert said in stamp


@every_format
def test_rows_fit_into_the_controller(source, name):
    account = export_result(source, name, "comp", spacing_mm=0.1).account
    most = {"linuxcnc": 256, "heidenhain": 256, "fanuc": 300}
    most |= {"siemens": 500, "siemens-cec": 500, "csv": 10_000, "json": 10_000}
    for table in account["tables"].values():
        assert table["points"] <= most.get(name, 1000)


def test_a_machine_without_errors_worth_a_table_gets_none(source):
    tiny = replace(source.result, theta=2e-3 * source.result.theta)
    with pytest.raises(BadInput, match="below what it resolves"):
        export_result(map_errors(tiny), "fanuc", "comp")


def test_an_unknown_format_is_answered_with_those_that_are_installed(source):
    with pytest.raises(BadInput, match="installed: csv, etalon-exchange, fanuc"):
        export_result(source, "vcs", "comp")


# What controllers make of files written by hand.


def at_x(*values):
    return np.array([[value, 0.0, 0.0] for value in values])


def test_linuxcnc_adds_nominal_less_column_by_direction(source):
    # As measured on LinuxCNC 2.9: 99.950 going up, 99.970 going down, ends held.
    text = "-10 -10.000 -10.000\n0 0.000 -0.010\n100 100.050 100.030\n510 510 509.98\n"
    correction = LinuxCnc().read({"c-X.tbl": text}, source.machine)
    up = correction(at_x(100.0, 50.0, 600.0), 1.0)
    np.testing.assert_allclose(up[:, 0], [-0.05, -0.025, 0.0], atol=1e-12)
    down = correction(at_x(100.0, -20.0), -1.0)
    np.testing.assert_allclose(down[:, 0], [-0.03, 0.0], atol=1e-12)
    assert not up[:, 1:].any()


@pytest.mark.parametrize(
    "text", ["# head\n0 0 0\n", "0,0,0\n1,1,1\n", "1 1 1\n0 0 0\n"]
)
def test_what_linuxcnc_would_ignore_without_a_word_is_refused(source, text):
    with pytest.raises(BadInput):
        LinuxCnc().read({"c-X.tbl": text}, source.machine)


def test_a_positive_siemens_value_moves_the_axis_in_the_negative_direction(source):
    text = """%_N_AX_EEC_INI
CHANDATA(1)
$AA_ENC_COMP[0,0,X1]=0.0 ; by hand
$AA_ENC_COMP[0,1,X1]=0.01
$AA_ENC_COMP[0,2,X1]=0.02
$AA_ENC_COMP_STEP[0,X1]=100.0
$AA_ENC_COMP_MIN[0,X1]=-100.0
$AA_ENC_COMP_MAX[0,X1]=100.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
M17
"""
    correction = SiemensLec().read({"x.ini": text}, source.machine)
    added = correction(at_x(-200.0, -50.0, 0.0, 100.0), 1.0)
    np.testing.assert_allclose(added[:, 0], [0.0, -0.005, -0.01, -0.02])
    with pytest.raises(BadInput, match="lacks points"):
        SiemensLec().read(
            {"x.ini": text.replace("[0,1,X1]", "[0,3,X1]")}, source.machine
        )
    with pytest.raises(BadInput, match="row 3"):
        SiemensLec().read({"x.ini": text.replace("=0.0 ;", "=O.O ;")}, source.machine)


@pytest.mark.parametrize("name", ["siemens", "siemens-lec"])
def test_leadscrew_tables_are_of_the_measuring_system_that_is_chosen(source, name):
    texts = {}
    for system, index in (("1", 0), ("2", 1)):
        choices = {"measuring_system": system}
        export = export_result(source, name, "c", choices=choices)
        (text,) = (t for t in export.files.values() if "$AA_ENC_COMP[" in t)
        lines = text.splitlines()
        assert f"; tables of measuring system {system}: $AA_ENC_COMP[{index}," in text
        indices = {line.partition("[")[2][0] for line in lines if line[:2] == "$A"}
        assert indices == {str(index)}
        assert (
            f"of measuring system {system} ($AA_ENC_COMP[{index}, "
            in (export.account["note"])
        )
        assert f"MD32700[{index}] = 0" in export.account["note"]
        assert export.account["choices"]["measuring_system"] == system
        read = load_format(name, choices).read(export.files, source.machine)
        texts[system] = read(along(source, "X", np.linspace(-200, 300, 7)), 1.0)
    np.testing.assert_array_equal(texts["1"], texts["2"])


@pytest.mark.parametrize("name", ["siemens", "siemens-lec"])
def test_the_measuring_system_may_differ_from_axis_to_axis(source, name):
    choices = {"measuring_system": "Y=2,Z=1"}
    export = export_result(source, name, "c", choices=choices)
    (text,) = (t for t in export.files.values() if "$AA_ENC_COMP[" in t)
    assert set(re.findall(r"^\$AA_ENC_COMP\[(\d),\d+,(\w1)\]", text, re.M)) == {
        ("0", "X1"),
        ("1", "Y1"),
        ("0", "Z1"),
    }
    assert "$AA_ENC_COMP_STEP[1,Y1]=" in text
    assert "; tables of measuring system 2 of Y, 1 of Z, 1 of others: " in text
    assert "MD32700[e] = 0" in export.account["note"]
    assert export.account["choices"]["measuring_system"] == "Y=2,Z=1"
    plain = export_result(source, name, "c")
    both = [
        load_format(name).read(one.files, source.machine)(
            along(source, "Y", np.linspace(10, 400, 7)), 1.0
        )
        for one in (export, plain)
    ]
    np.testing.assert_array_equal(*both)


@pytest.mark.parametrize(
    "word", ["3", "", "X=3", "X=1,X=2", "x=1", "X=1,", "X=1;Y=2", "=1", "X=1/../2"]
)
def test_a_measuring_system_that_is_none_is_refused(word):
    with pytest.raises(BadInput, match="1, 2"):
        load_format("siemens", {"measuring_system": word})


@pytest.mark.parametrize("word", ["2", "X=1,Y=2"])
@pytest.mark.parametrize("name", ["siemens", "siemens-lec"])
def test_a_control_without_a_second_measuring_system_gets_no_tables_of_it(name, word):
    choices = {"control": "808d", "measuring_system": word}
    with pytest.raises(BadInput, match="the 808D has 1 alone, not 2"):
        load_format(name, choices)


def test_choices_of_other_formats_and_axes_are_not_taken_by_axis(source):
    with pytest.raises(BadInput, match="control of siemens: 'X=828d' is none"):
        load_format("siemens", {"control": "X=828d"})
    with pytest.raises(BadInput, match="the machine has no axis A; it has X, Y, Z"):
        export_result(source, "siemens", "c", choices={"measuring_system": "A=2"})


def test_leadscrew_tables_of_both_measuring_systems_of_an_axis_are_refused(source):
    text = "$AA_ENC_COMP[0,0,X1]=0.0\n$AA_ENC_COMP[1,1,X1]=0.01\n"
    with pytest.raises(BadInput, match=r"x\.ini, row 2: X1 .* measuring system 1"):
        SiemensLec().read({"x.ini": text}, source.machine)


def test_a_siemens_cross_table_corrects_one_axis_by_another(source):
    text = """$AN_CEC[0,0]=0.0
$AN_CEC[0,1]=0.03
$AN_CEC_INPUT_AXIS[0]=(AX1)
$AN_CEC_OUTPUT_AXIS[0]=(AX3)
$AN_CEC_STEP[0]=300.0
$AN_CEC_MIN[0]=0.0
$AN_CEC_MAX[0]=300.0
"""
    added = SiemensCec().read({"c.ini": text}, source.machine)(at_x(100.0), 1.0)
    np.testing.assert_allclose(added, [[0.0, 0.0, -0.01]])


def test_fanuc_points_count_intervals_from_the_reference_point(source):
    # FANUC's own example: travel −400 to 800, interval 50, reference point number 40:
    # points 33 to 56.
    axes = tuple(
        replace(axis, low=-400.0, high=800.0) for axis in source.machine.linear_axes
    )
    machine = replace(source.machine, axes=axes)
    increments = dict.fromkeys(range(33, 57), 0) | {41: 2, 42: 1, 40: 3, 33: -1}
    rows = [
        f"N{10000 + 100 * axis + number}P{step}"
        for axis in range(3)
        for number, step in increments.items()
    ]
    words = {3620: 40, 3621: 33, 3622: 56}
    parameters = [
        f"N0{number}" + "".join(f"A{i + 1}P{value + 100 * i}" for i in range(3))
        for number, value in words.items()
    ]
    parameters += ["N03623A1P1A2P1A3P2", "N03624A1P50.0A2P50.0A3P50.0"]
    files = {
        "c-pitch.txt": "\n".join(["%", *rows, "%", ""]),
        "c-parameters.txt": "\n".join(["%", *parameters, "%", ""]),
    }
    correction = Fanuc().read(files, machine)
    # The value of a section comes out in its middle, as a step.
    added = 1e3 * correction(at_x(0, 50, 100, 800, 24, 26, -50, -350, -400), 1.0)[:, 0]
    np.testing.assert_allclose(added, [0, 2, 3, 3, 0, 2, -3, -3, -2], atol=1e-9)
    place = np.array([[0.0, 0.0, 50.0]])
    assert correction(place, 1.0)[0, 2] == pytest.approx(0.004)  # magnification 2


def test_a_fanuc_table_rounds_the_sum_and_keeps_small_steps(source):
    files = export_result(source, "fanuc", "comp").files
    steps = [
        int(line.partition("P")[2])
        for line in files["comp-pitch.txt"].split()
        if line.startswith("N")
    ]
    assert max(map(abs, steps)) <= 7
    larger = replace(source.result, theta=60.0 * source.result.theta)
    account = export_result(map_errors(larger), "fanuc", "comp").account
    after = account["volumetric_error_um"]
    assert after["after"]["mean"] < after["before"]["mean"]


def test_fanuc_tables_of_both_directions_stand_on_both_ends_of_the_travel(
    with_backlash,
):
    export = export_result(with_backlash, "fanuc", "comp")
    correction = Fanuc().read(export.files, with_backlash.machine)
    place = along(with_backlash, "X", np.linspace(-200.0, 300.0, 51))
    lost = [correction(place, d)[:, 0] for d in (1.0, -1.0)]
    np.testing.assert_allclose(lost[1] - lost[0], 0.008, atol=0.0011)
    words = export.files["comp-parameters.txt"].split()
    assert words[1] == "N03605A1P00000001A2P00000000A3P00000000"
    assert next(w for w in words if w.startswith("N03624A1P10.000A2P10.000"))
    mean = export_result(with_backlash, "fanuc", "c", choices={"directions": "mean"})
    assert "N03605A1P00000000" in mean.files["c-parameters.txt"]


def find_fanuc_points(files):
    """Point numbers of the increments, and of the reference points."""
    data = re.findall(r"N(1\d{4})P", files["c-pitch.txt"])
    words = files["c-parameters.txt"].split()
    reference = next(word for word in words if word.startswith("N03620"))
    zero = [int(n) for n in re.findall(r"A\dP(\d+)", reference)]
    return [int(n) - 10_000 for n in data], zero


@pytest.mark.parametrize(
    ("directions", "length_mm", "spacing_mm"),
    [("both", 4000.0, 10.0), ("mean", 500.0, 0.1)],
)
def test_all_axes_of_a_fanuc_control_share_the_points_0_to_1023(
    losing, directions, length_mm, spacing_mm
):
    errors = losing(length_mm)
    choices = {"directions": directions}
    export = export_result(errors, "fanuc", "c", spacing_mm=spacing_mm, choices=choices)
    points, zero = find_fanuc_points(export.files)
    assert len(set(points)) == len(points) > 850  # no number twice, most in use
    assert min(zero) >= 0
    assert max(points) <= 1023
    correction = Fanuc().read(export.files, errors.machine)
    middle = along(errors, "Z", np.linspace(-1.0, 1.0, 9) * length_mm / 4)
    error = flat(errors.error_mm(middle))[:, 2]
    left = error + flat(0.5 * sum(correction(middle, d) for d in (1.0, -1.0)))[:, 2]
    assert np.abs(left).max() < max(0.003, 0.5 * np.abs(error).max())


@pytest.mark.parametrize("middle_mm", [430.0, -430.0])
def test_fanuc_points_count_from_machine_position_0_out_of_the_travel(
    losing, middle_mm
):
    errors = losing(400.0, middle_mm)
    files = export_result(errors, "fanuc", "c").files
    data = re.findall(r"N1(\d{4})P(-?\d+)", files["c-pitch.txt"])
    steps = {int(number): int(step) for number, step in data}
    rows = files["c-parameters.txt"].split()[1:-1]
    words = {int(row[1:6]): float(re.findall(r"A1P([\d.-]+)", row)[0]) for row in rows}
    # The section of a point ends at it, and comes out in its middle.
    numbers = np.arange(int(words[3621]), int(words[3622]) + 1)
    middles = (numbers - words[3620] - 0.5) * words[3624]
    place = along(errors, "X", np.linspace(middle_mm - 200.0, middle_mm + 200.0, 41))
    added = np.array(
        [
            1e-3
            * sum(steps[n] for n, at in zip(numbers, middles, strict=True) if at < x)
            for x in place[:, 0]
        ]
    )
    left = errors.error_mm(place, 1.0)[:, 0] + added
    assert np.abs(flat(left)).max() < 0.0015
    assert np.abs(flat(added)).max() > 0.004


def test_fanuc_tables_with_more_points_than_numbers_are_refused_by_axis(losing):
    errors = losing(500.0)
    measured = find_measured_ranges(errors.machine, {}, None)
    content = Tabulation(LinuxCnc(), "c", (), 2.0, measured).tabulate(errors)
    with pytest.raises(BadInput, match="X 250 sections of 2 mm, twice") as refusal:
        Fanuc().write(content)
    assert "1023" in str(refusal.value)
    assert "wider spacing" in str(refusal.value)
    Fanuc("mean").write(content)


def test_an_etalon_file_says_the_same_as_an_isg_file(source):
    place = np.array([[100.0, 30.0, 200.0], [-150.0, 380.0, 20.0]])
    added = [
        kind().read(export_result(source, name, "c").files, source.machine)(place, 1.0)
        for name, kind in (("isg-csv", IsgCsv), ("etalon-exchange", EtalonExchange))
    ]
    assert np.abs(added[0]).max() > 0.005
    np.testing.assert_allclose(added[0], added[1], atol=1e-9)


def test_sag_is_left_by_an_etalon_file_and_the_account_says_so(sagging):
    with pytest.raises(BadInput, match="choose another format"):
        export_result(sagging, "etalon-exchange", "c")
    assert "sag" in EtalonExchange.not_carried


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[EXX]\nVALUES = 1\n", "begins no block"),
        ("[EXX]\nGridpoints = {\n0 0\n0 1\n}\n", "ascending"),
        ("[EXX]\nGridpoints = {\n0 0\n1\n}\n", "two numbers"),
        ("[EXC]\nVALUE = 1\n", "no axis has the parameter EXC"),
    ],
)
def test_an_etalon_file_that_the_control_cannot_read_is_refused(source, text, said):
    with pytest.raises(BadInput, match=said):
        EtalonExchange().read({"c.txt": text}, source.machine)


def test_an_isg_file_that_follows_the_tool_is_the_same_for_the_measured_one(source):
    choices = {"tool_length": "followed"}
    followed = export_result(source, "isg-csv", "c", choices=choices).files
    fixed = export_result(source, "isg-csv", "c").files
    place = np.array([[100.0, 30.0, 200.0], [-150.0, 380.0, 20.0]])
    added = [
        IsgCsv(**one).read(files, source.machine)(place, 1.0)
        for one, files in ((choices, followed), ({}, fixed))
    ]
    np.testing.assert_allclose(added[0], added[1], atol=2e-6)
    assert "N0X  N0Y  N0Z\n0  0  -1\n#" in followed["c.csv"]


def test_isg_takes_the_errors_of_the_chain_away(source):
    text = """// by hand
X  EXX  EYX  EZX  EAX  EBX  ECX
0  0  0  0  0  0  0
100  0.01  0.02  0  0  0  0.0001
"""
    machine = source.machine
    position = np.array([[100.0, 30.0, 0.0]])
    added = IsgCsv().read({"c.csv": text}, machine)(position, 1.0)
    later = machine.order[machine.order.index("X") + 1 :]
    arm = 30.0 if "Y" in later else 0.0
    np.testing.assert_allclose(added, [[-0.01 + 0.0001 * arm, -0.02, 0.0]], atol=1e-12)
    with pytest.raises(BadInput, match="six motions"):
        IsgCsv().read({"c.csv": text.replace("EYX", "EYY")}, machine)


CSV = """# by hand
axis,direction,position_mm,x_um,y_um,z_um,a_urad,b_urad,c_urad
X,+,0,0,0,0,0,0,0
X,+,100,10,20,0,0,0,100
X,-,0,6,0,0,0,0,0
X,-,100,16,20,0,0,0,100
"""


def test_a_row_of_the_plain_table_is_the_error_by_direction(source):
    machine = source.machine
    position = np.array([[50.0, 30.0, 0.0]])
    read = GenericCsv().read({"c.csv": CSV}, machine)
    later = machine.order[machine.order.index("X") + 1 :]
    arm = 50e-6 * 30.0 if "Y" in later else 0.0
    up, down = [-0.005 + arm, -0.01, 0.0], [-0.011 + arm, -0.01, 0.0]
    np.testing.assert_allclose(read(position, 1.0), [up], atol=1e-12)
    np.testing.assert_allclose(read(position, -1.0), [down], atol=1e-12)
    with pytest.raises(BadInput, match="the columns are to be axis, direction"):
        GenericCsv().read({"c.csv": CSV.replace("x_um", "x_mm")}, machine)


def test_csv_and_json_say_the_same(source):
    (table,) = export_result(source, "csv", "c").files.values()
    (document,) = export_result(source, "json", "c").files.values()
    content = json.loads(document)
    lines = [line for line in table.splitlines() if not line.startswith("#")]
    assert lines[0].split(",") == content["columns"]
    for line, row in zip(lines[1:], content["rows"], strict=True):
        axis, side, *numbers = line.split(",")
        assert [axis, side] == row[:2]
        np.testing.assert_allclose([float(n) for n in numbers], row[2:], atol=1e-6)


def test_heidenhain_tables_are_read_by_a_parser_that_is_not_ours(
    with_backlash, tmp_path
):
    source = with_backlash
    files = export_result(source, "heidenhain", "comp").files
    for name, text in files.items():
        (tmp_path / name).write_text(text)
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


def test_heidenhain_tables_act_only_when_activated(source):
    files = export_result(source, "heidenhain", "comp").files
    off = {**files, "config.cma": files["config.cma"].replace("*", "-")}
    with pytest.raises(BadInput, match="no line is active"):
        Heidenhain().read(off, source.machine)
    cut = {**files, "config.cma": "NR ACTIVE\n"}
    with pytest.raises(BadInput, match=r"BEGIN and ends with \[END\]"):
        Heidenhain().read(cut, source.machine)
