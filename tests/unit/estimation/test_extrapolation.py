"""Beyond what was measured: intervals that hold the truth, bounded slopes, growth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimating import estimate
from recorded import record_run
from truepath.alignment.align import align
from truepath.estimation.solve import batch
from truepath.estimation.solve.extrapolation import (
    beyond_travel_variance_mm2,
    estimate_variations,
    full_travel,
)
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.results.error_tables import build_error_tables
from truepath_simulators import machine_file
from truepath_simulators.motion import paths


def part_of_travel(content, seed):
    rng = np.random.default_rng(seed)
    axes = {}
    for name, axis in content["axes"].items():
        length = axis["max_mm"] - axis["min_mm"]
        driven = rng.uniform(0.6, 0.8) * length
        low = axis["min_mm"] + rng.choice([0.0, 0.5, 1.0]) * (length - driven)
        axes[name] = {**axis, "min_mm": float(low), "max_mm": float(low + driven)}
    return {**content, "axes": axes}


@cache
def partly_driven(seed):
    content = machine_file.load_machine("demo")
    driven = machine_file.parse_machine(part_of_travel(content, seed))
    run, made = record_run(content, paths.chord_path(driven, seed, 24, 10_000.0), seed)
    found = estimate(align(run))
    return found, true_theta(found.model, made.truth)


def true_theta(model, truth):
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
    error = truth.deviation_mm(at.position_mm).reshape(-1)
    found = np.linalg.lstsq(columns * scale, error, rcond=1e-12)[0] * scale
    return found[: model.size]


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
