"""Simulated controllers: what they make of tables written by hand, by public rules."""

import json

import numpy as np
import pytest

import written_tables
from truepath.compensation.format_registry import load_format
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.compensation.correction import Rules, measure_deviation_mm
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden.motion import Motion, MotionFollower
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.timeline import standing

CONTENT = load_machine("demo")
MACHINE = parse_machine(CONTENT)


def add(files, rows, direction=1.0, rules=None, content=CONTENT, ours=None):
    """What the controller adds at rows of axis positions, all axes in a direction.

    ours : format whose reader, which shares nothing with the controller, says the same
    """
    correction = LoadedTables(files, rules or Rules()).correct(parse_machine(content))
    assert correction is not None
    position = np.atleast_2d(np.array(rows, float))
    added = correction.added(position, np.full_like(position, direction))
    if ours is not None:
        machine = machine_from_json(dict(content), file="machine.json")
        read = load_format(ours).read(files, machine)(position, direction)
        np.testing.assert_allclose(read, added, atol=3e-6)
    return added


def at_x(*values):
    return [[value, 0.0, 0.0] for value in values]


def test_linuxcnc_sends_the_motor_to_nominal_less_column_by_direction():
    # As measured on LinuxCNC 2.9: 99.950 going up, 99.970 going down, ends held.
    text = "-10 -10.000 -10.000\n0 0.000 -0.010\n100 100.050 100.030\n510 510 509.98\n"
    up = add({"c-X.tbl": text}, at_x(100.0, 50.0, 600.0), ours="linuxcnc")
    np.testing.assert_allclose(up[:, 0], [-0.05, -0.025, 0.0], atol=1e-12)
    down = add({"c-X.tbl": text}, at_x(100.0, -20.0), -1.0, ours="linuxcnc")
    np.testing.assert_allclose(down[:, 0], [-0.03, 0.0], atol=1e-12)
    assert not up[:, 1:].any()


LEADSCREW = written_tables.LEADSCREW.replace("INI", "INI\nCHANDATA(1)") + "M17\n"


def test_a_positive_leadscrew_value_moves_the_axis_in_the_negative_direction():
    rows = at_x(-200.0, -50.0, 0.0, 100.0)
    added = add({"x.ini": LEADSCREW}, rows, ours="siemens-lec")
    np.testing.assert_allclose(added[:, 0], [0.0, -0.005, -0.01, -0.02])


def test_leadscrew_tables_act_on_the_measuring_system_that_is_active_on_each_axis():
    second = LEADSCREW.replace("[0,", "[1,")
    added = add({"x.ini": second}, at_x(100.0), rules=Rules(measuring_system=2))
    np.testing.assert_allclose(added[:, 0], [-0.02])
    for text, system in ((LEADSCREW, 2), (second, 1)):
        with pytest.raises(SimulatorError, match=f"measuring system {system}; a table"):
            add({"x.ini": text}, at_x(0.0), rules=Rules(measuring_system=system))
    text = LEADSCREW + LEADSCREW.replace("[0,", "[1,").replace("X1", "Y1")
    for rule in ("X=1,Y=2", "Y=2"):
        add({"x.ini": text}, at_x(0.0), rules=Rules(measuring_system=rule))
    with pytest.raises(SimulatorError, match="X1 is controlled by measuring system 2"):
        add({"x.ini": text}, at_x(0.0), rules=Rules(measuring_system="X=2,Y=2"))
    with pytest.raises(SimulatorError, match="expected 1, 2 or X=1,Y=2, not 'Y=3'"):
        add({"x.ini": text}, at_x(0.0), rules=Rules(measuring_system="Y=3"))


def cross_table(number, axis, out, values, step, extra=""):
    rows = [f"$AN_CEC[{number},{k}]={value}" for k, value in enumerate(values)]
    words = {"INPUT_AXIS": f"({axis})", "OUTPUT_AXIS": f"({out})", "STEP": step}
    words |= {"MIN": 0.0, "MAX": step * (len(values) - 1)}
    rows += [f"$AN_CEC_{word}[{number}]={value}" for word, value in words.items()]
    return "\n".join([*rows, extra, ""])


def test_a_foundation_that_sags_is_corrected_by_the_product_of_two_tables():
    # K3, page 252: ΔX1 = Z1 β(X1), table 1 of X1, table 2 linear in Z1.
    by_table_2 = "$AN_CEC_MULT_BY_TABLE[0]=2"
    turns = cross_table(0, "AX1", "AX1", [0.0, 1e-4], 500.0, by_table_2)
    text = f"%_N_NC_CEC_INI\n{turns}"
    text += cross_table(1, "AX3", "AX1", [0.0, 300.0], 300.0)
    added = add({"c.ini": text}, [[500.0, 0.0, 300.0], [250.0, 9.0, 150.0], [0, 0, 9]])
    np.testing.assert_allclose(added[:, 0], [-0.03, -0.0075, 0.0], atol=1e-12)
    assert not added[:, 1:].any()


def test_a_cross_table_corrects_one_axis_by_another_in_its_direction_alone():
    text = cross_table(0, "AX1", "AX2", [0.0, 0.01], 100.0)
    added = add({"c.ini": text}, at_x(50.0), ours="siemens-cec")
    np.testing.assert_allclose(added, [[0.0, -0.005, 0.0]])
    text += "$AN_CEC_DIRECTION[0]=-1\n"
    assert add({"c.ini": text}, at_x(100.0))[0, 1] == 0.0
    assert add({"c.ini": text}, at_x(100.0), -1.0)[0, 1] == pytest.approx(-0.01)


TABLE = """BEGIN X .COM MM
NR AXISPOS BACKLASH X Y
0 +0.0000 +0.003 +0.001 +0.0
1 +100.0 +0.003 +0.002 -0.01
[END]
"""
ACTIVE = "BEGIN config .CMA MM\nNR ACTIVE X\n0 * x.com\n1 - other.com\n[END]\n"


@pytest.mark.parametrize(("read", "back"), [("negative-value", 3), ("difference", 5)])
def test_the_backlash_column_is_read_as_the_option_says(read, back):
    files, rules = {"x.com": TABLE, "config.cma": ACTIVE}, Rules(read)
    up, down = (add(files, at_x(100.0, 50.0), side, rules) for side in (1.0, -1.0))
    assert up[0, 0] == pytest.approx(-0.002)
    assert down[0, 0] == pytest.approx(-1e-3 * back)
    np.testing.assert_allclose(up[:, 1], [0.01, 0.005])
    np.testing.assert_allclose(down[:, 1], up[:, 1])


def fanuc(values, first, reference, words="", magnification=1):
    """Tapes by which X errs by these increments, Y and Z by none."""
    last = first + len(values) - 1
    data = "\n".join(
        f"N{10000 + 100 * axis + first + k}P{0 if axis else value}"
        for axis in range(3)
        for k, value in enumerate(values)
    )
    numbers = {3620: reference, 3621: first, 3622: last}
    rows = (f"N0{n}A1P{v}A2P{100 + v}A3P{200 + v}" for n, v in numbers.items())
    parameters = "\n".join([*rows, ""])
    parameters += f"N03623A1P{magnification}A2P1A3P1\nN03624A1P50.A2P50.A3P50.\n{words}"
    return {"c-pitch.txt": f"%\n{data}\n%\n", "c-parameters.txt": f"%\n{parameters}%\n"}


def test_fanuc_increments_sum_up_from_the_reference_point():
    # B-63980EN, page 100: points 33 to 48 over -400 to 400 mm, 40 the reference.
    values = [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1]
    content = load_machine("demo")
    content["axes"]["X"] |= {"min_mm": -400.0, "max_mm": 400.0}
    rows = at_x(-400, -350, -50, 0, 20, 30, 50, 100, 400)
    added = add(fanuc(values, 33, 40), rows, content=content, ours="fanuc")
    summed = [0, 2, 1, 0, 0, 2, 2, 3, 0]
    np.testing.assert_allclose(1e3 * added[:, 0], summed, atol=1e-9)
    magnified = fanuc(values, 33, 40, magnification=2)
    doubled = add(magnified, rows, content=content, ours="fanuc")
    np.testing.assert_allclose(doubled, 2.0 * added, atol=1e-9)


def test_fanuc_tables_of_both_directions_have_their_own_value_at_the_reference():
    files = fanuc([1, 1], 5, 4, "N03605A1P00000001\nN03626A1P20\nN03627A1P-6\n")
    points = "%\nN10020P2\nN10021P0\n"
    files["c-pitch.txt"] = files["c-pitch.txt"].replace("%\n", points, 1)
    up, down = (1e3 * add(files, at_x(0, 50, 100), d)[:, 0] for d in (1.0, -1.0))
    np.testing.assert_allclose(up, [0, 1, 2], atol=1e-9)
    np.testing.assert_allclose(down, [-6, -4, -4], atol=1e-9)


def test_isg_takes_away_what_the_chain_makes_of_error_motions():
    text = """// by hand
C0Y
0.0001
#
X  EXX  EYX  EZX  EAX  EBX  ECX
0  0 0 0 0 0 0
100 0.01 0 0 0 0.0001 0
#
Z  X  EZX
0   0 0
0 100 0
300 0 0
300 100 0.006
"""
    rows = [[100, 0, 0], [100, 0, 300], [50, 0, 150], [0, 200, 0]]
    # Lever arm of EBX is Z; C0Y turns Y about Z; EZX grows with Z.
    expected = [[-0.01, 0, 0], [-0.04, 0, -0.006], [-0.0125, 0, -0.0015], [0.02, 0, 0]]
    np.testing.assert_allclose(add({"v.csv": text}, rows), expected, atol=3e-6)
    plain = text.partition("#\n")[2].partition("#\n")[0]
    assert add({"v.csv": plain}, [50, 0, 150], ours="isg-csv")[0, 0] < -0.01


def test_an_etalon_file_is_taken_as_the_same_parameters_of_an_isg_file():
    text = """// by hand
[C0Y]
VALUE = 0.0001
[EXX]
Gridpoints = {
   0.0 0
   100.0 0.01
}  // end of EXX
[EBX]
Gridpoints = {
   0 0
   100 0.0001  // rad
}
"""
    rows = [[100, 0, 0], [100, 0, 300], [0, 200, 0]]
    expected = [[-0.01, 0, 0], [-0.04, 0, 0], [0.02, 0, 0]]
    np.testing.assert_allclose(add({"v.txt": text}, rows), expected, atol=3e-6)


PLAIN_ROWS = [
    ["X", "+", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ["X", "+", 100.0, 10.0, 4.0, 0.0, 0.0, 20.0, 0.0],
    ["X", "-", 0.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ["X", "-", 100.0, 7.0, 4.0, 0.0, 0.0, 20.0, 0.0],
]


@pytest.mark.parametrize("form", ["csv", "json"])
def test_a_plain_table_takes_shift_and_turn_times_lever_away_by_direction(form):
    assert MACHINE.workpiece_side == ("X",)  # Y and Z are nearer to the tool
    motions = ["x_um", "y_um", "z_um", "a_urad", "b_urad", "c_urad"]
    names = ["axis", "direction", "position_mm", *motions]
    content = {"schema": "compensation-tables/1", "columns": names, "rows": PLAIN_ROWS}
    lines = [",".join(str(cell) for cell in row) for row in (names, *PLAIN_ROWS)]
    written = {
        "json": {"t.json": json.dumps(content, indent=1)},
        "csv": {"t.csv": "\n".join(["# by hand", *lines, ""])},
    }
    files = written[form]
    up = add(files, [[50.0, 30.0, 200.0], [150.0, 0.0, 0.0]], ours=form)
    # B = 10 µrad times Z = 200 mm is 2 µm along X; end values hold beyond the rows.
    np.testing.assert_allclose(up, [[-0.007, -0.002, 0.0], [-0.01, -0.004, 0.0]])
    down = add(files, [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]], -1.0, ours=form)
    np.testing.assert_allclose(down, [[0.003, 0.0, 0.0], [-0.007, -0.004, 0.0]])


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"v.txt": "[EXX]\nVALUE = one\n"}, "row 2"),
        ({"v.txt": "[EXX]\nGridpoints = {\n0 0\n"}, "no end"),
        ({"v.txt": "[EXW]\nGridpoints = {\n0 0\n}\n"}, "no error motion"),
        ({"c-X.tbl": "0 0 0\n1 1 1\nhead\n"}, "row 3"),
        ({"c-W.tbl": "0 0 0\n1 1 1\n"}, "does not end in an axis"),
        ({"x.ini": "$AA_ENC_COMP[0,0,X1]=0\n$AA_ENC_COMP_OOPS\n"}, "row 2"),
        ({"x.ini": "$AA_ENC_COMP[0,0,X1]=0\n"}, "lacks"),
        ({"x.com": TABLE}, "one .cma file"),
        ({"x.com": TABLE, "a.cma": ACTIVE, "l-X.tbl": "0 0 0\n1 1 1\n"}, "one form"),
        ({"v.csv": "X EXX\n0 0\n1 1 1\n"}, "no table"),
        ({"v.csv": "Z X EXX\n0 0 0\n1 1 0\n"}, "70471"),
        ({"letter.txt": "Dear controller\n"}, "no simulated controller"),
    ],
)
def test_tables_that_cannot_be_used_are_refused_by_name(files, said):
    with pytest.raises(SimulatorError, match=said):
        add(files, at_x(0.0))


def test_the_machine_errs_less_with_its_own_error_taken_away():
    truth = random_machine(MACHINE, 4)
    x = np.linspace(0.0, 500.0, 51)
    rows = np.array([[value, 200.0, 150.0] for value in x])
    error = truth.deviation_mm(rows)[:, 0]
    shown = zip(x, x + error, strict=True)
    text = "".join(f"{a:.4f} {b:.6f} {b:.6f}\n" for a, b in shown)
    tables = LoadedTables({"c-X.tbl": text}).correct(MACHINE)
    left = measure_deviation_mm(truth, tables, rows)
    assert np.abs(left[:, 0]).max() < 1e-4 < 0.002 < np.ptp(error)
    np.testing.assert_allclose(left[:, 1:], truth.deviation_mm(rows)[:, 1:], atol=1e-5)
    reversed_sign = LoadedTables({"c-X.tbl": text}, Rules(reversed_sign=True))
    twice = measure_deviation_mm(truth, reversed_sign.correct(MACHINE), rows)
    np.testing.assert_allclose(twice[:, 0], 2.0 * error, atol=1e-4)


def test_a_direction_is_kept_while_an_axis_stands_and_across_motions():
    x = np.array([[100.0, 0.0, 0.0], [50.0, 0.0, 0.0], [50.0, 80.0, 0.0]])
    program = Program(x, np.full(3, 50.0), np.full(3, 1.0))
    timeline = make_program_timeline(program, np.zeros(3), 0.0, Limits())
    motion = Motion(MACHINE, timeline)
    at = timeline.start_s[np.flatnonzero(np.diff(timeline.row))] + 0.5
    headings = motion.headings(np.array([*at, timeline.end_s]))
    assert headings.tolist() == [[1, 0, 0], [-1, 0, 0], [-1, 1, 0]]
    text = "0 0 -0.01\n500 500 499.99\n"  # 10 µm of lost motion coming down
    follower = MotionFollower(MACHINE, remembers=False)
    follower.correct(LoadedTables({"c-X.tbl": text}).correct(MACHINE))
    follower.follow(timeline)
    later = follower.follow(standing(x[-1], 1e6, 1))
    there = later.corrected_positions(np.array([2e6]))[0]
    np.testing.assert_allclose(there, [50.01, 80.0, 0.0])
