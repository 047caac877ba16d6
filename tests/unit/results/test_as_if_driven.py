"""Another program than the one that is stated is told by the error it looks like."""

from pathlib import Path

import numpy as np
import pytest

from results_fixtures import shorten
from truepath.kinematics.conditions import make_standstill
from truepath.results.as_if_driven import judge_program
from truepath.results.volumetric_error import VolumetricError, make_grid

VALIDATION = Path(__file__).parents[3] / "validation"


def judge(machine, change):
    """Judge a machine without errors that drove a changed program."""
    q = make_grid(machine.axes, 5, 3)
    place = make_standstill(machine, q).point_mm
    driven = make_standstill(machine, change(q)).point_mm
    error_um = 1e3 * (driven - place)
    none = VolumetricError(q, error_um, error_um, np.zeros(2), None, None)
    return {
        (r.kind, r.values["axes"]): r.values["by"]
        for r in judge_program(machine, none).reasons
    }


def add(axis, by):
    return lambda q: q + by * np.eye(q.shape[1])[axis]


def lengthen(axis, factor):
    return lambda q: q + (factor - 1.0) * q * np.eye(q.shape[1])[axis]


def lean(q):
    return q + 0.002 * q[:, :1] * [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lengthen(0, 1.001), {("axis-scaled", "X"): "+1000 ppm"}),
        (lengthen(2, 0.9995), {("axis-scaled", "Z"): "-500 ppm"}),
        (lean, {("axes-leaning", "X Y"): "+2000 ppm"}),
        (add(1, 20.0), {}),  # the same as another place of the tracker
        (lengthen(0, 1.0003), {}),
    ],
)
def test_a_changed_program_of_straight_axes_is_named(mill, change, said):
    assert judge(mill, change) == said


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (add(1, 1.0), ("axis-shifted", "Y")),
        (add(3, 0.5), ("axis-shifted", "A")),
        (lengthen(4, 0.999), ("axis-scaled", "C")),
    ],
)
def test_a_changed_program_of_rotary_axes_is_named(trunnion, change, kind):
    assert kind in judge(trunnion, change)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lines", "points", "rotary-points", "rotary-lines"])
def test_no_wrong_program_gives_a_wrong_table_in_silence(kind, monkeypatch):
    monkeypatch.syspath_prepend(str(VALIDATION))
    import wrong_programs

    draw = wrong_programs.random_content  # machines of straight axes
    monkeypatch.setattr(
        wrong_programs, "random_content", lambda seed: shorten(draw(seed))
    )
    plan, wrongs = wrong_programs.KINDS[kind]
    # All of them are tried by `make validation`, on machines of usual size.
    for seed, name in enumerate(sorted(wrongs)[::3], start=700):
        if name in wrong_programs.RIGID and not kind.startswith("rotary"):
            continue
        found = wrong_programs.try_wrong(plan(seed), wrongs[name], seed)
        assert not wrong_programs.is_wrong(found), (name, seed, found)
