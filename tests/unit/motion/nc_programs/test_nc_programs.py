"""A path and its program are the same motion, for every control that is installed."""

import re
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import paths_by_hand
from truepath import plugins
from truepath.errors import BadInput, OutOfTravel, PlanningError
from truepath.kinematics.machine.machine import Approach
from truepath.motion.configurations import Configurations
from truepath.motion.nc_programs.fanuc import Fanuc
from truepath.motion.nc_programs.gcode import LinuxCnc
from truepath.motion.nc_programs.programmed_motion import compute_checksum
from truepath.motion.nc_programs.programs import (
    GROUP,
    list_dialects,
    name_file,
    read_program,
    write_program,
)
from truepath.motion.paths.default_points import default_points

OURS = ("fanuc", "heidenhain", "linuxcnc", "siemens-840d")

every_dialect = pytest.mark.parametrize("dialect", OURS)
path_of = partial(paths_by_hand.path_of, feed=3000.0, dwell_s=0.5)
L_SHAPE = path_of((10, 10, -10), (400.5, 10, -10), (400.5, 300, -250))


@st.composite
def paths(draw, machine):
    """Draw rows inside the travel; axes often stay where they are."""
    n, axes = draw(st.integers(1, 8)), machine.axes
    inside = st.tuples(*(st.floats(axis.low, axis.high) for axis in axes))
    kept = st.lists(st.booleans(), min_size=len(axes), max_size=len(axes))
    position = [np.array(draw(inside))]
    for _ in range(n - 1):
        position.append(np.where(draw(kept), position[-1], draw(inside)))
    feed = draw(st.lists(st.floats(1, 30_000), min_size=n, max_size=n))
    dwell_s = draw(st.lists(st.floats(0, 60), min_size=n, max_size=n))
    return path_of(*position, feed=feed, dwell_s=dwell_s, axes=machine.axis_names)


def largest_feed(path, motion, dialect):
    """Of the linear axes, where degrees count as millimetres and F has a limit."""
    if dialect not in ("fanuc", "heidenhain"):
        return np.full(len(path), np.inf)
    move = np.diff(motion.position, axis=0)
    straight = np.linalg.norm(move[:, :3], axis=1)
    whole = np.linalg.norm(move, axis=1)
    moves = straight > 0
    share = np.ones(len(path))
    share[1:][moves] = straight[moves] / whole[moves]
    return 99_999 * share


@every_dialect
@pytest.mark.parametrize("axes", [3, 5])
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_program_moves_the_axes_as_the_path_says(dialect, mill, trunnion, axes, data):
    machine = mill if axes == 3 else trunnion
    path = data.draw(paths(machine))
    text = write_program(path, machine, dialect, "P")
    motion = read_program(text, dialect)
    half = 0.5 * 10.0 ** -{"fanuc": 3}.get(dialect, 4)
    assert motion.axes == path.axes
    np.testing.assert_allclose(motion.position, path.position, rtol=0, atol=1.01 * half)
    feed = np.minimum(path.feed_mm_min, largest_feed(path, motion, dialect))
    np.testing.assert_allclose(motion.feed_mm_min, feed, rtol=1e-3, atol=1e-3)
    stated = [float(f) for f in re.findall(r" F(\d+\.\d{3})", text)]
    assert max(stated) <= 99_999
    stood = np.maximum(path.dwell_s, {"heidenhain": 0.1}.get(dialect, 0.0))
    np.testing.assert_allclose(motion.dwell_s, stood, rtol=0, atol=5.1e-4)
    np.testing.assert_array_equal(motion.path.position, motion.position)
    assert motion.exact_stop.all()
    assert motion.row.tolist() == list(range(1, len(path) + 1))


@pytest.mark.parametrize("dialect", ["fanuc", "heidenhain"])
def test_much_turning_on_a_short_line_keeps_f_within_its_limit(dialect, trunnion):
    rows = (10, 10, -10, 0, 0), (10.01, 10, -10, -20, 180)
    path = path_of(*rows, feed=6000.0, axes=trunnion.axis_names)
    text = write_program(path, trunnion, dialect, "P")
    assert " F99999.000" in text
    assert read_program(text, dialect).feed_mm_min[1] == pytest.approx(5.52, 1e-3)


@every_dialect
def test_standstill_points_are_approached_at_the_feed_that_is_asked(dialect, trunnion):
    points = default_points(trunnion, count=12)
    text = write_program(points, trunnion, dialect, "P", feed_mm_min=2500.0)
    motion = read_program(text, dialect)
    np.testing.assert_allclose(motion.feed_mm_min, 2500.0, rtol=1e-3)
    np.testing.assert_allclose(motion.position, points.position, atol=6e-4)
    np.testing.assert_allclose(motion.dwell_s, points.dwell_s)


@every_dialect
def test_the_axes_stand_before_a_target_is_changed(dialect, trunnion):
    rows = (10, 10, -10, 0, 0), (20, 10, -10, 0, 90), (30, 10, -10, -20, 180)
    path = path_of(*rows, axes=trunnion.axis_names, target=("T", "T", "W"))
    lines = write_program(path, trunnion, dialect, "P").splitlines()
    asked = next(n for n, line in enumerate(lines) if "ON TARGET W" in line)
    third = next(n for n, line in enumerate(lines) if "30.000" in line)
    second = next(n for n, line in enumerate(lines) if "20.000" in line)
    stop = "STOP" if dialect == "heidenhain" else "M0"
    assert second < asked < third
    assert lines[asked + 1].split()[-1] == stop
    halts = [line for line in lines if line.split()[-1] == stop]
    assert len(halts) == 4  # way free, recording, target, end


def drive_to_first_row(text, dialect):
    approach = read_program(text, dialect).approach
    return [(dict(motion.ends), motion.feed_mm_min) for motion in approach]


@every_dialect
def test_the_first_row_is_reached_axis_by_axis(dialect, mill, trunnion):
    rows = (10, 20, -290, -30, 90), (20, 20, -290, -30, 90)
    path = path_of(*rows, axes=trunnion.axis_names)
    text = write_program(path, trunnion, dialect, "P")
    ends = {"Z": -6.0}, {"X": 10}, {"Y": 20}, {"A": -30}, {"C": 90}, {"Z": -290}
    assert drive_to_first_row(text, dialect) == [(end, 2000.0) for end in ends]
    np.testing.assert_array_equal(read_program(text, dialect).position, rows)
    said = " ".join(re.sub(r"^[\d ]*[;(] ?|\)$", "", s) for s in text.splitlines())
    assert "BY Z TO -6, X TO 10, Y TO 20, A TO -30, C TO 90, Z TO -290 AT 2000" in said
    side = Approach((("Y", 390.0), ("Z", -1.0)), ("Z", "X", "Y"), 500.0)
    text = write_program(L_SHAPE, replace(mill, approach=side), dialect, "P")
    ends = {"Y": 390}, {"Z": -1}, {"Z": -10}, {"X": 10}, {"Y": 10}
    assert drive_to_first_row(text, dialect) == [(end, 500.0) for end in ends]
    flat = path_of(*L_SHAPE.position[:, :2], axes="XY")
    with pytest.raises(PlanningError, match="does not state Z"):
        write_program(flat, mill, dialect, "P")


CYCLE = "CYCL DEF 32.0 TOLERANCE"
SMOOTHING = {
    "fanuc": (["/G5.1 Q0", "G61"], ["G64", "G#1", "M30"]),
    "heidenhain": ([CYCLE, "CYCL DEF 32.1 T0.002"], [CYCLE, "CYCL DEF 32.1", "M30"]),
    "linuxcnc": (["M70", "G61.1"], ["M72", "M2"]),
    "siemens-840d": (["COMPOF", "G60 G601"], ["G64", "M30"]),
}


@every_dialect
def test_nothing_is_smoothed_and_blocks_and_rows_are_numbered(dialect, mill):
    lines = write_program(L_SHAPE, mill, dialect, "P").splitlines()
    blocks = [re.sub(r"^N?\d+ ", "", line) for line in lines]
    begin, end = SMOOTHING[dialect]
    moves = [n for n, s in enumerate(blocks) if re.search(r"[XYZ][+-]?\d+\.\d", s)]
    assert set(begin) <= set(blocks[: moves[0]])
    # The operator ends the recording before the modes change.
    last = blocks.index(end[-1])
    stop = "STOP" if dialect == "heidenhain" else "M0"
    assert blocks[last - len(end) : last + 1] == [stop, *end]
    assert moves[-1] < last - len(end)
    if dialect != "heidenhain":
        lines = [s for s in lines if not re.match(r"[;(%O]", s)]
    numbers = [int(re.match(r"N?(\d+) ", line).group(1)) for line in lines]
    assert numbers == list(range(numbers[0], numbers[0] + len(lines)))
    rows = [re.search(r"ROW (\d)\)?$", s) for s in lines if "400.5" in s and "F" in s]
    assert [int(row.group(1)) for row in rows if row] == [2, 3]


FILES = {
    "fanuc": r"O[0-7]\d{3}\.nc",
    "heidenhain": r"WEEKLY_CHECK\.h",
    "linuxcnc": r"WEEKLY_CHECK\.ngc",
    "siemens-840d": r"WEEKLY_CHECK\.mpf",
}


@every_dialect
def test_the_file_has_its_name_and_a_header_of_what_it_does(dialect, mill):
    text = write_program(L_SHAPE, mill, dialect, "weekly check")
    assert re.fullmatch(FILES[dialect], name_file(text, dialect))
    header = " ".join(re.sub(r"^[\d ]*[;(]|\)$", "", s) for s in text.splitlines()[:24])
    header = re.sub(r"\s+", " ", header)
    assert "MACHINE SMALL MILL, W-X-B-Y-Z-T" in header
    assert "X USES 10 TO 400.5 OF 0 TO 500 MM" in header
    assert "Z USES -250 TO -10 OF -300 TO 0 MM" in header
    # 390.5 mm and 376.4 mm at 50 mm/s, two ramps of 50 ms each, three dwells.
    assert "EXPECTED TIME 0 MIN 17 S" in header
    assert f"PATH CHECKSUM {compute_checksum(L_SHAPE.axes, L_SHAPE.position)}" in header
    assert "ROUNDED" not in text
    # Rows are rounded to what the control takes, and the header says so.
    finer = path_of((10, 10, -10), (100.12344, 10, -10))
    lost = {"fanuc": "0.0004"}.get(dialect, "0.0000")
    text = write_program(finer, mill, dialect, "P")
    assert f"POSITIONS ARE ROUNDED, BY AT MOST {lost}" in text


def test_the_checksum_is_one_of_positions_on_all_controls_and_finds_an_edited_row(mill):
    texts = {name: write_program(L_SHAPE, mill, name, "P") for name in OURS}
    motions = {name: read_program(text, name) for name, text in texts.items()}
    (stated,) = {m.stated_checksum for m in motions.values()}
    assert stated == compute_checksum(L_SHAPE.axes, L_SHAPE.position)
    assert {m.checksum for m in motions.values()} == {stated}
    for name, text in texts.items():
        edited = read_program(text.replace("400.5", "400.4"), name)
        assert edited.stated_checksum == stated
        assert edited.checksum != stated
    slow = replace(L_SHAPE, feed_mm_min=np.full(3, 50.0), dwell_s=np.ones(3))
    text = write_program(slow, mill, "linuxcnc", "P")
    assert read_program(text, "linuxcnc").checksum == stated


@every_dialect
def test_lines_are_short_and_plain_on_long_programs(dialect, trunnion):
    rng = np.random.default_rng(1)
    low = np.array([axis.low for axis in trunnion.axes])
    high = np.array([axis.high for axis in trunnion.axes])
    n = 1000
    feeds, dwells_s = rng.uniform(1, 30_000, n), rng.uniform(0, 10, n)
    rows = rng.uniform(low, high, (n, 5))
    path = path_of(*rows, feed=feeds, dwell_s=dwells_s, axes=trunnion.axis_names)
    text = write_program(path, trunnion, dialect, "a long name of a long program")
    lines = text.splitlines()
    assert text.isascii()
    assert text.endswith("\n")
    assert text == text.upper()
    assert max(map(len, lines)) <= 100
    assert max(len(s) for s in lines if not re.search("X[-+]?[0-9]", s)) <= 80
    assert len(read_program(text, dialect)) == n


@every_dialect
@settings(max_examples=40, deadline=None)
@given(name=st.text(max_size=40), machine_name=st.text(max_size=200))
@example(name="", machine_name="MA")
def test_no_name_can_bring_a_block_into_the_program(dialect, mill, name, machine_name):
    odd = replace(mill, name=machine_name)
    plain = read_program(write_program(L_SHAPE, mill, dialect, "P"), dialect)
    text = write_program(L_SHAPE, odd, dialect, name)
    motion = read_program(text, dialect)
    np.testing.assert_array_equal(motion.position, plain.position)
    assert text.isascii()
    assert re.fullmatch(r"[A-Z]{2}[A-Z0-9_]{0,14}|O\d{4}", motion.name)
    comment = re.compile(r"\([^()]*\)|;[^;]*$|MSG\(\"[^\"]*\"\)")
    # `BEGIN PGM MA MM` names a program; MA is no M word there.
    nameless = text.replace(f" PGM {motion.name} ", " PGM ")
    blocks = [comment.sub("", line).strip() for line in nameless.splitlines()]
    assert not [b for b in blocks if re.search(r"\bM(?!0$|2$|30$|91$|70$|72$|M$)", b)]


@every_dialect
def test_a_row_out_of_travel_is_refused_even_by_a_thousandth(dialect, mill):
    write_program(path_of((10, 10, -10), (500.0, 10, -10)), mill, dialect, "P")
    for x, said in ((612.4, r"612.4 mm exceeds"), (500.00095, r"500.001\d? mm is out")):
        with pytest.raises(OutOfTravel, match=f"row 2: X = {said}"):
            write_program(path_of((10, 10, -10), (x, 10, -10)), mill, dialect, "P")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"feed_mm_min": np.array([100.0, 0, 100])}, r"row 2: feed_mm_min is 0; give"),
        ({"feed_mm_min": np.array([100.0, np.nan, 1])}, r"row 2: feed_mm_min is nan"),
        ({"feed_mm_min": np.array([1e6, 100, 100])}, r"row 1: feed_mm_min is 1e\+06"),
        ({"dwell_s": np.array([0, 0, -1.0])}, r"row 3: dwell_s is -1; .*dwells 0 to"),
        ({"dwell_s": np.array([0, 9e4, 0.0])}, r"row 2: dwell_s is 90000; "),
    ],
)
@every_dialect
def test_what_no_program_can_say_is_refused_by_row(dialect, mill, change, message):
    with pytest.raises(PlanningError, match=message):
        write_program(replace(L_SHAPE, **change), mill, dialect, "P")


def test_what_a_machine_a_control_an_installation_or_an_order_lacks_is_named(mill):
    text = write_program(L_SHAPE, mill, "heidenhain")
    assert text.startswith("0 BEGIN PGM SMALL_MILL MM\n")
    shorter = replace(L_SHAPE, position=L_SHAPE.position * 0.5)
    texts = [write_program(path, mill, "fanuc", "P") for path in (L_SHAPE, shorter)]
    assert len({read_program(text, "fanuc").name for text in texts}) == 2
    long = path_of(*np.tile(L_SHAPE.position, (11_001, 1)))
    said = "33003 rows; a Fanuc program numbers 33000"
    with pytest.raises(PlanningError, match=said):
        write_program(long, mill, "fanuc", "P")
    points = Configurations(("X", "Y", "Z", "B"), np.zeros((1, 4)), np.ones(1))
    with pytest.raises(OutOfTravel, match="axis B"):
        write_program(points, mill, "linuxcnc", "P")
    assert set(OURS) <= set(list_dialects())
    said = r"'mazatrol' is installed; installed: .*linuxcnc"
    with pytest.raises(BadInput, match=said):
        write_program(L_SHAPE, mill, "mazatrol", "P")


def test_every_number_of_a_fanuc_program_that_means_a_size_has_a_point(trunnion):
    text = write_program(default_points(trunnion, count=20), trunnion, "fanuc", "P")
    blocks = [s for s in text.splitlines() if re.match(r"N\d+ G[14] ", s)]
    sizes = [size for s in blocks for size in re.findall(r"[XYZABCF][-+.\d]+", s)]
    assert len(sizes) == 20 * 7 + 6 * 2  # and the approach: Z, then five axes
    assert all(re.fullmatch(r"[A-Z]-?\d+\.\d{3}", size) for size in sizes)


class OffByOne(LinuxCnc):
    """A control of somebody else, whose writer has a fault."""

    def write(self, order):
        return super().write(order).replace("X400.5", "X401.5")


class Quiet(Fanuc):
    suffix = ".tap"


def test_a_control_of_a_third_party_is_found_and_read_back(mill, monkeypatch):
    kinds = {"off-by-one": OffByOne, "quiet": Quiet}.items()
    points = [EntryPoint(n, f"{__name__}:{k.__name__}", GROUP) for n, k in kinds]
    monkeypatch.setattr(plugins, "entry_points", lambda group: {GROUP: points}[group])
    assert list_dialects() == ("off-by-one", "quiet")
    text = write_program(L_SHAPE, mill, "quiet", "P")
    assert name_file(text, "quiet").endswith(".tap")
    with pytest.raises(PlanningError, match="does not read back as the path"):
        write_program(L_SHAPE, mill, "off-by-one", "P")
