"""Targets that sit millimetres off where the machine file states them."""

from dataclasses import replace

import numpy as np
import pytest

from recorded import load_small, nominal_error_mm, record_run, stream
from truepath.alignment.align import align
from truepath.errors import AlignmentError
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths

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
