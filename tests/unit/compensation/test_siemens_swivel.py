"""A swivel data set brings the tool where it should be, on every kind of machine."""

import re

import numpy as np
import pytest

from known_machines import displace, measure_left, spread
from truepath.compensation.format import AxisTable, CompensationTables
from truepath.compensation.format_registry import load_format
from truepath.compensation.formats.siemens_swivel import SWIVEL, write_swivel
from truepath.compensation.rotary_tables import RotaryAxisLocation
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.machine.symbols import list_locations
from truepath_simulators import errors, machine_file
from truepath_simulators.compensation import loading, siemens

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
    content = {**machine_file.load_machine("trunnion"), "kinematic_chain": chain}
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
    with pytest.raises(errors.SimulatorError, match=r"row 1: .* is not understood"):
        loading.LoadedTables(files).correct(machine_file.parse_machine(content))


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
