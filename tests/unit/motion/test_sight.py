"""What blocks the beam, standing or carried, and how far a reflector looks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.workspace import Box, Reflector, StationAreas, Workspace
from truepath_simulators.machine_file import load_machine

TRACKER = (250.0, -1200.0, 0.0)


def blocked_by_sampling(machine, box, begin, end):
    """Follow beam and carrier along one line, body by body from workpiece to tool."""
    target = np.array(machine.target().offset_mm)
    order = [*machine.workpiece_side, "base", *machine.tool_side]
    for share in np.linspace(0.0, 1.0, 201):
        position = begin + share * (end - begin)
        shift = np.zeros(3)
        if box.carried_by:
            carrier = order.index(box.carried_by)
            # The carriage of an axis of the workpiece lies on its workpiece side.
            moving = order[: carrier + (carrier > len(machine.workpiece_side))]
            carries = [name in moving for name in "XYZ"]
            shift[carries] = position[carries]
        a, b = np.array(TRACKER), position + target
        beam = a + np.linspace(0.0, 1.0, 400)[:, None] * (b - a)
        low, high = np.array(box.low_mm) + shift, np.array(box.high_mm) + shift
        if ((beam >= low) & (beam <= high)).all(axis=1).any():
            return True
    return False


@given(st.integers(0, 10_000), st.sampled_from(["", "base", "X", "Y", "Z"]))
@settings(deadline=None, max_examples=60)
@pytest.mark.parametrize("chain", ["w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-Y-X-b-Z-t"])
def test_no_line_is_allowed_behind_what_an_axis_carries(chain, seed, carried_by):
    content = {**load_machine("demo"), "kinematic_chain": chain}
    machine = machine_from_json(content, file="machine.json")
    rng = np.random.default_rng(seed)
    low = np.array([axis.low for axis in machine.linear_axes])
    high = np.array([axis.high for axis in machine.linear_axes])
    begin, end = rng.uniform(low, high, (2, 3))
    corner = rng.uniform([-200.0, -900.0, -600.0], [600.0, 100.0, 300.0])
    far = corner + rng.uniform(50.0, 300.0, 3)
    box = Box(tuple(corner), tuple(far), "", carried_by)
    workspace = Workspace(tracker_mm=TRACKER, blocks_sight=(box,))
    allowed = bool(workspace.allows(machine, begin[None], end[None])[0])
    if blocked_by_sampling(machine, box, begin, end):
        assert not allowed


def test_a_body_that_the_tool_carries_blocks_exactly(mill):
    """A plate beside the tool, on the far side of the target or on the near one."""
    begin, end = np.array([[50.0, 50.0, -250.0]]), np.array([[450.0, 350.0, -50.0]])
    x, y, z = mill.target().offset_mm
    for near, far, seen in ((1.0, 90.0, True), (-90.0, -1.0, False)):
        ends = (x - 50.0, y + near, z - 50.0), (x + 50.0, y + far, z + 50.0)
        box = Box(*ends, "", "Z")
        workspace = Workspace(tracker_mm=TRACKER, blocks_sight=(box,))
        assert workspace.allows(mill, begin, end)[0] == seen


def test_a_reflector_is_seen_within_its_working_angle(mill):
    begin, end = np.array([[10.0, 10.0, -290.0]]), np.array([[490.0, 390.0, -10.0]])
    for y, angle_deg, seen in ((-1, 60.0, True), (-1, 5.0, False), (1, 60.0, False)):
        reflector = Reflector((0, y, 0), angle_deg)
        workspace = Workspace(tracker_mm=TRACKER, reflector=reflector)
        assert workspace.allows(mill, begin, end)[0] == seen


def test_the_tracker_may_stand_in_an_area_and_not_where_it_is_kept_out():
    floor = Box((0.0, 0.0, 0.0), (1000.0, 500.0, 0.0))
    areas = StationAreas((floor,), (Box((0.0, 0.0, -10.0), (200.0, 500.0, 10.0)),))
    places = np.array([[500.0, 100.0, 0.0], [100.0, 100.0, 0.0], [500.0, 600.0, 0.0]])
    assert areas.allow(places).tolist() == [True, False, False]
    assert StationAreas((floor,)).allow(places).tolist() == [True, True, False]
