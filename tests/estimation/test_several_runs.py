"""Several Runs of one machine in one estimate, against exact truth."""

from dataclasses import replace

import numpy as np
import pytest
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.errors import BundleError, Unidentifiable
from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.problem.runs import RunInput, collect_information, combine_runs
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting

MACHINE = 71  # the machine of every recording; noise, clock and pose are another's
SHORT, LONG, ASIDE = (20.0, 30.0, -150.0), (20.0, 30.0, -300.0), (140.0, -60.0, -200.0)


def content_with(offset_mm=SHORT, chain="w-X-b-Y-Z-t"):
    content = {**load_machine("demo"), "kinematic_chain": chain}
    content.pop("targets", None)
    return {**content, "tool_offset_mm": list(offset_mm)}


def recorded(seed, mode="otf", rows=24, offset_mm=SHORT, setting=None):
    content = content_with(offset_mm)
    parsed = parse_machine(content)
    if mode == "otf":
        program = paths.chord_path(parsed, seed, rows, 10_000.0)
    else:
        program = paths.standstill_points(parsed, seed, rows, dwell_s=0.5)
    setting = replace(setting or Setting(), machine_seed=MACHINE)
    made = synthetic.record(content, program, seed, mode, setting)
    machine = machine_from_json(content)
    commanded = (
        Path(
            machine.axis_names,
            program.position,
            program.feed_mm_s * 60.0,
            program.dwell_s,
        )
        if mode == "otf"
        else Configurations(machine.axis_names, program.position, program.dwell_s)
    )
    samples = TrackerSamples(
        np.arange(len(made)), made.time_s, made.position_mm, made.status
    )
    return Run(f"run-{seed}", machine, commanded, samples), made


def seen_of(*args, **options):
    return align(recorded(*args, **options)[0])


@pytest.fixture(scope="module")
def moving():
    return seen_of(1)


@pytest.fixture(scope="module")
def standing():
    return seen_of(2, "standstill", rows=40)


@pytest.fixture(scope="module")
def judge(rigid_free, volume):
    """Return (share of the error left, share of truth inside 2u) for a tool."""

    def judged(result, offset_mm=SHORT):
        truth = random_machine(parse_machine(content_with(offset_mm)), MACHINE)
        machine = result.model.machine
        target = next(t for t in machine.targets if t.offset_mm == offset_mm)
        q = volume(machine)
        at = make_standstill(machine, q, np.tile(offset_mm, (len(q), 1)))
        maps = build_volumetric_map(result.model, target.name)
        before = rigid_free(q, truth.deviation_mm(q))
        left = before - rigid_free(q, maps.error_mm(at, result.theta))
        inside = np.abs(left) < 2 * maps.sigma_mm(at, result.covariance)
        share = (
            np.linalg.norm(left, axis=1).mean() / np.linalg.norm(before, axis=1).mean()
        )
        return share, float(inside.mean())

    return judged


def volumetric_sigma(result):
    machine = result.model.machine
    q = np.random.default_rng(3).uniform(
        [a.low for a in machine.axes], [a.high for a in machine.axes], (200, 3)
    )
    sigma = build_volumetric_map(result.model).sigma_mm(
        make_standstill(machine, q), result.covariance
    )
    return float(np.sqrt(np.mean(sigma**2)))


def motions(result):
    return result.model.identifiable_motions


def test_both_modes_together_leave_less_than_each_alone(moving, standing, judge):
    alone = [judge(estimate(seen))[0] for seen in (moving, standing)]
    result = estimate(moving, standing)
    share, inside = judge(result)
    assert share < min(alone)
    assert 0.85 < inside <= 1.0
    assert 0.85 < result.rms_mm / result.floor_mm < 1.1


def test_each_run_keeps_a_tracker_pose_and_a_noise_of_its_own():
    loud = Setting(noise_scale=3.0, air=Air(share=0.3, tau_s=0.6))
    (near, one), (far, other) = recorded(3), recorded(4, setting=loud)
    result = estimate(align(near), align(far))
    for run, made in zip(result.runs, (one, other), strict=True):
        corner = np.array([[300.0, 200.0, 100.0]])
        apart = run.pose.apply(corner) - made.pose.from_table(corner)
        assert np.linalg.norm(apart) < 0.2  # the machine's own rigid motion
    quiet, noisy = (run.noise for run in result.runs)
    assert np.divide(noisy.white, quiet.white) == pytest.approx(3.0, rel=0.1)
    assert noisy.ou == pytest.approx((0.9, 0.9), rel=0.4)


def test_a_loud_run_does_not_spoil_a_quiet_one(moving, judge):
    loud = seen_of(4, setting=Setting(noise_scale=5.0))
    quiet, both = estimate(moving), estimate(moving, loud)
    assert judge(both)[0] < 1.1 * judge(quiet)[0]
    assert volumetric_sigma(both) < 1.01 * volumetric_sigma(quiet)


def test_the_same_run_twice_halves_the_variance_that_noise_makes(moving):
    run = RunInput(moving, moving.pose, NoiseModel((1.0, 1.0), (0.2, 0.2), 1.0, 1e-4))
    at = moving.at
    model, _ = build_identifiable_model(at.machine, at.offset_mm, intervals=5)
    once, twice = (
        np.diag(np.linalg.inv(combine_runs(collect_information(runs, model)).matrix))
        for runs in ([run], [run, run])
    )
    assert np.sqrt(twice / once) == pytest.approx(1 / np.sqrt(2), rel=1e-6)


def test_a_repeated_run_shrinks_the_uncertainty(moving):
    once, twice = estimate(moving), estimate(moving, moving)
    # What the prior bridges between lines, the same lines again do not tell.
    assert 0.7 < volumetric_sigma(twice) / volumetric_sigma(once) < 0.9


def test_the_order_of_the_runs_does_not_matter(moving, standing):
    a, b = estimate(moving, standing), estimate(standing, moving)
    u = np.sqrt(np.diag(a.covariance))
    assert (np.abs(a.theta - b.theta) < 0.2 * u).all()
    assert [run.cells for run in a.runs] == [run.cells for run in b.runs][::-1]


@pytest.mark.parametrize(
    ("offsets", "known", "rank"),
    [((SHORT, LONG), 16, 77), ((SHORT, LONG, ASIDE), 18, 87)],
)
def test_tools_of_separate_runs_are_told_apart_as_in_one(offsets, known, rank, judge):
    """Ranks 79 and 90 of one Run, less the two or three turns of how tools sit."""
    seen = [seen_of(10 + k, offset_mm=offset) for k, offset in enumerate(offsets)]
    result = estimate(*seen)
    assert len(motions(result)) == known
    assert result.observability.rank == rank
    named = {text.split()[0] for text in result.observability.unobservable}
    assert len(named) == 18 - known
    for offset in offsets:
        share, inside = judge(result, offset)
        assert share < 0.1
        assert inside > 0.85


def test_a_run_that_is_too_short_alone_adds_to_another(moving, standing):
    few = standing.select(np.flatnonzero(standing.row < 5))
    with pytest.raises(Unidentifiable):
        estimate(few)
    both = estimate(moving, few)
    assert volumetric_sigma(both) < volumetric_sigma(estimate(moving))
    assert both.runs[1].lines == 5


def test_two_machines_are_refused_with_run_and_field(moving, standing):
    machine = standing.at.machine
    other = replace(
        machine, axes=(replace(machine.axes[0], high=611.0), *machine.axes[1:])
    )
    elsewhere = replace(standing, at=replace(standing.at, machine=other))
    with pytest.raises(BundleError, match=r"b/machine\.json: axes\.X\.max_mm is 611"):
        estimate(moving, elsewhere, names=["a", "b"])


def test_the_sum_over_runs_is_the_solve_with_every_pose_stacked(moving, standing):
    noise = NoiseModel((1.0, 1.0), (0.0, 0.0), 1.0, 0.0)
    runs = [RunInput(seen, seen.pose, noise) for seen in (moving, standing)]
    model, _ = build_identifiable_model(
        moving.at.machine, moving.at.offset_mm, standing.at.offset_mm, intervals=5
    )
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
    assert np.sqrt(np.diag(np.linalg.inv(data.matrix))) == pytest.approx(
        sigma, rel=1e-6
    )
