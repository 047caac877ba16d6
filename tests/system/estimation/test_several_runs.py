"""Several Runs of one machine in one estimate, and what uncertainty is made of."""

from dataclasses import replace

import numpy as np
import pytest
from tests.conftest import choose_program

from estimating import estimate, judge_map
from recorded import record_run
from truepath.alignment.align import align
from truepath.errors import BundleError, Unidentifiable
from truepath.estimation.problem.noise import NoiseModel, cell_noise
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.solve import budget
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath_simulators import machine_file
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.worlds.synthetic import Setting

MACHINE = 71  # the machine of every recording; noise, clock and pose are another's
SHORT, LONG, ASIDE = (20.0, 30.0, -150.0), (20.0, 30.0, -300.0), (140.0, -60.0, -200.0)


def content_with(offset_mm=SHORT):
    content = machine_file.load_machine("demo")
    content.pop("targets", None)
    return {**content, "tool_offset_mm": list(offset_mm)}


def recorded(seed, mode="otf", rows=24, offset_mm=SHORT, **setting):
    content = content_with(offset_mm)
    program = choose_program(content, seed, mode, rows, 10_000.0, dwell_s=0.5)
    setting = Setting(machine_seed=MACHINE, **setting)
    return record_run(content, program, seed, mode, setting)


def seen_of(*args, **options):
    return align(recorded(*args, **options)[0])


@pytest.fixture(scope="module")
def moving():
    return seen_of(1)


@pytest.fixture(scope="module")
def standing():
    return seen_of(2, "standstill", rows=40)


@pytest.fixture(scope="module")
def alone(moving):
    return estimate(moving)


def judge(result, offset_mm=SHORT):
    truth = random_machine(machine_file.parse_machine(content_with(offset_mm)), MACHINE)
    targets = result.model.machine.targets
    name = next(t.name for t in targets if t.offset_mm == offset_mm)
    return judge_map(result, truth.deviation_mm, name)


def volumetric_sigma(result):
    gram = compute_volumetric_gram(result.model)
    return float(np.sqrt(np.sum(gram * result.covariance)))


def test_both_modes_in_any_order_leave_less_than_each(alone, standing, moving):
    both = estimate(moving, standing)
    left = judge(both)
    assert left.share < min(judge(alone).share, judge(estimate(standing)).share)
    assert 0.85 < left.inside <= 1.0
    assert 0.85 < both.rms_mm / both.floor_mm < 1.1
    other = estimate(standing, moving)
    u = np.sqrt(np.diag(both.covariance))
    assert (np.abs(both.theta - other.theta) < 0.2 * u).all()
    assert [run.cells for run in both.runs] == [run.cells for run in other.runs][::-1]


def test_each_run_keeps_a_tracker_pose_and_a_noise_of_its_own():
    loud = {"noise_scale": 3.0, "air": Air(share=0.3, tau_s=0.6)}
    (near, one), (far, other) = recorded(3), recorded(4, **loud)
    result = estimate(align(near), align(far))
    for run, made in zip(result.runs, (one, other), strict=True):
        corner = np.array([[300.0, 200.0, 100.0]])
        apart = run.pose.apply(corner) - made.pose.from_table(corner)
        assert np.linalg.norm(apart) < 0.2  # the machine's own rigid motion
    quiet, noisy = (run.noise for run in result.runs)
    assert np.divide(noisy.white, quiet.white) == pytest.approx(3.0, rel=0.1)
    assert noisy.ou == pytest.approx((0.9, 0.9, 0.9), rel=0.4)
    assert 0.3 < noisy.ou_time_s < 1.2


def test_a_loud_or_short_run_adds_and_does_not_spoil_another(moving, alone, standing):
    loud = seen_of(4, rows=12, noise_scale=5.0)
    joined = estimate(moving, loud)
    assert judge(joined).share < 1.1 * judge(alone).share
    assert volumetric_sigma(joined) < 1.01 * volumetric_sigma(alone)
    few = standing.select(np.flatnonzero(standing.row < 5))
    with pytest.raises(Unidentifiable):
        estimate(few)
    joined = estimate(moving, few)
    assert volumetric_sigma(joined) < volumetric_sigma(alone)
    assert joined.runs[1].lines == 5


def test_a_repeated_run_shrinks_uncertainty_and_halves_variance_of_noise(moving, alone):
    noise, at = NoiseModel((1.0, 1.0), (0.2, 0.2, 0.2), 1.0, 1e-4), moving.at
    run = RunInput(moving, moving.pose, noise)
    model, _ = build_identifiable_model(at.machine, at.offset_mm, intervals=5)
    told = (collect_information(runs, model) for runs in ([run], [run, run]))
    once, twice = (np.diag(np.linalg.inv(combine_runs(x).matrix)) for x in told)
    assert np.sqrt(twice / once) == pytest.approx(1 / np.sqrt(2), rel=1e-6)
    again = estimate(moving, moving)
    # What the prior bridges between lines, the same lines again do not tell.
    assert 0.68 < volumetric_sigma(again) / volumetric_sigma(alone) < 0.9


def test_tools_of_separate_runs_are_told_apart_as_in_one():
    offsets = (SHORT, LONG, ASIDE)
    seen = [seen_of(10 + k, offset_mm=offset) for k, offset in enumerate(offsets)]
    result = estimate(*seen)
    assert len(result.model.identifiable_motions) == 18
    assert result.observability.rank == 87
    assert not result.observability.unobservable
    for offset in offsets:
        left = judge(result, offset)
        assert left.share < 0.1
        assert left.inside > 0.85


def test_two_machines_are_refused_with_run_and_field(moving, standing):
    machine = standing.at.machine
    x, *others = machine.axes
    other = replace(machine, axes=(replace(x, high=611.0), *others))
    elsewhere = replace(standing, at=replace(standing.at, machine=other))
    with pytest.raises(BundleError, match=r"b/machine\.json: axes\.X\.max_mm is 611"):
        estimate(moving, elsewhere, names=["a", "b"])


def test_the_sum_over_runs_is_the_solve_with_every_pose_stacked(moving, standing):
    noise = NoiseModel((1.0, 1.0), (0.0, 0.0, 0.0), 1.0, 0.0)
    runs = [RunInput(seen, seen.pose, noise) for seen in (moving, standing)]
    offsets_mm = moving.at.offset_mm, standing.at.offset_mm
    model, _ = build_identifiable_model(moving.at.machine, *offsets_mm, intervals=5)
    shares = collect_information(runs, model)
    own = [len(share.data.vector) - model.size for share in shares]
    stacked = np.zeros((model.size + sum(own), model.size + sum(own)))
    vector = np.zeros(len(stacked))
    begin = model.size
    for share, count in zip(shares, own, strict=True):
        place = np.r_[: model.size, begin : begin + count]
        stacked[np.ix_(place, place)] += share.data.matrix
        vector[place] += share.data.vector
        begin += count
    data = combine_runs(shares)
    expected = np.linalg.solve(stacked, vector)[: model.size]
    found = np.linalg.solve(data.matrix, data.vector)
    sigma = np.sqrt(np.diag(np.linalg.inv(stacked))[: model.size])
    assert np.abs((found - expected) / sigma).max() < 1e-5
    combined = np.sqrt(np.diag(np.linalg.inv(data.matrix)))
    assert combined == pytest.approx(sigma, rel=1e-6)


def by_source(estimate):
    variance = budget.split_uncertainty(estimate).variance_mm2
    return dict(zip(budget.SOURCES, variance.sum(axis=1), strict=True))


def test_sources_add_up_to_the_uncertainty_and_runs_take_some_away(record_small):
    runs = [record_small(k, rows=n, machine_seed=71)[0] for k, n in ((1, 16), (2, 9))]
    found = estimate(*map(align, runs))
    parts = by_source(found)
    total = sum(parts.values())
    brought = budget.compute_contributions(found, (0, 1))
    stated = brought.sigma_mm
    assert np.sqrt(total) == pytest.approx(stated, rel=1e-9)
    gram = compute_volumetric_gram(found.model)
    assert stated == pytest.approx(np.sqrt(np.sum(gram * found.covariance)))
    assert min(parts.values()) > -1e-3 * total  # the step of a derivative
    for source in ("tracker", "air", "alignment", "model"):
        assert parts[source] > 1e-3 * total, source
    assert parts["thermal"] == parts["effects"] == 0.0
    without_long, without_short = brought.without_mm
    assert stated < without_short < without_long
    assert budget.compute_contributions(found, (0, 0)).without_mm == ()


def test_the_part_of_the_tracker_is_its_noise_sent_through_the_solve(record):
    at_points = estimate(align(record(2, "standstill", rows=40)[0]))
    fit = at_points.fit
    (run,), size = fit.runs, fit.model.size
    design = run.linearisation.build(run.observations)
    J = design.columns[:, :, :size].reshape(-1, size)
    whitened = design.whiten(run.noise).apply(design.columns[:, :, :size])
    whitened = whitened.reshape(-1, size)
    prior = fit.prior.precision_matrix(size)
    gain = np.linalg.solve(J.T @ whitened + prior, whitened.T)
    precision, _ = cell_noise(run.observations, run.noise, design.travel)
    gain = gain.reshape(size, -1, 3)
    spread = np.einsum("pni,nij,qnj->pq", gain, np.linalg.inv(precision), gain)
    gram = compute_volumetric_gram(fit.model)
    expected = pytest.approx(np.sum(gram * spread), rel=1e-3)
    assert by_source(at_points)["tracker"] == expected
