"""What a tracker within its specification does is in what is stated."""

import numpy as np
import pytest
from scipy.signal import lfilter

from estimating import judge_map
from following import shift
from recorded import choose_program, load_erring, load_small, record_run
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.machine.tracker_head import random_pose
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.synthetic import Setting


def measure(seed, places=1):
    content, order = load_erring(), ("otf", Setting(machine_seed=seed))
    program = choose_program(content, seed)
    recorded = [record_run(content, program, seed + k, *order) for k in range(places)]
    return analyse(*(run for run, _ in recorded)), recorded[0][1].truth


@pytest.mark.long
def test_what_is_stated_of_two_places_holds_what_the_tracker_does():
    inside = []
    for seed in (11, 12, 13):
        found, truth = measure(seed, places=2)
        inside.append(judge_map(found.estimate, truth.deviation_mm).inside)
    assert np.mean(inside) > 0.86
    assert min(inside) > 0.6


def test_the_budget_tells_what_is_the_trackers_and_a_second_place_takes_it_away():
    one, two = (
        result_json(measure(14, places=places)[0])["uncertainty_budget"]
        for places in (1, 2)
    )
    whole_um = one["total_um"]["volume"]
    assert one["sources_um"]["instrument"]["volume"] > 0.5 * whole_um
    assert two["total_um"]["volume"] < 0.8 * whole_um


SIGNED = {"index_urad": 60.0, "tilt_urad": 30.0, "transit_offset_um": 40.0}


def test_a_run_in_the_other_face_takes_away_what_changes_its_sign_in_it():
    made = load_erring(SIGNED)
    program = choose_program(made, 17)
    pose = random_pose(parse_machine(made), 17)
    setting = Setting(machine_seed=17, pose=pose)
    recorded = []
    for face in (1, 2):
        made["tracker"]["face"] = face
        recorded.append(record_run(made, program, 17 + face, setting=setting))
    runs = [run for run, _ in recorded]
    one, both = (analyse(*some).estimate for some in (runs[:1], runs))
    stated = [
        np.sum(compute_volumetric_gram(each.model) * each.covariance) ** 0.5
        for each in (one, both)
    ]
    assert stated[1] < 0.6 * stated[0]
    assert judge_map(both, recorded[0][1].truth.deviation_mm).inside > 0.86


def test_errors_of_the_tracker_are_no_errors_of_the_machine():
    found, _ = measure(15)
    said = str(result_json(found))
    assert "tracker-errors" not in said
    assert "set-up-errors" not in said


@pytest.fixture(scope="module")
def still():
    made = load_small("demo", 0.5)
    return record_run(made, choose_program(made, 21, rows=40), 21)


def disturb(recorded, across_mm):
    """Return findings, and the share inside two sigma, of directions that are off."""
    points = recorded[0].tracker.position_mm
    side = np.cross([0.0, 0.0, 1.0], points)
    side /= np.linalg.norm(side, axis=1)[:, None]
    return analyse_moved(recorded, across_mm[:, None] * side)


def analyse_moved(recorded, moved_mm):
    run, made = recorded
    found = analyse(shift(run, moved_mm))
    return found, judge_map(found.estimate, made.truth.deviation_mm).inside


def test_noise_in_azimuth_alone_is_found_there_and_is_in_what_is_stated(still, rng):
    count, keep = len(still[0].tracker), np.exp(-0.01 / 0.7)  # at 100 Hz, in 0.7 s
    drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(count)
    azimuth_mm = 0.006 * lfilter([1.0], [1.0, -keep], drive)
    found, inside = disturb(still, azimuth_mm)
    along, azimuth, elevation = found.estimate.runs[0].noise.ou
    assert azimuth > 2.0 * max(along, elevation)
    assert inside > 0.85
    assert found.verdict.state == "usable"  # neighbours in space show it


def test_a_swing_of_some_hertz_is_no_scatter_of_samples(still):
    time_s = still[0].tracker.device_time_s
    found, inside = disturb(still, 0.008 * np.sin(2.0 * np.pi * 4.3 * time_s))
    noise = found.estimate.runs[0].noise
    assert noise.fast[1] > 1.2
    assert max(noise.white) < 1.6
    assert inside > 0.85


def test_jitter_of_the_feed_is_no_noise_across_it(still, rng):
    points = still[0].tracker.position_mm
    way = np.gradient(points, axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=1)[:, None], 0.01)  # mm: it drives
    jitter_mm = np.repeat(0.008 * rng.standard_normal(len(points) // 12 + 1), 12)
    found, inside = analyse_moved(still, jitter_mm[: len(points), None] * way)
    noise = found.estimate.runs[0].noise
    assert noise.along_sigma_mm > 0.003
    assert noise.fast == (1.0, 1.0)
    assert max(noise.shown) < 0.4
    assert inside > 0.85
