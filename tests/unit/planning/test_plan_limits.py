"""Every plan keeps to its limits, or is refused; the default path."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mills import build_mill
from truepath.errors import PlanningError
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine, RotaryAxis, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.motion.motion_times import FASTEST_DEG_MIN, Drive, Legs, travel_time_s
from truepath.motion.workspace import Box, Workspace, check_travel, moving_targets
from truepath.planning.default_path import default_path
from truepath.planning.design_state import LineDesignState, inverse
from truepath.planning.initial_design import choose_station, start_design
from truepath.planning.planner import Planner
from truepath.planning.target_blocks import share_among_targets

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


STATION_MM = np.array([250.0, -900.0, 100.0])
ON_TOOL = ((0.0, 0.0, -150.0), (60.0, 0.0, -80.0), (0.0, 70.0, -110.0))
ON_TABLE = ((390.0, 225.0, -150.0), (180.0, 345.0, -90.0), (190.0, 110.0, -30.0))
SIX_TARGETS = [Target(f"T{k}", "tool", at) for k, at in enumerate(ON_TOOL, 1)]
SIX_TARGETS += [Target(f"W{k}", "workpiece", at) for k, at in enumerate(ON_TABLE, 1)]
TARGETS = (*SIX_TARGETS[:2], SIX_TARGETS[3])
CHANGE_S = 5.0


def mill_of(*travel_mm):
    travel_mm = travel_mm or (500.0, 400.0, 300.0)
    return build_mill((20.0, 30.0, -150.0), sides=("X", "YZ"), travel_mm=travel_mm)


@cache
def usual_path():
    return default_path(mill_of())


def left_mm(machine, path):
    drive, told = Drive.of(machine.axis_names, 0.35), 0.0
    for target in machine.targets:
        order = LineDesignState, machine, STATION_MM, drive
        known = start_design(*order, target=target.name)
        moves = np.any(np.diff(path.position, axis=0), axis=1)
        own = np.array(path.target[1:] or [target.name] * len(moves)) == target.name
        rows = 1 + np.flatnonzero(moves & own)
        begin, end = path.position[rows - 1], path.position[rows]
        found = known.rows(Legs(begin, end, path.feed_mm_min[rows]))
        flat = found.reshape(-1, found.shape[2])
        told = told + flat.T @ flat
    return float(np.sum(inverse(known.precision + told) * known.gram)) ** 0.5


@pytest.mark.parametrize("size", [(500, 400, 300), (120, 80, 60)])
def test_the_default_path_stays_inside_the_travel_with_a_margin(size):
    mill = mill_of(*size)
    path = default_path(mill, lines=12)
    check_travel(mill, path)
    for column, axis in enumerate(mill.linear_axes):
        travel = axis.high - axis.low
        reached = path.position[:, column]
        assert reached.min() >= axis.low + 0.5 * min(10.0, 0.02 * travel)
        assert reached.max() <= axis.high - 0.5 * min(10.0, 0.02 * travel)
        assert np.ptp(reached) > 0.95 * travel


def test_lines_of_the_default_path_are_long_go_both_ways_and_not_between_corners():
    path = usual_path()
    step = np.diff(path.position, axis=0)
    longest_mm = np.linalg.norm([480.0, 384.0, 288.0])
    assert np.linalg.norm(step, axis=1).min() > 0.5 * longest_mm
    for column in range(3):
        forward, backward = (step[:, column] > 1).sum(), (step[:, column] < -1).sum()
        assert min(forward, backward) >= 5
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    corner = ((path.position == low) | (path.position == high)).all(axis=1)
    assert (corner[:-1] & corner[1:]).mean() < 0.5
    assert 90.0 < travel_time_s(path) < 115.0
    assert (path.feed_mm_min == 6000.0).all()
    assert ((path.dwell_s >= 0.3) & (path.dwell_s <= 0.4)).all()


def test_the_default_path_tells_more_a_second_than_lines_between_corners():
    chosen = usual_path()
    rng = np.random.default_rng(3)
    corners = [10, 8, 6] + np.array(list(np.ndindex(2, 2, 2))) * [480, 384, 288.0]
    order = [0]
    while len(order) < len(chosen):
        order.append(int(rng.choice([i for i in range(8) if i != order[-1]])))
    plain = replace(chosen, position=corners[order])
    longer = (travel_time_s(plain) / travel_time_s(chosen)) ** 0.5
    assert left_mm(mill_of(), chosen) < 0.9 * longer * left_mm(mill_of(), plain)


def test_the_same_seed_gives_the_same_path():
    for machine in (mill_of(), trunnion()):
        made = (default_path(machine, seed=seed, lines=6) for seed in (5, 5, 6))
        first, second, other = (path.position for path in made)
        np.testing.assert_array_equal(first, second)
        assert not np.array_equal(first, other)
        np.testing.assert_array_equal(first, np.round(first, 4))


@pytest.mark.parametrize("bad", [{"feed_mm_min": 0.0}, {"lines": 0}])
def test_a_path_that_cannot_be_driven_is_refused(bad):
    with pytest.raises(PlanningError, match="must be above 0"):
        default_path(mill_of(), **bad)


def trunnion(targets=TARGETS):
    axes = (
        *build_mill(travel_mm=(500.0, 450.0, 400.0)).axes,
        RotaryAxis("A", -100.0, 30.0, (250.0, 225.0, -120.0), (1.0, 0.0, 0.0)),
        RotaryAxis("C", 0.0, 360.0, (250.0, 225.0, -170.0), (0.0, 0.0, 1.0)),
    )
    sides, tracker = (("C", "A"), ("X", "Y", "Z")), TrackerNoise(stands_on="base")
    return Machine("trunnion", *sides, axes, targets, tracker)


@pytest.fixture(scope="module")
def path():
    return default_path(trunnion(), 6000.0)


def test_lines_go_straight_turn_and_do_both_within_the_travel_and_feeds(path):
    check_travel(trunnion(), path)
    step = np.diff(path.position, axis=0)
    straight = np.linalg.norm(step[:, :3], axis=1)
    turn = np.abs(step[:, 3:]).max(axis=1)
    assert ((straight > 0) & (turn == 0)).sum() > 8
    assert ((straight == 0) & (turn > 0)).sum() > 8
    assert ((straight > 0) & (turn > 0)).sum() > 5
    assert np.ptp(path.position[:, 3]) > 120.0
    assert np.ptp(path.position[:, 4]) == 360.0
    length = np.where(straight > 0, straight, np.linalg.norm(step[:, 3:], axis=1))
    moved = length > 0
    minutes = length[moved] / path.feed_mm_min[1:][moved]
    assert (turn[moved] / minutes).max() < 1.001 * FASTEST_DEG_MIN
    assert (straight[moved] / minutes).max() < 1.001 * 6000.0


def test_the_first_target_is_measured_again_after_all_others_unless_by_one_line(path):
    target = np.array(path.target)
    change = np.flatnonzero(target[1:] != target[:-1]) + 1
    assert [path.target[row] for row in (0, *change)] == ["T1", "T2", "W1", "T1"]
    blocks = np.diff([0, *change, len(path)])
    assert abs(blocks[0] - blocks[-1]) <= 1
    np.testing.assert_array_equal(path.position[-4:], path.position[:4])
    np.testing.assert_array_equal(path.feed_mm_min[-3:], path.feed_mm_min[1:4])
    assert (path.dwell_s[change] >= 5.0).all()
    assert (path.position[change] == path.position[change - 1]).all()
    targets = default_path(trunnion(), 6000.0, lines=3).target
    assert list(dict.fromkeys(targets)) == ["T1", "T2", "W1"]
    assert targets[-1] == "W1"


def test_the_target_moves_on_every_line(path):
    mill = trunnion()
    for row in range(1, len(path)):
        target = mill.target(path.target[row])
        if path.target[row] != path.target[row - 1]:
            continue
        ends = path.position[row - 1 : row + 1]
        share = np.linspace(0.0, 1.0, 12)[:, None]
        places = ends[0] + share * (ends[1] - ends[0])
        offset = np.tile(np.array(target.offset_mm), (12, 1))
        aside = np.full(12, target.on == "workpiece")
        at = make_standstill(mill, places, offset)
        step = np.diff(at.view_from(mill.tracker.stands_on, aside).point_mm, axis=0)
        assert np.linalg.norm(step, axis=1).sum() > 90.0


def test_planned_lines_tell_more_than_random_ones_in_the_same_time(rng):
    mill = trunnion(tuple(SIX_TARGETS))
    path = default_path(mill, lines=36)
    low, high = np.array([(axis.low, axis.high) for axis in mill.axes]).T
    position = rng.uniform(low, high, path.position.shape)
    random = replace(path, position=position)
    assert travel_time_s(random) > 0.8 * travel_time_s(path)
    assert left_mm(mill, path) < 0.8 * left_mm(mill, random)


def test_a_machine_with_one_target_on_the_tool_is_planned_for():
    single = trunnion((Target("", "tool", (0.0, 0.0, -150.0)),))
    table = replace(single, tracker=TrackerNoise())
    path = default_path(table, lines=8)
    assert path.target == ()
    assert len(path) == 9
    moved = np.diff(make_standstill(table, path.position).point_mm, axis=0)
    assert np.isfinite(moved).all()


def test_a_target_on_the_axis_that_turns_it_is_refused_with_the_remedy():
    centre = Target("W1", "workpiece", (250.0, 225.0, -120.0))
    with pytest.raises(PlanningError, match=r"W1 hardly moves.*farther from the axes"):
        default_path(replace(trunnion((centre,)), workpiece_side=("C", "A")), lines=3)


def test_targets_share_all_time_but_that_of_turning_and_fewer_a_short_one():
    machine, workspace = trunnion(), Workspace()
    station_mm = choose_station(machine, workspace)
    drive = Drive.of_lines(machine, 0.4)
    design = start_design(LineDesignState, machine, station_mm, drive, target="T1")
    first = Planner(machine, design, workspace, (6000.0,))
    designs = (replace(design, target=target) for target in moving_targets(machine))
    planners = [replace(first, design=one) for one in designs]
    shares = share_among_targets(planners, 240.0, CHANGE_S, 0)
    total = sum(share.budget_s for share in shares)
    assert total == pytest.approx(240.0 - CHANGE_S * len(shares))
    assert min(share.budget_s for share in shares) >= 10.0
    assert len(share_among_targets(planners, 18.0, CHANGE_S, 0)) < len(planners)
