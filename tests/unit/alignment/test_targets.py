"""Targets: on arcs, known from station to station, and seated millimetres off."""

from dataclasses import fields, replace

import numpy as np
import pytest

from recorded import load_small, nominal_error_mm, record_run, stream
from truepath.alignment import repeated_points
from truepath.alignment.align import align
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.errors import AlignmentError
from truepath.kinematics.effects.pose_timing_seats import TimingLaw
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath_simulators.machine.tracker_head import TrackerPose, reposition
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting

ENDS = [10.0, 10.0, 10.0], [490.0, 390.0, 10.0], [490.0, 10.0, 290.0]
POINTS = np.array([*ENDS, [10.0, 390.0, 290.0], [250.0, 200.0, 150.0]])
NONE = dict.fromkeys((one.name for one in fields(TrackerSpecification)), 0.0)
SMALL = {"index_urad": 1.0, "eccentricity_urad": 1.0, "range_offset_um": 1.0}
FIRST, SECOND = (1300.0, 100.0, 50.0), (200.0, -900.0, 0.0)


def measured(place_mm, seed, *, nudge_mm=0.0, poses=reposition, **defects):
    content = load_machine("demo")
    n = len(POINTS)
    program = Program(POINTS, np.full(n, 100.0), np.full(n, 1.8))
    given = {"pose": poses(place_mm, seed), "defects": synthetic.Defects(**defects)}
    setting = synthetic.Setting(machine_seed=5, sensors=False, **given)
    run, made = record_run(content, program, seed, "standstill", setting)
    late = made.time_s > made.time_s[0] + 0.7 * np.ptp(made.time_s)
    tracker_mm = run.tracker.position_mm + np.outer(late, [0.0, 0.0, nudge_mm])
    run = replace(run, tracker=replace(run.tracker, position_mm=tracker_mm))
    return repeated_points.measure_points(run, TrackerSpecification(**NONE | SMALL))


@pytest.fixture(scope="module")
def before():
    return measured(FIRST, 1)


ASKED_MM = float(np.linalg.norm(np.subtract(FIRST, SECOND)))


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_tracker_that_was_moved_agrees_with_its_last_station(before, seed):
    now = measured(SECOND, seed)
    check = repeated_points.compare_stations(before, now, ASKED_MM)
    assert (check.problem, check.place_mm) == ("", pytest.approx(SECOND, abs=1.0))
    assert check.moved_mm > 500.0
    assert check.residual_mm < 0.6 * check.allowed_mm < 0.05
    larger = replace(before, sigma_mm=2.0 * before.sigma_mm)
    wider = repeated_points.compare_stations(larger, now, ASKED_MM)
    assert wider.allowed_mm > check.allowed_mm


def test_a_tracker_that_was_not_moved_is_told(before):
    def stays(place, _):
        return TrackerPose(np.array(place), reposition(FIRST, 1).rotation)

    now = measured(FIRST, 9, poses=stays)
    check = repeated_points.compare_stations(before, now, ASKED_MM)
    assert check.problem == "not-moved"
    assert "stands 0 mm from its last place" in check.text


def test_a_reflector_that_moves_meanwhile_or_is_out_of_sight_is_told(before):
    now = measured(SECOND, 3, nudge_mm=0.1)
    check = repeated_points.compare_stations(before, now, ASKED_MM)
    assert check.problem == "residual"
    assert check.residual_mm > check.allowed_mm
    with pytest.raises(AlignmentError):
        measured(SECOND, 3, beam_breaks=((8.0, 4.0),))


@pytest.mark.parametrize(("planned", "problem"), [(FIRST, ""), (SECOND, "not-moved")])
def test_the_first_station_is_held_against_its_planned_place(before, planned, problem):
    found = repeated_points.compare_with_plan(before, np.array(planned), ASKED_MM)
    assert (found.problem, "of station 1" in found.text) == (problem, bool(problem))


OFF = {"T1": (0.4, -2.0, 1.0), "T2": (3.0, -1.0, 2.0), "W2": (-3.0, 2.0, 1.0)}


def move_targets(machine, off):
    targets = [
        replace(t, offset_mm=tuple(np.add(t.offset_mm, off.get(t.name, (0.0,) * 3))))
        for t in machine.targets
    ]
    return replace(machine, targets=tuple(targets))


def measure(mode, shown=None):
    """Return a Run.

    shown : targets that the tracker is on where others should be measured
    """
    content = load_small("head-table")
    machine = parse_machine(content)
    if mode == "standstill":
        program = paths.turning_points(machine, 4, 60, dwell_s=0.4)
    else:
        program = paths.turning_path(machine, 4, 30, 6000.0)
    seen = tuple((shown or {}).get(name, name) for name in program.target)
    run, _ = record_run(content, replace(program, target=seen), 4, mode)
    return replace(run, commanded=replace(run.commanded, target=program.target))


@pytest.fixture(scope="module", params=["standstill", "otf"])
def run(request):
    return measure(request.param)


@pytest.fixture(scope="module")
def stated(run):
    return align(run)


def test_no_row_of_a_target_that_sits_three_millimetres_off_is_lost(run, stated):
    seen = align(replace(run, machine=move_targets(run.machine, OFF)))
    assert set(seen.row) == set(stated.row)
    off = nominal_error_mm(seen)
    # Of the first target, which the volumetric error is stated for, nothing is taken.
    first = np.abs(seen.at.offset_mm - seen.at.machine.targets[0].offset_mm).max(axis=1)
    assert np.linalg.norm(off[first > 0.0], axis=1).max() < 4.0
    # Targets where they are stated have no shift.
    assert stated.at.seat_mm is None


def test_a_large_shift_is_known_before_levers_are_taken(run):
    seen = align(replace(run, machine=move_targets(run.machine, {"W2": OFF["W2"]})))
    offset = seen.at.machine.target("W2").offset_mm
    mine = np.abs(seen.at.offset_mm - np.array(offset)).max(axis=1) < 1e-6
    assert seen.at.seat_mm is not None
    assert np.abs(seen.at.seat_mm[mine] + np.array(OFF["W2"])).max() < 0.2
    assert not seen.at.seat_mm[~mine].any()


def test_rows_of_several_targets_are_placed_nowhere_before_their_seats_are_known(run):
    live, _ = stream(run, [40])
    assert live.pose is not None
    assert live.locate_rows() is None


def test_while_it_is_measured_a_target_that_sits_off_is_recognised(run):
    off = replace(run, machine=move_targets(run.machine, OFF))
    live, parts = stream(off, [20])
    assert set(live.observations(parts).row) == set(align(off).row)


@pytest.mark.parametrize(
    ("mode", "shown", "away", "said"),
    [
        ("standstill", {"T1": "T2", "T2": "T1"}, {}, r"target T1.*measured T2 ins"),
        ("otf", {"W3": "W2"}, {}, r"target W3.*measured W2 ins"),
        ("otf", {}, {"W2": (0.0, 0.0, 40.0)}, r"target W2.* off"),
    ],
)
def test_a_target_that_is_another_or_elsewhere_is_refused(mode, shown, away, said):
    run = measure(mode, shown)
    with pytest.raises(AlignmentError, match=said):
        align(replace(run, machine=move_targets(run.machine, away)))


def test_rows_of_a_target_that_the_tracker_did_not_see_are_said(run, stated):
    names = np.array(run.commanded.target)
    rows = np.flatnonzero(names == "W2")
    seen_s = stated.at.time_s[np.isin(stated.row, rows)]
    samples, time_s = run.tracker, run.tracker.device_time_s
    hidden = (time_s > seen_s[0] - 1.0) & (time_s < seen_s[-1] + 1.0)
    status = np.where(hidden, 1, samples.status)
    seen = align(replace(run, tracker=replace(samples, status=status)))
    lost = {each.row for each in seen.left_out if each.cause in ("no-pass", "no-stop")}
    assert lost >= set(rows[1:-1].tolist())
    assert not lost & set(seen.row.tolist())


PERFECT = Setting(error_scale=0.0, noise_scale=0.0)


def random_path(name, rows=24, setting=None, **tracker):
    content = load_machine(name)
    content["tracker"] |= tracker
    program = paths.turning_path(parse_machine(content), 5, rows, 9000.0)
    return record_run(content, program, setting=setting)


def rows_of(*rows, target="W1", feed_s=30.0, dwell_s=0.4):
    n = len(rows)
    feeds, dwells = np.full(n, feed_s), np.full(n, dwell_s)
    return Program(np.array(rows, float), feeds, dwells, (target,) * n)


def commanded_at(made, time_s):
    columns = [np.interp(time_s, made.time_s, c) for c in made.commanded_mm.T]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    ("name", "stands_on"), [("head-table", "base"), ("trunnion", "workpiece")]
)
def test_cells_of_a_perfect_machine_lie_on_their_arcs(name, stands_on):
    run, made = random_path(name, setting=PERFECT, stands_on=stands_on)
    seen = align(run)
    assert len(seen.passes) > 10
    # Without the curve taken off before the mean it would be tens of micrometres.
    assert np.abs(nominal_error_mm(seen)).max() < 1e-4
    place = commanded_at(made, seen.at.time_s)
    moving = seen.at.line >= 0
    # Interpolation between samples of the simulator leaves this much.
    assert np.abs(place - seen.at.position_mm)[moving].max() < 2e-3


@pytest.mark.parametrize("name", ["head-table", "trunnion"])
def test_every_line_that_moves_its_target_is_found_once(name):
    run, _ = random_path(name)
    seen = align(run)
    length = compute_nominal_path(run.machine, run.commanded).length_mm
    assert [p.row for p in seen.passes] == np.flatnonzero(length > 1.0).tolist()
    assert np.abs(nominal_error_mm(seen)).max() < 0.3
    # Samples scatter as the tracker states, on arcs too.
    assert seen.scatter == pytest.approx(np.sqrt(0.96) * np.ones(2), abs=0.02)


def test_cells_are_short_in_length_time_and_turn():
    run, _ = random_path("head-table")
    seen = align(run)
    for line in range(len(seen.passes)):
        at = seen.at.select(np.flatnonzero(seen.at.line == line))
        way = np.linalg.norm(np.diff(at.point_mm, axis=0), axis=1)
        turn = np.abs(np.diff(at.position_mm[:, 3:], axis=0)).sum(axis=1)
        assert np.diff(at.time_s).max(initial=0.0) < 0.26
        assert way.max(initial=0.0) < 8.3
        assert turn.max(initial=0.0) < 3.1


@pytest.mark.parametrize(
    "turns", [(0.0, 360.0, 120.0, 240.0), (-300.0, 300.0, 100.0, 0.0)]
)
def test_stops_after_a_full_turn_are_kept_apart_and_two_turns_told_from_one(turns):
    content = load_machine("head-table")
    content["axes"]["C"] |= {"min_deg": -360.0, "max_deg": 360.0}
    start = [300.0, 250.0, 250.0, 0.0]
    program = rows_of(*([*start, c] for c in turns), [*start[:3], 40.0, 60.0])
    run, made = record_run(content, program)
    seen = align(run)
    assert [p.row for p in seen.passes] == [1, 2, 3, 4]
    place = commanded_at(made, seen.at.time_s)
    assert np.abs(place - seen.at.position_mm)[:, 4].max() < 0.05


def test_a_target_on_the_axis_that_turns_is_refused_with_the_remedy():
    content = load_machine("head-table")
    content["targets"]["W1"]["offset_mm"] = [300.0, 250.0, -100.0]
    start = [300.0, 250.0, 250.0, 0.0]
    program = rows_of(*([*start, c] for c in (0.0, 200.0, 90.0, 300.0)))
    run, _ = record_run(content, program)
    with pytest.raises(AlignmentError, match=r"path\.csv hardly moves.*50 mm"):
        align(run)


def test_turns_that_the_target_does_not_see_cost_only_themselves():
    corners = [[100.0, 100.0, 100.0], [500.0, 100.0, 100.0], [500.0, 400.0, 400.0]]
    rows = [[*corners[0], 0.0, 0.0]]
    for k in range(1, 9):
        corner = corners[k % 3]
        rows += [[*rows[-1][:3], 0.0, 40.0 * k], [*corner, 0.0, 40.0 * k]]
    program = rows_of(*rows, target="T1", feed_s=80.0)
    run, _ = record_run(load_machine("head-table"), program)
    seen = align(run)
    assert [p.row for p in seen.passes] == list(range(2, len(rows), 2))
    assert np.abs(nominal_error_mm(seen)).max() < 0.3


def test_lines_whose_corner_is_lost_are_told_by_place():
    run, made = random_path("head-table", setting=PERFECT)
    still = np.all(np.diff(made.commanded_mm, axis=0, prepend=0.0) == 0.0, axis=1)
    lost = still & (made.row == 3)
    seen = align(replace(run, tracker=run.tracker.select(~lost)))
    place = commanded_at(made, seen.at.time_s)
    assert {1, 2, 3, 4, 6} <= {p.row for p in seen.passes}
    moving = seen.at.line >= 0
    assert np.abs(place - seen.at.position_mm)[moving].max() < 0.05


def test_lines_with_the_rotary_axes_held_in_any_pose_are_straight():
    poses = [(20.0, 30.0), (80.0, 200.0)]
    rows = []
    for b, c in poses:
        ends = [[100.0, 100.0, 100.0], [500.0, 400.0, 150.0], [100.0, 400.0, 400.0]]
        rows += [[*end, b, c] for end in ends]
    program = rows_of(*rows, target="T2", feed_s=80.0)
    run, _ = record_run(load_machine("head-table"), program, setting=PERFECT)
    nominal = compute_nominal_path(run.machine, run.commanded)
    assert set(nominal.bends) == {3}
    seen = align(run)
    assert [p.row for p in seen.passes] == [1, 2, 3, 4, 5]
    assert np.abs(nominal_error_mm(seen)).max() < 1e-4


def test_a_line_that_is_late_shifts_its_cells_along_the_arc():
    run, _ = random_path("head-table", setting=PERFECT)
    seen = align(run)
    nominal = compute_nominal_path(run.machine, run.commanded)
    most = 0.0
    for line, each in enumerate(seen.passes):
        at = seen.at.select(np.flatnonzero(seen.at.line == line))
        step = np.diff(run.commanded.position[each.row - 1 : each.row + 1], axis=0)
        share = 0.01 / nominal.length_mm[each.row]  # 0.01 mm of its mean way late
        moved = replace(at, position_mm=at.position_mm + share * step)
        shift = TimingLaw((line,)).jacobian(at)[:, :, 0] * 0.01
        assert np.allclose(shift, moved.point_mm - at.point_mm, atol=1e-5)
        most = max(most, float(np.ptp(np.linalg.norm(shift, axis=1))))
    assert most > 0.004  # on some line the target's speed changes by half its mean


def test_arcs_that_come_block_by_block_give_the_cells_of_the_whole_run():
    run, _ = random_path("trunnion")
    live, parts = stream(run)
    a, b = live.observations(parts), align(run)
    assert (a.row == b.row).all()
    assert (a.at.line == b.at.line).all()
    # A rougher pose may move the ends of a pass by a sample.
    assert np.abs(a.at.time_s - b.at.time_s).max() < 0.005
    assert np.abs(a.at.position_mm - b.at.position_mm).max() < 0.1
    assert a.used > 0.999 * b.used
