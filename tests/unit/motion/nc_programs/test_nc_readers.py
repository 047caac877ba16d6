"""Programs written by hand: what readers make of them, and what controls drive."""

import re
from pathlib import Path

import numpy as np
import pytest

from nc_controls import RUN, Alarm, run_fanuc
from paths_by_hand import path_of
from truepath.errors import PlanningError
from truepath.motion.nc_programs.programs import read_program, write_program
from truepath.motion.paths.verification_points import make_circle_path

PROGRAMS = Path(__file__).parent / "by_hand"
BY_HAND = {file.stem: file.read_text() for file in sorted(PROGRAMS.iterdir())}
every_program = pytest.mark.parametrize("dialect", BY_HAND)


@every_program
def test_a_program_by_hand_is_read_as_its_control_would_drive_it(dialect):
    motion = read_program(BY_HAND[dialect], dialect)
    assert motion.axes == ("X", "Y", "Z", "C")
    rows = [10, 20.5, -30, 0], [100.25, 20.5, -30, 0], [100.25, 20.5, -30, 90]
    np.testing.assert_allclose(motion.position, [*rows, [0, 20.5, -30, 0]], atol=1e-12)
    # The last line: 300 mm/min of X are 403.16 of X and C, a degree as a millimetre.
    np.testing.assert_allclose(motion.feed_mm_min, [6000, 6000, 1800, 300], rtol=1e-4)
    np.testing.assert_allclose(motion.dwell_s, [1.5, 0.5, 0, 0])
    assert motion.exact_stop.tolist() == [True, True, False, False]
    assert motion.row.tolist() == [1, 2, 3, 4]
    assert motion.name == ("O1234" if dialect == "fanuc" else "BY_HAND")
    assert (motion.stated_checksum, motion.path.axes) == ("0123456789AB", motion.axes)


WRONG = [
    ("siemens-840d", "N2 G1 SUPA", "N2 G1", "line 13.*work offset; SUPA is needed"),
    ("linuxcnc", "N2 G53 G01", "N2 G01", "line 9.*work offset; G53 is needed"),
    ("heidenhain", "X+100.25 R0 M91", "X+100.25 R0", "line 7.*R0, M91"),
    ("fanuc", "#5022-#5042", "#5021-#5041", "line 12.*offset is not checked"),
    ("fanuc", "#5023-#5043", "#5023-#5042", "line 10.*different axes"),
    ("siemens-840d", " D0", "", "line 9.*the tool offset is not set; D0"),
    ("siemens-840d", " D0", " D1", "line 9.*the tool offset is D1; D0"),
    ("siemens-840d", "G710", "G700", "the unit is G700; G710 is needed"),
    ("siemens-840d", " G90", " G91", "the dimension is G91"),
    ("siemens-840d", "TRAFOOF\n", "", "the transformation is not set"),
    ("siemens-840d", "TRAFOOF", "TRAORI", "the transformation is TRAORI"),
    ("siemens-840d", "TRANS", "TRANS X5", "cannot be read|first motion|without G1"),
    ("siemens-840d", "G94", "G95", "the feed is G95"),
    ("siemens-840d", "FGROUP(C)", "FGROUP(X)", "line 17.*FGROUP.X., which does not"),
    ("siemens-840d", "G01 SUPA", "G02 SUPA", "line 9.*a circle needs two of I, J"),
    ("siemens-840d", "G01 SUPA", "G02 SUPA I5 J0", "line 9.*without a place where it"),
    ("siemens-840d", "G1 SUPA X100.25", "G2 SUPA X0 I5 J0", "13.*does not lead to its"),
    ("siemens-840d", "G1 SUPA X100.25", "G2 SUPA X0 I-5 K0", "the plane is G17; G18"),
    ("heidenhain", "L X+100.25 R0 M91", "C IX+1. IY+0. DR+ R0", "line 7.*without CC"),
    ("heidenhain", "L X+100.25 R0 M91", "CC X+1. Y+0.", "line 7.*no place in a"),
    ("fanuc", "N3 G1", "G#1\nN3 G1", "the unit is G20; G21"),
    ("linuxcnc", "N2 G53 G01", "N2 G2", "line 9.*G2 has no place"),
    ("heidenhain", "PGM BY_HAND MM", "PGM BY_HAND INCH", "line 1.*INCH; MM is needed"),
    ("heidenhain", " R0 M91 ; ROW 2", " RL M91", "line 7.*R0, M91"),
    ("heidenhain", "9 L C+90.0", "9 L C90.0", "line 10.*signed"),
    ("heidenhain", "9 L C+90.0", "9 L Q+90.0", "line 10.*Q is no axis"),
    ("heidenhain", "9 L C", "8 L C", "line 10.*does not begin with block number 9"),
    ("heidenhain", "11 M30", "11 M3", "line 12.*'M3' has no place"),
    ("heidenhain", "12 END PGM BY_HAND", "12 END PGM HANDY", "line 13.*does not fit"),
    ("heidenhain", "0 BEGIN PGM BY_HAND MM", "0 ; NOTHING", "BEGIN PGM|does not fit"),
    ("fanuc", "G21", "G20", "the unit is G20"),
    ("fanuc", " G49", "", "the tool length is not set"),
    ("fanuc", " G49", " G43", "the tool length is G43"),
    ("fanuc", " G54", " G55", "the work offset is G55"),
    ("fanuc", "G04 X1.5", "G04 P1.5", "line 14.*P in milliseconds"),
    ("fanuc", "O1234", "O0", "line 2.*O-number"),
    ("fanuc", "M30\n", "", "line 0.*M30"),
    ("fanuc", "%\nO1234", "O1234", "line 1.*two lines of %"),
    ("fanuc", "N2 G1", "N2 G0", "line 15.*G0 has no place"),
    ("fanuc", "N2 G1", "N2", "line 15.*without G1"),
    ("linuxcnc", "g80", "g81", "the cycle is G81"),
    ("linuxcnc", "g90", "", "the dimension is not set"),
    ("linuxcnc", "G4 P1.5", "G4 X1.5", "line 8.*a dwell of -1"),
    ("linuxcnc", "N2 G53 G01", "N2 G53", "line 9.*without G1"),
    ("linuxcnc", "C90", "B90", "line 12.*B moves first here"),
    ("linuxcnc", "F6000", "", "line 5.*without a feed"),
    ("linuxcnc", "M2\n", "", "line 0.*M2|cannot be read"),
    ("linuxcnc", "X10 Y", "X1O Y", "line 5.*cannot be read"),
    ("siemens-840d", "M30\n", "", "line 0.*M30"),
    ("siemens-840d", "M30\n", "M30\nG90\n", "line 22.*a block after M30"),
    ("siemens-840d", "N2 G1", "N2 ", "line 13.*without G1"),
]


@pytest.mark.parametrize(("dialect", "old", "new", "message"), WRONG)
@pytest.mark.fault_row(24)
def test_what_a_measuring_path_must_not_have_is_refused_by_line(
    dialect, old, new, message
):
    assert old in BY_HAND[dialect]
    with pytest.raises(PlanningError, match=message):
        read_program(BY_HAND[dialect].replace(old, new), dialect)


def test_a_fanuc_integer_counts_micrometres_and_no_dwell_is_no_exact_stop_of_tnc():
    motion = read_program(BY_HAND["fanuc"].replace("X100.25", "X100"), "fanuc")
    assert motion.position[1, 0] == pytest.approx(0.1)
    text = BY_HAND["heidenhain"].replace("DWELL 0.5", "DWELL 0.0")
    stops = read_program(text, "heidenhain").exact_stop
    assert stops.tolist() == [True, False, False, False]


EMPTY = {
    "siemens-840d": "M30\n",
    "heidenhain": "0 BEGIN PGM A MM\n1 END PGM A MM\n",
    "fanuc": "%\nO1\nM30\n%\n",
    "linuxcnc": "M2\n",
}


@every_program
def test_text_that_is_no_program_or_moves_nothing_is_refused(dialect):
    with pytest.raises(PlanningError, match="moves no axis"):
        read_program(EMPTY[dialect], dialect)
    for text in ("", "hello\n", "<html></html>"):
        with pytest.raises(PlanningError):
            read_program(text, dialect)


@every_program
def test_line_ends_of_other_systems_change_nothing(dialect):
    text = BY_HAND[dialect]
    motion = read_program(text.replace("\n", "\r\n"), dialect)
    np.testing.assert_array_equal(motion.position, read_program(text, dialect).position)


LINES = path_of((10, 10, -10), (400.5, 10, -10), (400.5, 300, -250), dwell_s=0.5)
every_control = pytest.mark.parametrize("dialect", RUN)


@pytest.fixture(scope="module")
def circles(mill):
    return make_circle_path(mill)


@every_control
def test_a_control_drives_the_rows_and_asks_before_between_and_after(dialect, mill):
    control = RUN[dialect](write_program(LINES, mill, dialect, "P"))
    assert "ONE BY ONE" in control.first_words
    assert control.ended
    driven = control.recorded()
    np.testing.assert_allclose(driven.position, LINES.position, atol=6e-4)
    np.testing.assert_allclose(driven.dwell_s, LINES.dwell_s, atol=1e-9)
    np.testing.assert_allclose(driven.feed_mm_s[1:], LINES.feed_mm_min[1:] / 60.0)
    before = {"X": 1.0, "Y": 2.0, "Z": -3.0}
    for move in control.approach()[:-1]:
        assert sum(move.end[name] != at for name, at in before.items()) <= 1
        before = move.end


@every_control
def test_circles_in_motion_are_driven_without_a_stop_on_them(dialect, mill, circles):
    text = write_program(circles, mill, dialect, "P")
    driven = RUN[dialect](text).recorded()
    assert len(driven) == len(circles)
    np.testing.assert_allclose(driven.position, circles.position, atol=6e-4)
    np.testing.assert_allclose(driven.feed_mm_s[1:], circles.feed_mm_min[1:] / 60.0)
    for row, (arc, planned) in enumerate(zip(driven.arc, circles.arc, strict=True)):
        assert (arc is None) == (planned is None), row
        if arc is not None:
            assert "".join("XYZ"[c] for c in arc.columns) == planned.axes
            np.testing.assert_allclose(arc.centre_mm, planned.centre_mm, atol=2e-3)
            turned = np.degrees(arc.turn_rad)
            assert turned == pytest.approx(planned.turn_deg, abs=2e-3)
    # What our reader takes from it is the same path.
    read = read_program(text, dialect).path
    turns = [arc and (arc.axes, round(arc.turn_deg, 2)) for arc in read.arc]
    assert turns == [arc and (arc.axes, arc.turn_deg) for arc in circles.arc]


@pytest.mark.parametrize("unit", ["20", "21"])
def test_fanuc_has_the_unit_afterwards_that_it_had_before(unit, mill):
    text = write_program(LINES, mill, "fanuc", "P")
    control = run_fanuc(text, unit)
    assert control.unit == unit
    np.testing.assert_allclose(control.recorded().position, LINES.position, atol=6e-4)
    # Begun in the middle, nothing was kept: then the block does nothing.
    assert run_fanuc(re.sub(r"N1 #1=#4006\n", "", text), "20").unit == "21"


def test_offsets_that_were_left_move_nothing(mill, circles):
    for path in (LINES, circles):
        texts = {name: write_program(path, mill, name, "P") for name in RUN}
        for name in ("siemens-840d", "heidenhain"):
            run = RUN[name]
            runs = run(texts[name]), run(texts[name], (5.0, -7.0, 11.0))
            still, shifted = (one.recorded().position.tolist() for one in runs)
            assert still == shifted
        with pytest.raises(Alarm, match="an axis has an offset"):
            run_fanuc(texts["fanuc"], offset=(0.0, 0.01, 0.0))
