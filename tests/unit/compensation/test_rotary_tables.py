"""Tables, places and swivel data of rotary axes: by rules of controls, exactly."""

import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from known_machines import (
    build_model,
    displace,
    find_ends,
    map_known,
    measure_left,
    spread,
    tabulate,
    write,
)
from truepath.compensation.export import export_result
from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    RotaryAxisLocation,
)
from truepath.compensation.format_registry import load_format
from truepath.compensation.formats.siemens_all import SWIVEL, write_swivel
from truepath.compensation.rotary_residual import RotaryFiles, describe_rotary
from truepath.compensation.tables.error_map import ErrorMap, map_errors
from truepath.compensation.tables.rotary import find_locations
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult, HalfDifference
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.symbols import list_locations
from truepath_simulators.compensation import siemens
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import load_machine, parse_machine

# A trunnion carries the workpiece; a head turns the tool.
MACHINES, TURNS = ("trunnion", "head-table"), ("EAA", "EBB", "ECC")
SHIFT_MM = {"XOC": 0.012, "YOC": -0.02, "ZOT": 0.03, "ACROSS": -0.015}
FREEDOM = 50.0  # values by which the size of what is not known is known
HALF_URAD, HALF_U_URAD = 12.0, 1.0
FORMATS = ("isg-csv", "linuxcnc", "siemens")


@pytest.fixture(scope="module", params=MACHINES)
def turning(request):
    model, rng = build_model(load_machine(request.param)), np.random.default_rng(3)
    motions = (m for m in model.identifiable_motions if m.symbol in TURNS)
    turns = {m.name: 5e-5 * rng.standard_normal(len(m.parameters)) for m in motions}
    return request.param, map_known(model, turns)


@pytest.mark.parametrize("name", ["linuxcnc", "siemens", "siemens-lec"])
def test_the_tool_stands_where_it_should_once_a_control_has_the_tables(turning, name):
    machine, errors = turning
    truth = perfect(parse_machine(load_machine(machine)))
    joints = dict(truth.joints)
    for axis in truth.machine.rotary_axes:
        turns, own = list(joints[axis.name].rotation), "ABC".index(axis.name)
        turn_rad = partial(errors.rotation_rad, axis.name)
        turns[own] = SimpleNamespace(at=lambda deg, of=turn_rad, k=own: of(deg)[:, k])
        joints[axis.name] = replace(joints[axis.name], rotation=tuple(turns))
    truth = replace(truth, joints=joints)
    position = spread(errors.machine, 200)
    before, after = measure_left(truth, tabulate(errors, name).write(errors), position)
    assert before.mean() > 0.003
    assert after.mean() < 0.03 * before.mean()


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_wrapped_axis_that_counts_on_is_corrected_in_its_next_turn(turning, turns):
    machine, errors = turning
    files = tabulate(errors, "linuxcnc").write(errors)
    control = LoadedTables(files).correct(parse_machine(load_machine(machine)))
    low, high = find_ends(errors.machine)
    position = np.linspace(low, high, 90)[5:-5]
    here = control.added(position, np.ones_like(position))
    turns_fully = [getattr(one, "turns_fully", False) for one in errors.machine.axes]
    columns = np.flatnonzero(turns_fully)
    assert len(columns)
    position[:, columns] += 360.0 * turns
    there = control.added(position, np.ones_like(position))
    size = np.ptp(here[:, columns])
    assert np.abs(there - here)[:, columns].max() < 0.05 * size


def test_the_account_states_the_angle_and_what_it_does_at_the_tool(turning):
    _, errors = turning
    content = tabulate(errors, "linuxcnc").tabulate(errors)
    kind = load_format("linuxcnc")
    added = kind.read_rotary(kind.write(content), errors.machine)
    carried = describe_rotary(errors, RotaryFiles(content.rotary, added))
    left = describe_rotary(errors, RotaryFiles())  # of a format without such tables
    assert not load_format("fanuc").carries_rotary
    for axis in errors.machine.rotary_axes:
        one, other = carried[axis.name], left[axis.name]
        for what in ("positioning_urad", "at_tool_um"):
            assert one[what]["after"] < 0.035 * one[what]["before"]
            assert other[what]["after"] == other[what]["before"] > 1.0
        assert not one["table"]["repeats_each_turn"]  # a joint counts turns
        low, high = one["table"]["from_deg"], one["table"]["to_deg"]
        beyond = 360.0 if axis.turns_fully else 0.0
        assert (low, high) == pytest.approx((axis.low - beyond, axis.high + beyond))
        assert other["table"] is None
        assert one["not_in_files"]


@pytest.fixture(scope="module", params=MACHINES)
def erring(request):
    model = build_model(load_machine(request.param))
    size = np.array([5e-3 if p.unit == "mm" else 2e-5 for p in model.parameters])
    theta = size * np.random.default_rng(8).standard_normal(model.size)
    return request.param, map_known(model, theta, size**2)


@pytest.mark.parametrize("choice", ["fixed", "followed"])
def test_an_isg_volume_brings_the_tool_where_it_should_be_at_any_angle(erring, choice):
    name, errors = erring
    made = tabulate(errors, "isg-csv", 5.0, tool_length=choice)
    files = made.write(errors)
    position = spread(errors.machine, 250)
    tool = abs(errors.machine.target().offset_mm[2])
    simulated, rules = parse_machine(load_machine(name)), Rules(tool_length_mm=tool)
    control = LoadedTables(files, rules).correct(simulated)
    added = control.added(position, np.ones_like(position))
    ours = made.kind.read(files, errors.machine)(position, 1.0)
    before = np.linalg.norm(errors.error_mm(position), axis=1)
    moved = make_standstill(errors.machine, position + added).chain.point_mm
    moved = moved - make_standstill(errors.machine, position).chain.point_mm
    after = np.linalg.norm(errors.error_mm(position) + moved, axis=1)
    assert before.mean() > 0.01
    assert after.mean() < 0.02 * before.mean()
    np.testing.assert_allclose(ours, added[:, :3], atol=2e-4)


def test_the_account_states_the_error_over_all_axes(erring):
    _, errors = erring
    # LinuxCNC has 256 rows for the turn that was measured and its two neighbours.
    for name, share, left in (("isg-csv", 0.03, 0.03), ("linuxcnc", 1.0, 0.05)):
        stated = write(errors, name, 5.0)
        assert stated.over["before"] > 5.0
        assert stated.over["after"] < share * stated.over["before"]
        for axis in errors.machine.rotary_axes:
            one = stated.rotary[axis.name]
            assert one["at_tool_um"]["after"] < left * one["at_tool_um"]["before"]
            angle = one["positioning_urad"]
            is_turned = angle["after"] < left * angle["before"]
            assert is_turned == (name == "linuxcnc")
            assert bool(one["not_in_files"]) == is_turned


@pytest.fixture(scope="module", params=["A", "B"])
def shifted(request):
    tilting = request.param
    text = json.dumps(load_machine("trunnion")).replace('"A"', f'"{tilting}"')
    content = json.loads(text.replace("w-C-A", f"w-C-{tilting}"))
    names = {"ZOT": f"ZO{tilting}", "ACROSS": f"{'YX'[tilting == 'B']}O{tilting}"}
    values = {names.get(name, name): value for name, value in SHIFT_MM.items()}
    return content, map_known(build_model(content), values)


def test_pins_of_the_kinematics_bring_the_tool_where_it_should_be(shifted):
    content, errors = shifted
    files = tabulate(errors, "linuxcnc").write(errors)
    pins = {name: text for name, text in files.items() if name.endswith(".hal")}
    truth = displace(content, find_locations(errors))
    before, after = measure_left(truth, pins, spread(errors.machine, 300))
    assert before.max() > 0.02
    assert after.max() < 2e-5
    assert LoadedTables(files).correct(truth.machine) is not None


@pytest.mark.parametrize("name", ["linuxcnc", "json"])
def test_locations_are_read_back_and_the_account_says_what_they_leave(shifted, name):
    _, errors = shifted
    files, kind = tabulate(errors, name).write(errors), load_format(name)
    located = kind.read_locations(files, errors.machine)
    account = describe_rotary(errors, RotaryFiles(located=located))
    for place in find_locations(errors):
        one = account[place.axis.name]
        assert one["location_at_tool_um"]["before"] > 5.0
        assert one["location_at_tool_um"]["after"] < 1e-3
        for symbol, value in place.location.items():
            if value:
                assert located[symbol] == pytest.approx(value, abs=1e-6)
                assert symbol not in one["not_in_files"]
    if name == "linuxcnc":  # which has no pins for tilts
        assert {"AOC", "BOC"} <= set(account["C"]["not_in_files"])
    kept = describe_rotary(errors, RotaryFiles())["C"]["location_at_tool_um"]
    assert kept["after"] == kept["before"]


def test_pins_not_of_the_machine_are_refused_and_no_trunnion_gets_none(shifted):
    content, errors = shifted
    machine = errors.machine
    text = "setp maxkins.pivot-length 100\n"
    with pytest.raises(BadInput, match="is no pin of this machine"):
        load_format("linuxcnc").read_locations({"c-kinematics.hal": text}, machine)
    other = "A" if "B" in machine.axis_names else "B"
    wrong = f"setp xyz{other.lower()}c-trt-kins.x-rot-point 1\n"
    with pytest.raises(SimulatorError, match="has no axes"):
        LoadedTables({"c.hal": wrong}).correct(parse_machine(content))
    head = map_known(build_model(load_machine("head-table")), {})
    files = tabulate(head, "linuxcnc").write(head)
    assert not [name for name in files if name.endswith(".hal")]


@pytest.mark.parametrize(
    ("machine", "name"),
    [
        *(("trunnion", name) for name in ("linuxcnc", "siemens", "isg-csv", "json")),
        *(("head-table", name) for name in ("siemens", "isg-csv")),
    ],
)
def test_a_place_is_corrected_once_where_an_axis_never_comes_to_its_zero(machine, name):
    content = load_machine(machine)
    content["axes"]["C"] |= {"min_deg": 30.0, "max_deg": 300.0}
    tilting = "A" if machine == "trunnion" else "B"
    content["axes"][tilting] |= {"min_deg": 20.0, "max_deg": 95.0}
    model = build_model(content, intervals=4)
    places = {"XOC": 0.03, "YOC": -0.02, f"ZO{tilting}": 0.025}
    known = {one: value for one, value in places.items() if one in model.slices}
    errors = map_known(model, known)
    written = write(errors, name, 100.0)
    assert written.over["after"] < 0.02 * written.over["before"]
    if name == "json":  # which no control reads: software places the axes by it
        return
    truth = displace(content, find_locations(errors))
    position = spread(errors.machine, 200)
    before, after = measure_left(truth, written.files, position)
    assert before.max() > 0.04
    assert after.max() < 0.02 * before.max()


class KnownMachine(NamedTuple):
    """A machine, and a result of it that is wrong by what it says."""

    name: str
    truth: ErrorMap
    found: ErrorMap
    lost_urad: float  # true half of the lost motion of each rotary axis


def make_machine(name: str, seed: int, unknown: float) -> KnownMachine:
    rng = np.random.default_rng(seed)
    model = build_model(load_machine(name), intervals=4)
    machine = model.machine
    size = np.array([4e-3 if p.unit == "mm" else 2e-5 for p in model.parameters])
    theta = size * rng.standard_normal(model.size)
    wrong = unknown * size * rng.standard_normal(model.size)
    stated = rng.chisquare(FREEDOM) / FREEDOM * np.diag((unknown * size) ** 2)
    ends = {a.name: np.array([a.low, a.high]) for a in machine.rotary_axes}
    known = np.full(2, HALF_URAD), np.full(2, HALF_U_URAD)
    halves = {f"E{a}{a}": HalfDifference(at, *known) for a, at in ends.items()}
    off = HALF_U_URAD * rng.standard_normal()
    result = CalibrationResult(model, theta + wrong, stated, noise_freedom=FREEDOM)
    result = replace(result, halves=halves)
    true = map_known(model, theta)
    return KnownMachine(name, true, map_errors(result), HALF_URAD + off)


def measure_true_um(known: KnownMachine, files: Mapping[str, str] | None) -> float:
    machine = known.truth.machine
    low, high = find_ends(machine)
    unit = qmc.Sobol(len(low), rng=np.random.default_rng(77)).random(2048)
    position = low + unit * (high - low)
    point = make_standstill(machine, position).chain.point_mm
    error = known.truth.error_mm(position)
    every = []
    for side in (1.0, -1.0):
        sent = position.copy()
        if files is not None:
            simulated = parse_machine(load_machine(known.name))
            control = LoadedTables(files).correct(simulated)
            sent += control.added(position, np.full_like(position, side))
        for axis in machine.rotary_axes:  # the axis itself turns on by what it loses
            sense = -1.0 if axis.name in machine.workpiece_side else 1.0
            lost = sense * side * np.degrees(1e-6 * known.lost_urad)
            sent[:, machine.axis_names.index(axis.name)] += lost
        every.append(error + make_standstill(machine, sent).chain.point_mm)
    a, b = (p - p.mean(axis=0) for p in map(np.vstack, ([point, point], every)))
    rotation, _ = Rotation.align_vectors(a, b)
    return 1e3 * np.mean(np.linalg.norm(rotation.apply(b) - a, axis=1))


def find_offs(known: KnownMachine) -> np.ndarray:
    """What each format states less the truth, in standard uncertainties."""
    true_before, offs = measure_true_um(known, None), []
    for name in FORMATS:
        written = write(known.found, name, 20.0)
        over = written.over
        before = over["before"] - true_before
        after = over["after_expected"] - measure_true_um(known, written.files)
        u = [over[f"{one}_expanded_uncertainty"] for one in ("before", "after")]
        offs.append(over["coverage_factor"] * np.divide([before, after], u))
    return np.array(offs)


def find_many(count: int, unknown: float) -> np.ndarray:
    kinds = itertools.islice(itertools.cycle(("trunnion", "head-table")), count)
    machines = (make_machine(kind, k, unknown) for k, kind in enumerate(kinds))
    return np.array([find_offs(one) for one in machines])


def test_the_stated_uncertainty_covers_the_truth_of_known_machines():
    offs = find_many(2, 0.05)
    assert np.abs(offs).max() < 3.5
    assert np.mean(np.abs(offs) < 2.0) >= 0.75


@pytest.mark.long
@pytest.mark.parametrize("unknown", [0.05, 0.2])
def test_the_truth_is_within_what_is_stated_at_its_rate(unknown):
    offs = find_many(40, unknown)
    share = np.mean(np.abs(offs) < 2.0, axis=0)
    assert (share >= 0.85).all(), share  # 95 of 100 are due; of 40 as few by 1 in 100
    assert (np.sqrt(np.mean(offs**2, axis=0)) > 0.5).all()  # and no more than is due


def test_lost_motion_of_a_straight_axis_turns_with_the_table():
    known = make_machine("trunnion", 3, 1e-4)
    machine = known.truth.machine
    ends = np.array([machine.linear("X").low, machine.linear("X").high])
    half = known.found.result.halves | {"EXX": HalfDifference(ends, np.full(2, 6.0))}
    errors = map_errors(replace(known.found.result, halves=half))
    position = np.zeros((1, len(machine.axes)))
    position[:, machine.axis_names.index("C")] = 90.0
    lost = errors.error_mm(position, 1.0) - errors.error_mm(position, -1.0)
    sent = position.copy()
    sent[:, machine.axis_names.index("X")] += 0.012
    points = [make_standstill(machine, one).chain.point_mm for one in (sent, position)]
    np.testing.assert_allclose(lost, points[0] - points[1], atol=1e-9)
    assert abs(lost[0, 0]) < 1e-9 < abs(lost[0, 1])


def test_lost_motion_of_a_rotary_axis_is_in_the_files_or_said_to_be_left():
    known = make_machine("trunnion", 3, 1e-3)
    without = replace(known.found.result, halves={})
    stated = {name: write(known.found, name, 20.0).rotary["C"] for name in FORMATS}
    for name, one in stated.items():
        lost = one["lost_motion_urad"]
        assert lost["before"] == pytest.approx(2.0 * HALF_URAD)
        is_left = lost["after"] == pytest.approx(2.0 * HALF_URAD)
        assert is_left == (name != "linuxcnc")
        assert one["lost_motion"].startswith("left" if is_left else "in the files")
        assert lost["after_expanded_uncertainty"] > 0.0
    assert stated["linuxcnc"]["lost_motion_urad"]["after"] < 0.1
    none = write(map_errors(without), "linuxcnc", 20.0).rotary["C"]
    assert none["lost_motion"] == "not in the result"
    assert none["lost_motion_urad"] is None


def test_the_account_and_comments_of_a_file_state_what_is_left_over_all_axes():
    found = make_machine("trunnion", 3, 0.05).found
    export = export_result(found, "isg-csv", "c", spacing_mm=20.0)
    over = export.account["over_all_axes_um"]
    assert over == pytest.approx(write(found, "isg-csv", 20.0).over)
    (text,) = export.files.values()
    left = f"{over['after_expected']:.2f} +- {over['after_expanded_uncertainty']:.2f}"
    assert f"with these files {left} um (k = 2)" in text


FORMAT = load_format("siemens")
RIGHT_HANDED = "v2 is not the direction of C, which turns right-handed"
ORIGINS = {"A": [260.0, 220, -120], "B": [15.0, -8, 90], "C": [250.0, 225, -170]}
CHAINS = {
    "w-C-A-b-X-Y-Z-t": ("P", "A C"),
    "w-C-B-X-b-Y-Z-t": ("P", "B C"),
    "w-C-b-X-Y-Z-t": ("P", "C"),
    "w-C-b-X-Y-Z-B-t": ("M", "B C"),
    "w-b-X-Y-Z-C-B-t": ("T", "C B"),
    "w-Y-b-X-Z-B-t": ("T", "B"),
}


def describe(chain):
    content = {**load_machine("trunnion"), "kinematic_chain": chain}
    straight = {name: content["axes"][name] for name in "XYZ"}
    turn = {"type": "rotary", "min_deg": -100.0, "max_deg": 95.0}
    names = [name for name in "ABC" if name in chain.split("-")]
    rotary = {name: {**turn, "origin_mm": ORIGINS[name]} for name in names}
    content["axes"] = straight | rotary
    return content


def draw_place(axis, rng):
    names = list_locations(axis.name)
    sizes = (0.02 if one[0] in "XYZ" else 6e-5 for one in names)
    off = [size * rng.choice([-1.0, 0.7, 1.2]) for size in sizes]
    return RotaryAxisLocation(axis, dict(zip(names, off, strict=True)))


def draw_machine(chain):
    content, rng = describe(chain), np.random.default_rng(5)
    machine = machine_from_json(content, file="machine.json")
    at, none = np.array([0.0, 200.0]), np.zeros((2, 3))
    tables = tuple(AxisTable(x, at, 0, *[none] * 4) for x in machine.linear_axes)
    places = tuple(draw_place(axis, rng) for axis in machine.rotary_axes)
    told = "c", machine, tables, ("by hand",)
    return content, CompensationTables(*told, places=places)


@pytest.fixture(scope="module", params=CHAINS)
def displaced(request):
    return request.param, *draw_machine(request.param)


def test_the_example_of_the_manual_moves_the_zero_point_as_it_says():
    b = siemens.Link(0, np.array([0.0, 1.0, 0.0]))
    table = siemens.Chain((b,), (np.zeros(3), np.array([0.0, 0.0, 15.0])))
    at, zero = np.array([[45.0], [0.0]]), np.zeros((2, 3))
    turned, straight = table.apply(at, zero)
    assert (turned - straight).round(3).tolist() == [10.607, 0.0, -4.393]


def test_the_tool_stands_where_it_should_once_the_control_has_the_vectors(displaced):
    chain, content, tables = displaced
    truth = displace(content, tables.places)
    position = spread(tables.machine, 300)
    before, after = measure_left(truth, FORMAT.write(tables), position)
    assert before.max() > 0.02
    assert after.max() < 2e-4  # products of two small turns and shifts
    letter, axes = CHAINS[chain]
    said = f'; $TC_CARR23[1] is to be "{letter}", the axes {" and ".join(axes.split())}'
    assert said in FORMAT.write(tables)[f"c{SWIVEL}"]


@pytest.mark.parametrize("chain", ["w-X-C-b-Y-Z-t", "w-b-X-Y-C-Z-t", "w-b-X-Y-Z-t"])
def test_a_machine_that_no_data_set_describes_gets_none(chain):
    _, tables = draw_machine(chain)
    assert not [name for name in FORMAT.write(tables) if name.endswith(SWIVEL)]


def write_trunnion():
    content, tables = draw_machine("w-C-A-b-X-Y-Z-t")
    text = FORMAT.write(tables)[f"c{SWIVEL}"]
    stated = FORMAT.read_locations({"c.mpf": text}, tables.machine)
    return content, tables.machine, text, stated


def set_vector(text, first, *values):
    for k, value in enumerate(values):
        text = re.sub(rf"(CARR{first + k}\[1\]=).*", rf"\g<1>{value}", text)
    return text


def test_a_file_is_read_as_a_control_would_read_it():
    _, machine, text, stated = write_trunnion()
    as_well = [
        text.replace("[1]", "[2]"),
        text.lower(),
        text.replace("=", " = ").replace("$TC", "N10 $TC"),
        text.replace("=0.010000", "=+0.010000"),
        text + "$TC_CARR4[1]=left\n",  # after the end of the program
    ]
    for one in as_well:
        assert FORMAT.read_locations({"c.mpf": one}, machine) == stated
    v2 = [2.0 * float(v) for v in re.findall(r"CARR1[012]\[1\]=(.*)", text)]
    longer = set_vector(text, 10, *(f"{v:.9f}" for v in v2))
    found = FORMAT.read_locations({"c.mpf": longer}, machine)
    assert found["AOC"] == pytest.approx(stated["AOC"], abs=1e-8)


def test_vectors_that_do_not_belong_to_the_machine_are_refused():
    content, machine, text, _ = write_trunnion()
    cases = {
        "do not close": text.replace("CARR20[1]=170", "CARR20[1]=171"),
        "row 1: .*is no": "$TC_CARR4[1]=left",
        "row 1: 'G70' is no": f"G70\n{text}",
        "wants .TC_CARR 4, 5": "$TC_CARR4[1]=0.0",
        f"{RIGHT_HANDED} about 0, 0, 1": set_vector(text, 10, "0.0", "0.0", "-1.0"),
        "v1 is not the direction of A": set_vector(text, 7, "0.0", "0.0", "0.0"),
        "states a value twice": f"$TC_CARR4[1]=1.0\n{text}",
        "or is of another data set than 3": f"$TC_CARR44[3]=1.0\n{text}",
    }
    for said, wrong in cases.items():
        assert wrong != text
        with pytest.raises(BadInput, match=said):
            FORMAT.read_locations({"c-swivel.mpf": wrong}, machine)
    _, head = draw_machine("w-Y-b-X-Z-B-t")
    with pytest.raises(BadInput, match="one swivel data set is read"):
        FORMAT.read_locations({"a.mpf": text, "b.mpf": text}, machine)
    with pytest.raises(BadInput, match="type T wants"):
        FORMAT.read_locations({"c-swivel.mpf": text}, head.machine)
    files = {"c.mpf": "$TC_CARR4[1]=0.0 G0\n$TC_CARR4[1]=1"}
    with pytest.raises(SimulatorError, match=r"row 1: .* is not understood"):
        LoadedTables(files).correct(parse_machine(content))


def test_what_was_not_measured_is_named_and_replaces_no_vector_of_the_drawing():
    machine = machine_from_json(describe("w-Y-b-X-Z-B-t"), file="machine.json")
    (axis,) = machine.rotary_axes
    place = RotaryAxisLocation(axis, {"XOB": 0.01, "ZOB": 0.02})
    lines = list(write_swivel(machine, (place,)))
    assert "; not told by the measurement: AOB, COB" in lines
    zeros = [line for line in lines if line.endswith("]=0.000000000")]
    assert zeros[-3:] == [f"$TC_CARR{k}[1]=0.000000000" for k in (10, 11, 12)]
    machine = machine_from_json(describe("w-C-A-b-X-Y-Z-t"), file="machine.json")
    a, c = machine.rotary_axes
    told = RotaryAxisLocation(a, {"YOA": 0.01})
    untold = RotaryAxisLocation(c, {"XOC": 0.01}, frozenset({"XOC"}))
    for places in ((told, RotaryAxisLocation(c, {})), (told, untold)):
        assert list(write_swivel(machine, places)) == []
        assert not FORMAT.list_written_locations(machine, places)
        assert not load_format("linuxcnc").list_written_locations(machine, places)


@pytest.mark.parametrize("name", ["linuxcnc", "siemens", "isg-csv", "json", "fanuc"])
def test_a_format_states_the_places_that_its_files_have(displaced, name):
    _, _, tables = displaced
    kind = load_format(name)
    stated = kind.list_written_locations(tables.machine, tables.places)
    files = kind.write(tables)
    read = kind.read_locations(files, tables.machine)
    assert {symbol for symbol, value in read.items() if value} == set(stated)
    if name == "siemens":  # beside both files of tables
        assert kind.read(files, tables.machine) is not None
        ends = {file.partition("-")[2] for file in files}
        assert ends == {"lec.ini", "cec.ini", "swivel.mpf"}
        every = {k: v for place in tables.places for k, v in place.location.items()}
        assert set(read) == set(every)
        for symbol, value in every.items():
            least = 1e-6 if symbol[0] in "XYZ" else 2e-9
            assert read[symbol] == pytest.approx(value, abs=least)
