"""Machines of metres, and what is stated beyond what was measured."""

import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimating import estimate, estimate_one
from recorded import record_run
from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.errors import Unidentifiable
from truepath.estimation.checks import intra_cell_motion, lack_of_fit
from truepath.estimation.noise.baseline import fit_baseline
from truepath.estimation.problem.knots import compute_hidden_variance
from truepath.estimation.solve import batch
from truepath.estimation.solve.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.kinematics import coarse_model, identifiable
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.results.analysis import analyse
from truepath.results.error_tables import build_error_tables
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
        found = lack_of_fit.assess_lack_of_fit(replace(fit, runs=(few,)), 0)
        return found, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_steps_that_are_tried_are_held_few_times():
    run, _ = _record(LONG, 24)
    fit = estimate(align(run)).fit
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
        return intra_cell_motion.add_short_wave_variance(found, runs)

    monkeypatch.setattr("truepath.results.analysis.add_short_wave_variance", spy)
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


@cache
def partly_driven(seed):
    content, axes = machine_file.load_machine("demo"), {}
    rng = np.random.default_rng(seed)
    for name, axis in content["axes"].items():
        length = axis["max_mm"] - axis["min_mm"]
        part = rng.uniform(0.6, 0.8) * length
        low = axis["min_mm"] + rng.choice([0.0, 0.5, 1.0]) * (length - part)
        axes[name] = {**axis, "min_mm": float(low), "max_mm": float(low + part)}
    driven = machine_file.parse_machine({**content, "axes": axes})
    run, made = record_run(content, paths.chord_path(driven, seed, 24, 10_000.0), seed)
    found = estimate(align(run))
    model = found.model
    low, high = np.array([(a.low, a.high) for a in model.machine.axes]).T
    q = np.random.default_rng(1).uniform(low, high, (1500, 3))
    corners = low + np.array(list(np.ndindex(2, 2, 2))) * (high - low)
    at = make_standstill(model.machine, np.vstack([q, corners]))
    free = model.with_effects(TrackerPose(tuple(at.point_mm.mean(axis=0).tolist())))
    columns = free.jacobian(at).reshape(-1, free.size)
    for name in model.confounded:  # what one target sees of it, others take up
        columns[:, model.slices[name]] = 0.0
    norm = np.linalg.norm(columns, axis=0)  # 0 for what acceleration does, too
    scale = 1.0 / np.where(norm > 0.0, norm, 1.0)
    error = made.truth.deviation_mm(at.position_mm).reshape(-1)
    theta = np.linalg.lstsq(columns * scale, error, rcond=1e-12)[0] * scale
    return found, theta[: model.size]


def held(found, true):
    mine = build_error_tables(found, found.measured).tables
    exact = build_error_tables(replace(found, theta=true), found.measured).tables
    hits = []
    for table, truth in zip(mine, exact, strict=True):
        # Where the gauge of the tables fixes a value there is nothing to hold.
        judged = table.extrapolated & (table.uncertainty > 1e-9)
        off = np.abs(table.value - truth.value)[judged]
        hits.append(off <= 2.0 * table.uncertainty[judged])
    return np.concatenate(hits)


TWENTY = pytest.param(range(200, 220), 0.92, 0.99, marks=pytest.mark.long)


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("seeds", "low", "high"), [(range(500, 504), 0.9, 1.0), TWENTY]
)
def test_intervals_hold_the_truth_where_nothing_was_measured(seeds, low, high):
    hits = np.concatenate([held(*partly_driven(seed)) for seed in seeds])
    assert len(hits) > 100
    assert low < hits.mean() <= high


def seen_from_inside(found, axis, count=12):
    """Return uncertainties from the edge of the measured range to the end of an axis.

    Of the error as what was measured sees it: without the rigid motion that fits best
    over the measured part. The other axes stand in the middle of it.
    """
    machine, model = found.model.machine, found.model
    low, high = np.array([found.measured[a.name] for a in machine.axes]).T
    inside = np.random.default_rng(2).uniform(low, high, (200, 3))
    column = machine.axis_names.index(axis.name)
    above = axis.high - high[column] > low[column] - axis.low
    ends = (high[column], axis.high) if above else (low[column], axis.low)
    position = np.tile((low + high) / 2.0, (count, 1))
    position[:, column] = np.linspace(*ends, count)
    at, seen = make_standstill(machine, position), make_standstill(machine, inside)
    rigid = TrackerPose(tuple(seen.point_mm.mean(axis=0).tolist()))
    columns = rigid.jacobian(seen).reshape(-1, 6)
    fit = np.linalg.pinv(columns) @ model.jacobian(seen).reshape(-1, model.size)
    J = model.jacobian(at) - rigid.jacobian(at) @ fit
    variance = np.einsum("nip,pq,niq->n", J, found.covariance, J, optimize=True)
    return np.sqrt(variance)


def test_from_the_edge_to_the_end_u_grows_and_the_slope_is_as_was_seen_inside():
    for seed in (500, 501, 502, 503):
        found, _ = partly_driven(seed)
        for axis in found.model.machine.linear_axes:
            sigma = seen_from_inside(found, axis)
            assert sigma[-1] > 3.0 * sigma[0]
            assert (np.diff(sigma) > 0.0).all()
        told = found.model, found.theta, found.measured, found.covariance
        known = estimate_variations(*told)
        for motion in found.model.effects:
            if motion.name not in known:
                continue
            low, high = found.measured[motion.axis.name]
            part = found.model.slices[motion.name]
            ends = np.array([motion.axis.low, low, high, motion.axis.high])
            value = motion.rows(ends) @ found.theta[part]
            slope = np.diff(value) / np.maximum(np.diff(ends), 1.0)
            allowed = 4.0 * np.sqrt(known[motion.name].slope_square)
            assert np.abs(slope[[0, 2]] - slope[1]).max() < allowed


def test_a_measurement_of_the_whole_travel_is_left_as_it_is(record, monkeypatch):
    run, _ = record(21, rows=40)
    seen = align(run)
    with_ends = estimate(seen)
    monkeypatch.setattr(batch, "soften_ends", lambda fit, *rest: fit)
    assert estimate(seen).theta == pytest.approx(with_ends.theta, abs=1e-12)


def test_beyond_the_travel_the_uncertainty_grows_on():
    found, _ = partly_driven(500)
    machine = found.model.machine
    told = found.model, found.theta, full_travel(machine), found.covariance
    known = estimate_variations(*told)
    high = np.array([a.high for a in machine.axes])
    steps = np.array([0.0, 1.0, 10.0, 100.0, 2e3, 8e3])[:, None] * np.array([1.0, 0, 0])
    at = make_standstill(machine, high + steps)
    variance = beyond_travel_variance_mm2(at, found.model, known)
    assert (variance[0] == 0.0).all()
    assert (np.diff(variance.sum(axis=1)) > 0.0).all()
    # The slope is bounded: far out it grows no faster than in proportion.
    sigma = np.sqrt(variance.sum(axis=1))
    assert sigma[5] == pytest.approx(4.0 * sigma[4], rel=0.01)
