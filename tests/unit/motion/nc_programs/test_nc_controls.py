"""Programs on controls that are not the planner's: what is driven, kept, put back."""

import re

import numpy as np
import pytest

from nc_controls import RUN, Alarm, run_fanuc
from paths_by_hand import path_of
from truepath.motion.nc_programs.programs import read_program, write_program
from truepath.motion.paths.verification_points import make_circle_path

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
