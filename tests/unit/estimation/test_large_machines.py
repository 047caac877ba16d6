"""Knots where a motion of metres needs them; what lies between them is in u."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate, estimate_one
from recorded import record_run
from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.errors import Unidentifiable
from truepath.estimation.checks import lack_of_fit, short_wave_variance
from truepath.estimation.noise.baseline import fit_baseline
from truepath.estimation.problem.knots import compute_hidden_variance
from truepath.kinematics import coarse_model, identifiable
from truepath.results.analysis import analyse
from truepath_simulators import machine_file
from truepath_simulators.hidden.drives import ScrewCyclic
from truepath_simulators.machine.random_machine import join_rack, random_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.synthetic import Setting

LONG = (3000.0, 800.0, 600.0)
GANTRY = (6000.0, 2500.0, 1200.0)
STRIDE = 12  # cells from one step of the set-up that is tried to the next


def _record(travel_mm, rows, *, step_mm=0.0, level=None):
    content = machine_file.load_machine("demo")
    content["kinematic_chain"] = "w-b-X-Y-Z-t"
    for axis, length in zip(content["axes"].values(), travel_mm, strict=True):
        axis["min_mm"], axis["max_mm"] = 0.0, length
    machine = machine_file.parse_machine(content)
    truth = random_machine(machine, 3)
    if step_mm:
        truth = join_rack(truth, "X", 3, step_mm)
    program = paths.chord_path(machine, 3, rows, 24_000.0)
    if level is not None:
        position = program.position.copy()
        position[:, 2] = level
        program = replace(program, position=position)
    setting = Setting(truth=truth, sensors=False)
    return record_run(content, program, 3, setting=setting)[0], truth


def _curves(found, truth, symbol, at):
    motion = next(m for m in found.model.error_motions if m.name == symbol)
    part = found.model.slices[symbol]
    line = np.stack([np.ones(len(at)), at], axis=1)
    free = np.eye(len(at)) - line @ np.linalg.pinv(line)
    rows = free @ motion.rows(at)
    true = free @ truth.error_motions()[symbol].at(at)
    variance = np.einsum("np,pq,nq->n", rows, found.covariance[part, part], rows)
    return rows @ found.theta[part], np.sqrt(variance), true


def test_a_gantry_of_six_metres_is_determined():
    run, truth = _record(GANTRY, 50)
    found = estimate(align(run))
    at = np.linspace(0.0, GANTRY[0], 121)
    value, sigma, true = _curves(found, truth, "EXX", at)
    assert np.abs(value - true).max() < 0.25 * np.abs(true).max()
    assert (np.abs(value - true) < 2.0 * sigma).mean() > 0.85


def test_a_smooth_machine_has_few_knots_and_a_rack_as_many_as_it_needs():
    at = np.linspace(0.0, LONG[0], 601)
    smooth, _ = _record(LONG, 40)
    pieces, truth = _record(LONG, 40, step_mm=0.008)
    few = estimate(align(smooth)).model
    found = estimate(align(pieces))
    assert {m.spline.size for m in few.error_motions if m.axis.name == "X"} == {33}
    value, sigma, true = _curves(found, truth, "EXX", at)
    assert np.sqrt(np.mean((value - true) ** 2)) < 0.0012
    assert (np.abs(value - true) < 2.0 * sigma).mean() > 0.85
    seen = add_surroundings(align(pieces), pieces.commanded)
    models = coarse_model.build_baseline_models(pieces.machine, [seen.at])
    for model in (found.model, fit_baseline(*models, [seen]).model):
        sizes = {m.name: m.spline.size for m in model.error_motions}
        assert sizes["EXX"] > 80
        assert sizes["ECX"] == 33


def test_what_knots_hide_falls_with_the_cube_of_their_distance():
    run, _ = _record(LONG, 12)
    offset = np.array([run.machine.target().offset_mm])
    model, _ = identifiable.build_identifiable_model(run.machine, offset)
    motion = next(m for m in model.error_motions if m.name == "EXX")
    coarse, fine = (compute_hidden_variance(motion.coarsen(n), 1e6) for n in (40, 80))
    assert coarse == pytest.approx(8.0 * fine)


def test_an_axis_that_rests_is_refused_by_name_with_the_lines_that_mend_it():
    run, _ = _record((600.0, 500.0, 400.0), 24, level=200.0)
    with pytest.raises(Unidentifiable, match=r"add lines that move .*Z"):
        estimate(align(run))


@pytest.mark.long
def test_a_burst_is_left_out_where_it_is_though_the_fit_has_joined_cells():
    run, _ = _record(LONG, 30)
    seen = add_surroundings(align(run), run.commanded)
    line = np.flatnonzero((seen.row == 17) & ~seen.is_ramp)
    burst = line[len(line) // 2 : len(line) // 2 + 12]
    moved = seen.tracker_mm.copy()
    moved[burst] += [0.1, -0.1, 0.1]
    checked = estimate_one(replace(seen, tracker_mm=moved))
    fitted = checked.estimate.fit.runs[0].observations
    assert len(fitted) < 0.6 * len(seen)
    left_out = checked.left_out[0]
    assert {each.row for each in left_out} == {17}
    begin, end = seen.at.time_s[burst[0]], seen.at.time_s[burst[-1]]
    assert min(each.begin_s for each in left_out) > begin - 0.2
    assert max(each.end_s for each in left_out) < end + 0.2
    samples = sum(each.samples for each in left_out)
    assert samples < 2 * seen.count[burst].sum()


def _examine(fit, cells):
    run = fit.runs[0]
    few = replace(run, observations=run.observations.select(np.arange(cells)))
    tracemalloc.start()
    try:
        found = lack_of_fit.assess_misfit(replace(fit, runs=(few,)), 0)
        return found, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_steps_that_are_tried_are_held_few_times():
    run, _ = _record(LONG, 24)
    fit = estimate(align(run), keep_fit=True).fit
    seen = fit.runs[0].observations
    late = np.arange(len(seen)) > 0.3 * len(seen)
    moved = seen.tracker_mm + np.outer(late, [0.2, 0.0, 0.0])
    part = replace(fit.runs[0], observations=replace(seen, tracker_mm=moved))
    knocked = replace(fit, runs=(part,))
    ends = [last for _, last in knocked.runs[0].observations.lines]
    half, whole = ends[len(ends) // 2], ends[-1]
    (_, less), (found, more) = (_examine(knocked, cells) for cells in (half, whole))
    assert found.steps[0].cell == pytest.approx(0.3 * whole, abs=2)
    sums = 8 * 7 * knocked.runs[0].linearisation.size * (whole - half) / STRIDE
    assert more - less < 5.5 * sums


def analyse_with(record, monkeypatch, *hidden):
    run, _ = record(33, rows=30, setting=Setting(hidden=hidden))
    before = []

    def spy(found, runs):
        before.append(found)
        return short_wave_variance.add_ripple(found, runs)

    monkeypatch.setattr("truepath.results.analysis.add_ripple", spy)
    found = analyse(run)
    (plain,) = before
    scaled = plain.widen_by_scale(1e-6 * found.length_scale_ppm)
    added = np.diag(found.estimate.covariance - scaled.covariance)
    sizes = {}
    for motion in plain.model.error_motions:
        rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, 50))
        own = added[plain.model.slices[motion.name]]
        sizes[motion.symbol] = 1e6 * float((rows**2 @ own).mean())
    return found, sizes


def test_a_clean_machine_has_none(record, monkeypatch):
    found, sizes = analyse_with(record, monkeypatch)
    assert found.verdict.state == "usable"
    assert max(sizes.values()) < 0.1**2


@pytest.mark.parametrize("lead_mm", [5.0, 20.0])
def test_a_screw_too_short_for_knots_is_found_to_its_size(record, monkeypatch, lead_mm):
    screw = ScrewCyclic("Y", lead_mm, 1.5, 0.3)
    _, sizes = analyse_with(record, monkeypatch, screw)
    assert 0.8 < sizes.pop("EYY") / (1.5**2 / 2.0) < 1.2
    assert max(sizes.values()) < 0.3**2
