"""Every plan keeps to its limits, or is refused with the reason."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.errors import PlanningError
from truepath.motion.workspace import Box, Workspace

STEP_MM, BEAM_PLACES, SLACK_MM = 1.0, 200, 1e-2
LOW, HIGH = np.array([0.0, 0.0, -300.0]), np.array([500.0, 400.0, 0.0])
OFFSET = np.array([20.0, 30.0, -150.0])
SMALL = Box((200.0, 150.0, -200.0), (300.0, 250.0, -100.0), "probe")
DOOR = Box((0.0, -200.0, -800.0), (500.0, -100.0, 800.0), "door")
HERE = (250.0, -900.0, 0.0)
DIAGONAL = np.array([[10.0, 10.0, -290.0], [490.0, 390.0, -10.0]])


@dataclass(frozen=True)
class Limits:
    """Travel, boxes as (low, high), and the tracker, in plain numbers.

    offset_mm : of the target

    Its checker shares nothing with the planner. It walks every line in steps of at most
    a millimetre, and the beam to each place; up to `SLACK_MM` is no violation.
    """

    low: np.ndarray
    high: np.ndarray
    offset_mm: np.ndarray
    keep_out: list = field(default_factory=list)
    tracker_mm: np.ndarray | None = None
    range_mm: tuple = (0.0, np.inf)
    blocks: list = field(default_factory=list)


def violations(limits, position):
    found = set()
    places = np.vstack([position[:1], *map(_walked, position[:-1], position[1:])])
    low, high = limits.low - SLACK_MM, limits.high + SLACK_MM
    if ((places < low) | (places > high)).any():
        found.add("travel")
    if any(_inside(places, box).any() for box in limits.keep_out):
        found.add("keep-out")
    if limits.tracker_mm is not None:
        found |= _of_tracker(limits, places + limits.offset_mm)
    return found


def _walked(begin, end):
    steps = int(np.ceil(np.linalg.norm(end - begin) / STEP_MM))
    share = np.arange(1, steps + 1)[:, None] / max(steps, 1)
    return begin + share * (end - begin)


def _inside(places, box):
    low, high = box
    return ((places > low + SLACK_MM) & (places < high - SLACK_MM)).all(axis=-1)


def _of_tracker(limits, target):
    found = set()
    beam = target - limits.tracker_mm
    distance = np.linalg.norm(beam, axis=1)
    near, far = limits.range_mm
    if distance.min() < near - SLACK_MM or distance.max() > far + SLACK_MM:
        found.add("range")
    share = np.linspace(0.0, 1.0, BEAM_PLACES)[None, :, None]
    along = limits.tracker_mm + share * beam[::10, None]
    if any(_inside(along, box).any() for box in limits.blocks):
        found.add("sight")
    return found


@st.composite
def boxes(draw, low, high):
    share = [sorted(draw(st.tuples(*[st.floats(0.0, 1.0)] * 2))) for _ in range(3)]
    span = np.array(share)
    span[:, 1] = np.maximum(span[:, 1], span[:, 0] + 0.02)
    a, b = (low + s * (high - low) for s in span.T)
    return Box(tuple(a.tolist()), tuple(b.tolist()))


@st.composite
def workspaces(draw):
    keep_out = draw(st.lists(boxes(LOW, HIGH), max_size=3))
    tracker = np.array([draw(st.floats(-200, 700)), draw(st.floats(-1500, -300)), 0.0])
    blocks = draw(st.lists(boxes(tracker, HIGH + OFFSET), max_size=1))
    nearest, farthest = draw(st.floats(0, 500)), draw(st.floats(600, 2500))
    at, reach = tuple(tracker.tolist()), (nearest, farthest)
    return Workspace(tuple(keep_out), at, *reach, tuple(blocks))


def limits_of(workspace):
    def pairs(given_boxes):
        return [(np.array(b.low_mm), np.array(b.high_mm)) for b in given_boxes]

    at = None if workspace.tracker_mm is None else np.array(workspace.tracker_mm)
    reach, walls = (workspace.nearest_mm, workspace.farthest_mm), workspace.blocks_sight
    return Limits(LOW, HIGH, OFFSET, pairs(workspace.keep_out), at, reach, pairs(walls))


KINDS = st.sampled_from(["lines", "points"])


@pytest.mark.timeout(900)
@pytest.mark.parametrize("plans", [5, pytest.param(200, marks=pytest.mark.long)])
def test_each_plan_passes_or_is_refused(planner, mill, plans):
    @given(workspaces(), KINDS, st.integers(0, 99), st.floats(1500.0, 15000.0))
    @settings(deadline=None, max_examples=plans)
    def check(workspace, kind, seed, feed):
        made = planner(mill, kind, workspace=workspace, feeds=(feed,))
        plan, refusal = None, ""
        try:
            plan = made.plan(30.0, seed=seed)
        except PlanningError as error:
            refusal = str(error)
        if plan is None:
            assert refusal.count(";") == 1  # the reason; the remedy
            return
        assert violations(limits_of(workspace), plan.position) == set()
        inner = plan.position - LOW, HIGH - plan.position
        # At both ends 2 % of the travel are kept free, of the shortest axis 6 mm.
        assert min(part.min() for part in inner) >= 5.0

    check()


@given(workspace=workspaces(), data=st.data())
@settings(deadline=None, max_examples=100)
def test_what_a_workspace_allows_the_checker_allows(mill, workspace, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31)))
    begin, end = (rng.uniform(LOW, HIGH, (4, 3)) for _ in range(2))
    allowed = workspace.allows(mill, begin, end)
    for a, b, ok in zip(begin, end, allowed, strict=True):
        found = violations(limits_of(workspace), np.stack([a, b]))
        assert not (ok and found)


def test_the_checker_finds_a_line_through_a_box():
    box = Box((200.0, 150.0, -200.0), (250.0, 200.0, -100.0))
    limits = limits_of(Workspace((box,)))
    through = np.array([[0.0, 0.0, -300.0], [500.0, 400.0, 0.0]])
    assert violations(limits, through) == {"keep-out"}
    assert violations(limits, through[[0, 0]]) == set()


@pytest.mark.parametrize(
    ("workspace", "reason"),
    [
        (Workspace((SMALL,)), "enters the keep-out box probe"),
        (Workspace((), HERE, farthest_mm=900.0), "farther than the tracker sees"),
        (Workspace((), HERE, nearest_mm=1200.0), "nearer than the tracker sees"),
        (
            Workspace((), HERE, blocks_sight=(DOOR,)),
            "goes behind door, out of the tracker's sight",
        ),
    ],
)
def test_a_forbidden_line_is_named_by_row_and_reason(mill, planner, workspace, reason):
    plan = planner(mill).plan(20.0)
    bad = type(plan)(plan.axes, DIAGONAL, plan.feed_mm_min[:2], plan.dwell_s[:2])
    with pytest.raises(PlanningError, match=f"the way to row 2 .*{reason}"):
        planner(mill, workspace=workspace).check(bad)


def test_what_no_plan_can_do_is_refused_with_the_reason(mill, planner):
    all_of_it = Workspace((Box(tuple(LOW.tolist()), tuple(HIGH.tolist())),))
    with pytest.raises(PlanningError, match="no place in the travel is free"):
        planner(mill, workspace=all_of_it).plan(60.0)
    with pytest.raises(PlanningError, match=r"fits into .* s; give more time"):
        planner(mill).plan(1.0)
    with pytest.raises(PlanningError, match="too short for a steady feed of 60000"):
        planner(mill, feeds=(60_000.0,)).plan(60.0)
