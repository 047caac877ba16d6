"""What one, two and three tool offsets can tell apart."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.volumetric_map import build_volumetric_map

ONE = [(0.0, 0.0, -100.0)]
TWO = [*ONE, (0.0, 0.0, -250.0)]
THREE = [*ONE, (80.0, 0.0, -200.0), (0.0, 80.0, -300.0)]
CHAINS = [("", "XYZ"), ("X", "YZ"), ("Y", "XZ"), ("XY", "Z"), ("Z", "XY"), ("XYZ", "")]


def machine(workpiece_side, tool_side):
    return Machine(
        "m",
        tuple(workpiece_side),
        tuple(tool_side),
        tuple(LinearAxis(a, 0.0, 600.0) for a in "XYZ"),
        (Target("T", "tool", ONE[0]),),
        TrackerNoise(),
    )


def motions(model):
    return [e.symbol for e in model.effects if isinstance(e, ErrorMotion)]


@pytest.mark.parametrize("sides", CHAINS)
@pytest.mark.parametrize(
    ("offsets", "known", "rank"), [(ONE, 14, 67), (TWO, 16, 77), (THREE, 18, 87)]
)
def test_tool_offsets_decide_how_many_motions_are_told_apart(
    sides, offsets, known, rank
):
    """Ranks 73, 85, 96 of the field, less the six of the whole volume's motion.

    And less the turns of how the targets sit: each sits by itself.
    """
    last = "XYZ".index("".join(sides)[-1])
    lengths = np.roll(np.array(offsets), last - 2, axis=1)  # along the last axis
    model, merged = build_identifiable_model(machine(*sides), lengths, intervals=5)
    assert len(motions(model)) == known
    assert len(motions(model)) + len(merged) == 18
    assert model.size == rank + 3 * (len(offsets) - 1)


def test_what_merges_is_named_with_what_it_merges_into():
    _, merged = build_identifiable_model(
        machine("", "XYZ"), np.array([(30.0, 20.0, -100.0)])
    )
    said = {m.symbol: str(m) for m in merged}
    assert set(said) == {"ECY", "EAZ", "EBZ", "ECZ"}
    assert "EXZ" in said["EBZ"]
    assert "another tool length" in said["EBZ"]


def test_a_turn_about_a_target_on_the_spindle_axis_moves_nothing():
    _, merged = build_identifiable_model(machine("", "XYZ"), np.array(ONE))
    said = {m.symbol: str(m) for m in merged}
    assert "does not move the target" in said["ECZ"]


def test_how_other_targets_sit_is_no_error_of_the_first_one():
    # T1 is the last in any order of coordinates.
    places = {
        "T1": (60.0, 50.0, -20.0),
        "T2": (0.0, 0.0, -200.0),
        "T3": (0.0, 60.0, -90.0),
    }
    targets = tuple(Target(name, "tool", at) for name, at in places.items())
    mill = replace(machine("", "XYZ"), targets=targets)
    model, _ = build_identifiable_model(
        mill, np.array(list(places.values())), intervals=4
    )
    seats = [name for name in model.slices if name.startswith("seat")]
    assert seats == ["seat-T2", "seat-T3"]
    for name, at in places.items():
        still = make_standstill(mill, np.full((1, 3), 50.0), np.array([at]))
        moved = {s: model.jacobian(still)[:, :, model.slices[s]].any() for s in seats}
        assert moved == {s: s == f"seat-{name}" for s in seats}
        error = build_volumetric_map(model, name).jacobian(still)
        assert not any(error[:, :, model.slices[s]].any() for s in seats)
