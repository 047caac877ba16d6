"""What a tracker within its specification adds is in what a verification states."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from tests.system.results.test_verification import Compensated

from recorded import choose_program, load_erring, record_path, record_run
from truepath.answers.verification.matched_points import predict_displacement
from truepath.answers.verification.verification import verify
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import result_from_json
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.motion.paths.verification_points import make_circle_path
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.synthetic import Setting

TIGHT_UM, WIDE_UM = 1.0, 5.0  # tolerances: one is less than such a tracker can tell
PERFECT = TrackerSpecification(**dict.fromkeys(asdict(TrackerSpecification()), 0.0))


def draw_specification(seed):
    rng = np.random.default_rng([seed, 3])
    usual = asdict(TrackerSpecification())
    return {key: size * 2.0 ** rng.uniform(-1.0, 1.0) for key, size in usual.items()}


class World:
    def __init__(self, seed, specification=None):
        stated = draw_specification(seed) if specification is None else specification
        self.seed, self.content = seed, load_erring(stated)
        self.truth = random_machine(parse_machine(self.content), seed)
        program = choose_program(self.content, seed)
        run = self._record(program, seed, "otf", self.truth, tracker=seed)
        read = json.loads(json.dumps(result_json(analyse(run))))
        self.result = result_from_json(read)

    def _record(self, program, seed, mode, truth, tracker):
        setting = Setting(machine_seed=tracker, truth=truth)
        return record_run(self.content, program, seed, mode, setting)[0]

    def measure(self, mode, truth, *, is_same_tracker):
        seed = self.seed + 500
        program = choose_program(self.content, seed, mode, rows=14, points=30)
        tracker = self.seed if is_same_tracker else seed
        return self._record(program, seed, mode, truth, tracker)

    def drive_circles(self, truth):
        path = make_circle_path(machine_from_json(self.content, file="machine.json"))
        setting = Setting(machine_seed=self.seed, truth=truth)
        return record_path(self.content, path, self.seed + 700, setting=setting)[0]

    @property
    def compensated(self):
        truth = self.truth
        known = truth.machine, truth.joints, truth.squareness_rad
        return Compensated(*known, correction=lambda q: -truth.deviation_mm(q))


def count_held(found, truth):
    places, N = found.points, found.points.nuisance
    true = places.project(truth.deviation_mm(places.cells.position_mm))
    true = places.collect(true - N @ (np.linalg.pinv(N, rcond=1e-12) @ true))
    off_um, sigma_um = 1e3 * (found.measured.vector_mm - true), found.measured.sigma_um
    return float(np.mean(np.abs(off_um) <= 2.0 * sigma_um + 1e-6))


@pytest.fixture(scope="module")
def worlds():
    return [World(seed) for seed in range(1, 6)]


@pytest.mark.parametrize(
    ("mode", "is_same_tracker"),
    [("standstill", True), ("standstill", False), ("otf", False)],
)
def test_a_verification_is_not_failed_by_its_tracker(worlds, mode, is_same_tracker):
    held: list[float] = []
    for world in worlds:
        run = world.measure(mode, world.truth, is_same_tracker=is_same_tracker)
        found = verify(world.result, run, tolerance_um=WIDE_UM)
        assert found.consistency.is_consistent
        assert found.conformity["deviation"].conformity != "outside"
        held.append(count_held(found, world.truth))
    assert np.mean(held) >= 0.9


@pytest.mark.parametrize("mode", ["standstill", "otf"])
def test_nor_is_a_machine_that_is_compensated_perfectly(worlds, mode):
    held: list[float] = []
    for world in worlds:
        run = world.measure(mode, world.compensated, is_same_tracker=True)
        result = world.result

        def take_off(at, result=result):
            return -predict_displacement(result, at)

        found = verify(result, run, tolerance_um=TIGHT_UM, correction=take_off)
        assert found.consistency.is_consistent
        assert {one.conformity for one in found.conformity.values()} == {"undecided"}
        stated = found.statistics["measured"]["mean"]
        assert stated.value_um <= 2.0 * stated.uncertainty_um
        held.append(count_held(found, world.compensated))
    assert np.mean(held) >= 0.9


def test_circles_of_an_exact_machine_are_exact_within_what_is_stated(worlds):
    held: list[bool] = []
    for world in worlds:
        run = world.drive_circles(world.compensated)
        for one in verify(world.result, run).circles.circles:
            value, sigma = one.measured.value_um, one.measured.uncertainty_um
            held += [abs(value[name]) <= 2.0 * sigma[name] for name in value]
    assert np.mean(held) >= 0.9
    world = worlds[0]
    run = world.drive_circles(world.compensated)
    perfect = replace(run.machine.tracker, specification=PERFECT)
    clean = replace(run, machine=replace(run.machine, tracker=perfect))
    both = (verify(world.result, each).circles.circles for each in (run, clean))
    for erring, exact in zip(*both, strict=True):
        stated = [each.measured.uncertainty_um["F_max"] for each in (erring, exact)]
        assert stated[0] > 1.1 * stated[1]


def test_of_a_perfect_tracker_noise_and_scale_are_all_there_is():
    world = World(1, specification={})
    run = world.measure("standstill", world.truth, is_same_tracker=True)
    found = verify(world.result, run)
    places, N = found.points, found.points.nuisance
    M = np.eye(len(N)) - N @ np.linalg.pinv(N, rcond=1e-12)
    point = places.cells.point_mm
    away = places.project(point - point.mean(axis=0))
    scaled = 1e-6 * found.runs[0].scale_ppm * away
    covariance = M @ (places.noise_mm2 + np.outer(scaled, scaled)) @ M
    expected = places.collect_covariance(covariance)
    np.testing.assert_allclose(found.deviation.covariance_mm2, expected, atol=1e-12)
