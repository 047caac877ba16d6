"""What a tracker does, of one place and of the next, is in what is stated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from estimating import judge_map
from following import follow, list_blocks, list_point_blocks, shift
from recorded import choose_program, load_erring, load_small, record_run
from truepath.alignment.align import align
from truepath.discovery.discover import discover
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.normal_equations import RunInput
from truepath.files.bundle.run import PointRows
from truepath.kinematics.coarse_model import build_coarse_model
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.results.analysis import analyse
from truepath.results.result_assessment import assess_discovery, assess_live
from truepath.results.result_json import result_json
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.hidden.setup import TrackerRangeOffset
from truepath_simulators.machine.tracker_head import random_pose
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.synthetic import Setting

SIGNED = {"index_urad": 60.0, "tilt_urad": 30.0, "transit_offset_um": 40.0}
POINTS, WRONG = 52, 20  # points beside the corners; the one that is wrong


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
    stated = [result_json(measure(14, places=places)[0]) for places in (1, 2)]
    assert "tracker-errors" not in str(stated)
    assert "set-up-errors" not in str(stated)
    one, two = (content["uncertainty_budget"] for content in stated)
    whole_um = one["total_um"]["volume"]
    assert one["sources_um"]["instrument"]["volume"] > 0.5 * whole_um
    assert two["total_um"]["volume"] < 0.8 * whole_um


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
    pair = [(compute_volumetric_gram(x.model), x.covariance) for x in (one, both)]
    stated = [np.sum(gram * covariance) ** 0.5 for gram, covariance in pair]
    assert stated[1] < 0.6 * stated[0]
    assert judge_map(both, recorded[0][1].truth.deviation_mm).inside > 0.86


@pytest.fixture(scope="module")
def still():
    made = load_small("demo", 0.5)
    return record_run(made, choose_program(made, 21, rows=40), 21)


def find_directions(vector):
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def disturb(recorded, across_mm):
    """Return findings, and the share inside two sigma, of directions that are off."""
    side = find_directions(np.cross([0.0, 0.0, 1.0], recorded[0].tracker.position_mm))
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


def stand(seed, **how):
    made = load_small("demo", 0.5)
    made["tracker"]["specification"] = {}
    made["tracker"]["rate_hz"] = how.pop("rate_hz", 100.0)
    program = paths.standstill_points(parse_machine(made), seed, POINTS, dwell_s=0.4)
    return record_run(made, program, seed, "standstill", Setting(**how))


def shoot(seed, **how):
    run, made = stand(seed, rate_hz=5.0, **how)
    first = np.searchsorted(made.row, np.arange(len(run.commanded)), "right") - 1
    n = np.arange(len(first))
    at = made.time_s[first], made.position_mm[first]
    return run, made, TrackerSamples(n, *at, np.zeros_like(n))


def take_shots(run, shots):
    n = shots.sequence
    rows = PointRows(n, np.ones_like(n), np.zeros((len(n), 3, 3)))
    return replace(run, tracker=shots, points=rows)


def find_noise(seen):
    model = build_coarse_model(seen.at.machine, [seen.at.offset_mm])
    start = guess_noise(seen, perpendicular_only=False)
    return refine_runs(model, [RunInput(seen, seen.pose, start)])[0].noise


def differ(seed):
    rng = np.random.default_rng([seed, 77])
    run, made = stand(seed)
    sizes_um = [rng.uniform(8, 11), rng.uniform(12, 13), rng.uniform(3, 9)]
    tails = rng.standard_t(6, (len(run.commanded), 3)) / np.sqrt(1.5)
    each_mm = (1e-3 * tails * sizes_um)[np.clip(made.row, 0, len(tails) - 1)]
    beam = find_directions(run.tracker.position_mm)
    aside = find_directions(np.cross([0.0, 0.0, 1.0], beam))
    frame = np.stack([beam, aside, np.cross(beam, aside)], axis=1)
    share = np.linspace(0.0, 3.0, len(run.tracker))
    way = rng.standard_normal(3)
    course = np.sin(rng.uniform(0.0, 2.0 * np.pi) + share)[:, None] * way
    drift_mm = 0.015 * course / np.linalg.norm(way)
    moved = shift(run, np.einsum("ni,nij->nj", each_mm, frame) + drift_mm)
    return moved, made, sizes_um


@pytest.fixture(scope="module")
def differing():
    return differ(4)


@pytest.fixture(scope="module")
def found(differing):
    return analyse(differing[0])


def test_places_that_differ_are_told_in_numbers_and_none_is_left_out(differing, found):
    _, made, sizes_um = differing
    content = result_json(found)
    assert found.verdict.state in ("usable", "doubtful")
    assert content["left_out"] == content["setup_steps"] == []
    assert judge_map(found.estimate, made.truth.deviation_mm).inside > 0.85
    (told,) = (each for each in found.verdict.reasons if each.kind == "places-differ")
    stated_um = list(content["noise"]["between_places_um"].values())
    names = ("range", "azimuth", "elevation")
    assert stated_um == [told.values[f"{name}_um"] for name in names]
    assert stated_um == pytest.approx(sizes_um, rel=0.4)


def test_one_that_is_wrong_is_left_out_for_what_the_others_differ_by(differing, found):
    run, made, _ = differing
    wrong = made.row == WRONG
    spoilt = analyse(shift(run, wrong[:, None] * [0.09, -0.1, 0.07]))
    assert {each["row"] for each in result_json(spoilt)["left_out"]} == {WRONG}
    sizes = [each.estimate.runs[0].noise.place for each in (found, spoilt)]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.2)


def test_a_wrong_home_distance_is_no_difference_between_places():
    made = load_small("demo", 1.0)
    made["tracker"]["specification"] = {"range_offset_um": 4.0}
    program = paths.standstill_points(parse_machine(made), 3, 150, dwell_s=0.4)
    setting = Setting(hidden=(TrackerRangeOffset(-60.0),))
    found = analyse(record_run(made, program, 3, "standstill", setting)[0])
    assert found.setup_shifts == ()
    (reason,) = found.verdict.reasons
    assert reason.kind == "range-off"
    off_um, within_um = (reason.values[f"{k}_um"] for k in ("distance", "within"))
    assert abs(off_um + 60.0) < 1.5 * within_um < 20.0
    assert max(found.estimate.runs[0].noise.place) < 0.4


def test_knots_that_are_far_apart_are_no_difference_between_places(record):
    run, _ = record(3, "standstill", rows=30, travel_mm=120.0)
    assert max(analyse(run).estimate.runs[0].noise.place) < 0.4


def test_single_shots_are_as_uncertain_as_they_scatter():
    quiet = 0.3  # of the stated noise, of which shots say nothing
    run, made, shots = shoot(3, noise_scale=quiet)
    estimate = analyse(take_shots(run, shots)).estimate
    noise = estimate.runs[0].noise
    each = np.hypot(noise.place, noise.ou)
    assert np.sqrt(np.mean(each**2)) == pytest.approx(quiet, rel=0.2)
    assert judge_map(estimate, made.truth.deviation_mm).inside > 0.85


def test_few_single_shots_are_about_as_uncertain_as_the_tracker_is_stated():
    run, _, shots = shoot(3)
    seen = align(take_shots(run, shots))
    noise = find_noise(seen.select(np.arange(0, len(seen), 4)))
    each = np.hypot(noise.place, noise.ou)
    assert 0.4 < np.sqrt(np.mean(each**2)) < 1.6


def test_a_tracker_quieter_than_stated_is_as_certain_as_one_stated_so():
    quiet = 0.05
    run, _ = stand(3, noise_scale=quiet)
    tracker = run.machine.tracker
    sizes = "range_sigma_um", "range_ppm", "angle_sigma_urad", "transverse_sigma_um"
    told = {name: quiet * getattr(tracker, name) for name in sizes}
    honest = replace(run.machine, tracker=replace(tracker, **told))
    both = run, replace(run, machine=honest)
    found, expected = (analyse(each).contributions.sigma_mm for each in both)
    assert found == pytest.approx(expected, rel=0.1)


def test_many_places_that_do_not_differ_say_so():
    noise = find_noise(align(stand(3)[0]))
    assert max(noise.place) < 0.14


@pytest.mark.long
def test_stated_intervals_hold_the_truth_where_places_differ():
    inside = []
    for seed in range(1, 9):
        run, made, _ = differ(seed)
        estimate = analyse(run).estimate
        inside.append(judge_map(estimate, made.truth.deviation_mm).inside)
    assert 0.9 < np.mean(inside) < 0.97


def test_a_discovery_names_nothing_for_it_and_its_model_may_be_used(differing):
    found = discover([differing[0]])
    assert found.findings == found.possible == ()
    verdict = assess_discovery(found, None)
    assert verdict.state == "doubtful"
    assert "places-differ" in {reason.kind for reason in verdict.reasons}


def test_a_live_estimate_names_no_knock_where_places_differ(differing):
    (run, *_) = differing
    followed = follow(run, blocks=list_blocks(run, 200))
    last = followed.last
    assert last.check.setup_shifts == last.check.left_out == ()
    way = (assess_live(each.check, each.done) for each in followed.on_the_way)
    assert "not-usable" not in {verdict.state for verdict in way}
    verdict = assess_live(last.check, last.done)
    assert [reason.kind for reason in verdict.reasons] == ["places-differ"]


def test_a_live_estimate_of_single_shots_holds_none_back():
    run, _, shots = shoot(5)
    followed = follow(run, blocks=list_point_blocks(take_shots(run, shots)))
    assert all(each.check.held == () for each in followed.on_the_way)
    assert followed.last.check.setup_shifts == ()
