"""Charts with round ticks and nothing outside the frame; templates compiled once."""

import re
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jinja2 import DictLoader

from truepath.answers.shown import page
from truepath.answers.shown.chart import (
    Colour,
    Frame,
    Scale,
    draw_curve,
    draw_label,
    round_down,
    round_up,
)

FRAME = Frame(40.0, 16.0, 240.0, 136.0)


@given(
    low=st.floats(-1e4, 1e4), span=st.floats(1e-3, 1e5), spacing=st.floats(10.0, 60.0)
)
def test_ticks_are_round_inside_the_scale_and_far_enough_apart(low, span, spacing):
    scale = Scale(low, low + span, 0.0, 200.0)
    ticks = scale.compute_ticks(spacing)
    assert ((ticks >= low - 1e-6 * span) & (ticks <= low + 1.000001 * span)).all()
    if len(ticks) > 1:
        step = ticks[1] - ticks[0]
        assert np.diff(scale.place(ticks)).min() > 0.99 * spacing
        digit = step / 10.0 ** np.floor(np.log10(step * 1.0001))
        assert min(abs(digit - d) for d in (1.0, 2.0, 5.0)) < 1e-3


@given(number=st.floats(1e-9, 1e9))
def test_rounding_up_and_down_encloses_the_number(number):
    assert round_down(number) <= 1.001 * number
    assert round_up(number) >= 0.999 * number
    assert round_up(number) <= 2.6 * round_down(number)


def test_a_scale_ends_with_its_frame_and_its_decades_are_of_one_width():
    across, up = FRAME.make_x(-3.0, 5.0), FRAME.make_y(0.0, 8.0, margin=0.0)
    assert across.place(np.array([-3.0, 5.0])) == pytest.approx([40.0, 240.0])
    assert up.place(np.array([0.0, 8.0])) == pytest.approx([136.0, 16.0])
    scale = FRAME.make_x(0.01, 100.0, logarithmic=True)
    places = scale.place(np.array([0.01, 0.1, 1.0, 10.0, 100.0]))
    assert np.diff(places) == pytest.approx([50.0] * 4)
    ticks = scale.compute_ticks(30.0)
    assert scale.format_ticks(ticks) == ["0.01", "0.1", "1", "10", "100"]
    few = Scale(0.5, 20.0, 0.0, 100.0, logarithmic=True)
    ticks = few.compute_ticks(30.0)
    assert few.format_ticks(ticks) == ["0.5", "1", "2", "5", "10", "20"]


@pytest.mark.parametrize(
    ("ticks", "text"),
    [
        ([-10.0, 0.0, 10.0], ["−10", "0", "10"]),
        ([-0.5, 0.0, 0.5], ["−0.5", "0.0", "0.5"]),
        ([0.0, 0.02, 0.04], ["0.00", "0.02", "0.04"]),
        ([1000.0, 2000.0], ["1,000", "2,000"]),
    ],
)
def test_ticks_have_one_number_of_places_and_a_true_minus(ticks, text):
    assert Scale(-1.0, 1.0, 0.0, 1.0).format_ticks(np.array(ticks)) == text


def test_curves_and_grid_stay_in_the_frame_and_words_bring_no_markup():
    across = FRAME.make_x(0.0, 800.0)
    drawn = FRAME.draw_axes(across, FRAME.make_y(0.0, 0.0), "X, mm", "µm")
    assert "nan" not in drawn
    assert "inf" not in drawn
    drawn = FRAME.draw_axes(across, FRAME.make_y(-3.0, 9.0), "X, mm", "µm")
    grid = next(p for p in re.findall(r'<path d="([^"]*)"', drawn) if "L" in p)
    x, y = np.array(re.findall(r"[\d.]+", grid), float).reshape(-1, 2).T
    assert FRAME.left <= x.min() < x.max() <= FRAME.right
    assert FRAME.top <= y.min() < y.max() <= FRAME.bottom
    drawn = draw_curve(np.array([1.0, 2.0]), np.array([3.0, 4.5]), Colour.ACCENT)
    assert 'd="M1.00 3.00L2.00 4.50"' in drawn
    assert "<script" not in draw_label(0.0, 0.0, "<script>")


@pytest.fixture
def environment(tmp_path):
    cache = page.CompiledTemplates(str(tmp_path))
    loader = DictLoader({"page.html": "<p>{{ text }}</p>"})
    return page.ENVIRONMENT.overlay(loader=loader, bytecode_cache=cache)


def test_a_template_is_compiled_once(environment, tmp_path, monkeypatch):
    environment.get_template("page.html")
    assert len(list(tmp_path.iterdir())) == 1
    again = environment.overlay(cache_size=1)
    monkeypatch.setattr(type(again), "compile", None)  # would fail
    assert again.get_template("page.html").render(text="<") == "<p>&lt;</p>"


def test_a_page_is_made_where_nothing_can_be_kept(environment, tmp_path, monkeypatch):
    tmp_path.rmdir()
    assert environment.get_template("page.html").render(text="a") == "<p>a</p>"
    for error in (RuntimeError, PermissionError):  # a user without a folder
        refuse = Mock(side_effect=error)
        kept = page.CompiledTemplates
        monkeypatch.setattr(kept, "_get_default_cache_dir", refuse)
        assert page.open_template_cache() is None
