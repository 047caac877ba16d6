"""LinuxCNC's own interpreter, run alone, reads our programs as the path says."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from truepath.motion.nc_programs.programs import write_program
from truepath.motion.paths.default_points import default_points
from truepath.motion.paths.verification_points import make_circle_path
from truepath.planning.default_path import default_path
from truepath_drivers.cnc.linuxcnc.program import write_program as write_path

pytestmark = pytest.mark.skipif(
    shutil.which("rs274") is None,
    reason="rs274 of Debian's linuxcnc-uspace is not installed",
)

G54 = {5221: 7.0, 5222: -11.0, 5223: 13.0, 5225: 3.0, 5226: -5.0}  # X Y Z . B C
G92 = {5211: 1.25, 5212: 2.5, 5213: -4.75}
CALL = re.compile(r"([A-Z0-9_]+)\((.*)\)$")


@pytest.fixture
def rs274(tmp_path):
    """Interpret a program; return the canonical calls as (name, arguments)."""

    def interpret(text, parameters=()):
        program, variables = tmp_path / "program.ngc", tmp_path / "rs274.var"
        program.write_text(text, encoding="ascii")
        stored = {5220: 1, **dict(parameters)}
        variables.write_text("".join(f"{n} {v}\n" for n, v in sorted(stored.items())))
        (tmp_path / "tool.tbl").write_text("")
        answer = subprocess.run(
            ["rs274", "-g", "-t", tmp_path / "tool.tbl", "-v", variables, program],
            **{"capture_output": True, "text": True, "timeout": 30, "cwd": tmp_path},
        )
        assert answer.returncode == 0, answer.stderr
        lines = (line.split(maxsplit=2)[2] for line in answer.stdout.splitlines())
        return [CALL.match(line.strip()).groups() for line in lines]

    return interpret


def numbers(arguments):
    return [float(word) for word in arguments.split(",")]


def driven(calls):
    """Return positions in machine coordinates, feeds, dwells and modes of each row."""
    planes = {"XY": [0, 1, 2], "YZ": [1, 2, 0], "XZ": [2, 0, 1]}
    plane = planes["XY"]
    g5x, g92, feed, mode, rows = np.zeros(6), np.zeros(6), 0.0, "", []
    for name, arguments in calls:
        if name == "SET_G5X_OFFSET":
            g5x = np.array(numbers(arguments)[1:])
        elif name == "SET_G92_OFFSET":
            g92 = np.array(numbers(arguments))
        elif name == "SET_FEED_RATE":
            feed = numbers(arguments)[0]
        elif name == "SET_MOTION_CONTROL_MODE":
            mode = arguments
        elif name == "STRAIGHT_FEED":
            rows.append([np.array(numbers(arguments)) + g5x + g92, feed, 0.0, mode])
        elif name == "SELECT_PLANE":
            plane = planes[arguments[-2:]]
        elif name == "ARC_FEED":
            values, end = numbers(arguments), np.zeros(6)
            end[plane] = values[0], values[1], values[5]
            rows.append([end + g5x + g92, feed, 0.0, mode])
        elif name == "DWELL":
            rows[-1][2] += numbers(arguments)[0]
    position, feeds, dwells, modes = zip(*rows, strict=True)
    return np.array(position), np.array(feeds), np.array(dwells), modes


def test_the_interpreter_drives_with_exact_stops_once_the_operator_lets_it(rs274, mill):
    path = default_path(mill, 2500.0, lines=6)
    calls = rs274(write_program(path, mill, "linuxcnc"))
    position, feed, dwell_s, modes = driven(calls)
    approach, position, feed = position[:4, :3], position[4:], feed[4:]
    x, y, z = path.position[0]
    # Z to clearance, X, Y, Z: each goes alone, from wherever the others stand.
    np.testing.assert_allclose(approach[1:, 0], x)
    np.testing.assert_allclose(approach[2:, 1], y)
    np.testing.assert_allclose(approach[:, 2], [-6.0, -6.0, -6.0, z])
    np.testing.assert_allclose(position[:, :3], path.position, atol=1e-9)
    np.testing.assert_allclose(feed, path.feed_mm_min)
    np.testing.assert_allclose(dwell_s[4:], path.dwell_s, atol=1e-4)
    assert set(modes) == {"CANON_EXACT_STOP"}
    modes_set = [m for name, m in calls if name == "SET_MOTION_CONTROL_MODE"]
    assert modes_set[-1] != "CANON_EXACT_STOP"  # what was set before is set again
    waits = {"PROGRAM_STOP", "STRAIGHT_FEED", "PROGRAM_END"}
    order = [name for name, _ in calls if name in waits]
    lines = ["STRAIGHT_FEED"] * (len(path) - 1)
    stopped = ["PROGRAM_STOP", *["STRAIGHT_FEED"] * 5, "PROGRAM_STOP"]
    assert order == [*stopped, *lines, "PROGRAM_STOP", "PROGRAM_END"]


def test_the_interpreter_turns_rotary_axes_as_the_points_say(rs274, trunnion):
    points = default_points(trunnion, count=15)
    calls = rs274(write_program(points, trunnion, "linuxcnc"))
    position, _, dwell_s, _ = (values[6:] for values in driven(calls))
    np.testing.assert_allclose(position[:, [0, 1, 2, 3, 5]], points.position, atol=1e-9)
    np.testing.assert_allclose(dwell_s, points.dwell_s)
    asked = [text for name, text in calls if name == "MESSAGE"]
    assert sum("TARGET W" in text for text in asked) == 1


def test_work_offsets_that_are_set_move_neither_lines_nor_arcs(rs274, mill):
    path, offsets = default_path(mill, 2500.0, lines=3), {**G54, 5210: 1, **G92}
    text = write_program(path, mill, "linuxcnc")
    position = driven(rs274(text, offsets))[0][4:]
    np.testing.assert_allclose(position[:, :3], path.position, atol=2e-4)
    position = driven(rs274(text.replace("G53 ", ""), offsets))[0][4:]
    shift = position[:, :3] - path.position
    np.testing.assert_allclose(shift, np.tile(shift[0], (4, 1)), atol=2e-4)
    assert np.abs(shift).min() > 8.0
    path = make_circle_path(mill)
    calls = rs274(write_path(path, ()).text, G54 | G92)
    arcs = [numbers(arguments) for name, arguments in calls if name == "ARC_FEED"]
    turned = [np.sign(arc.turn_deg) * 3 for arc in path.arc if arc is not None]
    assert [arc[4] for arc in arcs] == turned
    position, feed, _, _ = driven(calls)
    np.testing.assert_allclose(position[:, :3], path.position, atol=2e-4)
    np.testing.assert_allclose(feed, path.feed_mm_min)
