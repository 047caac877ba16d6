"""What a tracker says of one place differs from the next: stated, and not blamed."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import judge_map
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.discovery.discover import discover
from truepath.estimation.live.live import LiveEstimator
from truepath.estimation.noise.noise_fit import guess_noise, refine_runs
from truepath.estimation.problem.runs import RunInput
from truepath.files.bundle.run import PointBlock, PointRows
from truepath.kinematics.coarse_model import build_coarse_model
from truepath.results.analysis import analyse
from truepath.results.result_assessment import assess_discovery, assess_live
from truepath.results.result_json import result_json
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.hidden.tracker import TrackerRangeOffset
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds.synthetic import Setting

POINTS, WRONG = 52, 20  # points beside the corners; the one that is wrong


def stand(seed, **how):
    """Return the Run of a perfect tracker at points, and its recording."""
    made = load_small("demo", 0.5)
    made["tracker"]["specification"] = {}
    made["tracker"]["rate_hz"] = how.pop("rate_hz", 100.0)
    program = paths.standstill_points(parse_machine(made), seed, POINTS, dwell_s=0.4)
    return record_run(made, program, seed, "standstill", Setting(**how))


def shoot(seed, **how):
    """A Run at points, its recording, and one sample of each point."""
    run, made = stand(seed, rate_hz=5.0, **how)
    first = np.searchsorted(made.row, np.arange(len(run.commanded)), "right") - 1
    n = np.arange(len(first))
    at = made.time_s[first], made.position_mm[first]
    return run, made, TrackerSamples(n, *at, np.zeros_like(n))


def take_shots(run, shots):
    """Return the Run with single shots, of whose scatter nothing is known."""
    n = shots.sequence
    rows = PointRows(n, np.ones_like(n), np.zeros((len(n), 3, 3)))
    return replace(run, tracker=shots, points=rows)


def find_noise(seen):
    """Return the noise of a Run, beside a machine of which nothing is known."""
    model = build_coarse_model(seen.at.machine, [seen.at.offset_mm])
    start = guess_noise(seen, perpendicular_only=False)
    return refine_runs(model, [RunInput(seen, seen.pose, start)])[0].noise


def move(run, moved_mm):
    position_mm = run.tracker.position_mm + moved_mm
    return replace(run, tracker=replace(run.tracker, position_mm=position_mm))


def differ(seed):
    """Return a Run whose places differ as a real tracker's do, and drift; its truth."""
    rng = np.random.default_rng([seed, 77])
    run, made = stand(seed)
    sizes_um = [rng.uniform(8, 11), rng.uniform(12, 13), rng.uniform(3, 9)]
    tails = rng.standard_t(6, (len(run.commanded), 3)) / np.sqrt(1.5)
    each_mm = (1e-3 * tails * sizes_um)[np.clip(made.row, 0, len(tails) - 1)]
    beam = run.tracker.position_mm / np.linalg.norm(
        run.tracker.position_mm, axis=1, keepdims=True
    )
    aside = np.cross([0.0, 0.0, 1.0], beam)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    frame = np.stack([beam, aside, np.cross(beam, aside)], axis=1)
    share = np.linspace(0.0, 3.0, len(run.tracker))
    way = rng.standard_normal(3)
    course = np.sin(rng.uniform(0.0, 2.0 * np.pi) + share)[:, None] * way
    drift_mm = 0.015 * course / np.linalg.norm(way)
    return move(run, np.einsum("ni,nij->nj", each_mm, frame) + drift_mm), made, sizes_um


@pytest.fixture(scope="module")
def differing():
    return differ(4)


@pytest.fixture(scope="module")
def found(differing):
    return analyse(differing[0])


def test_places_that_differ_are_told_with_numbers_and_none_is_left_out(
    differing, found
):
    _, made, sizes_um = differing
    content = result_json(found)
    assert found.verdict.state in ("usable", "doubtful")
    assert content["left_out"] == content["setup_steps"] == []
    assert judge_map(found.estimate, made.truth.deviation_mm).inside > 0.85
    (told,) = (each for each in found.verdict.reasons if each.kind == "places-differ")
    stated_um = list(content["noise"]["between_places_um"].values())
    assert stated_um == [
        told.values[f"{d}_um"] for d in ("range", "azimuth", "elevation")
    ]
    assert stated_um == pytest.approx(sizes_um, rel=0.4)


def test_one_that_is_wrong_is_left_out_for_what_the_others_differ_by(differing, found):
    run, made, _ = differing
    wrong = made.row == WRONG
    spoilt = analyse(move(run, wrong[:, None] * [0.09, -0.1, 0.07]))
    assert {each["row"] for each in result_json(spoilt)["left_out"]} == {WRONG}
    sizes = [each.estimate.runs[0].noise.place for each in (found, spoilt)]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.2)


def test_a_wrong_home_distance_is_no_difference_between_places():
    """It bends the volume smoothly: no two places beside each other differ by it."""
    made = load_small("demo", 1.0)
    made["tracker"]["specification"] = {"range_offset_um": 4.0}
    program = paths.standstill_points(parse_machine(made), 3, 150, dwell_s=0.4)
    setting = Setting(hidden=(TrackerRangeOffset(-60.0),))
    found = analyse(record_run(made, program, 3, "standstill", setting)[0])
    assert found.knocks == ()
    (reason,) = found.verdict.reasons
    assert reason.kind == "range-off"
    off_um, within_um = (reason.values[f"{k}_um"] for k in ("distance", "within"))
    assert abs(off_um + 60.0) < 1.5 * within_um < 20.0
    assert max(found.estimate.runs[0].noise.place) < 0.4


def test_knots_that_are_far_apart_are_no_difference_between_places():
    """Between them a short machine bends by more than its tracker's noise."""
    made = load_machine("demo")
    for axis in made["axes"].values():
        axis["max_mm"] = axis["min_mm"] + 120.0
    program = paths.standstill_points(parse_machine(made), 3, 30, dwell_s=0.8)
    found = analyse(record_run(made, program, 3, "standstill")[0])
    assert max(found.estimate.runs[0].noise.place) < 0.4


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
    found, expected = (
        analyse(each).contributions.sigma_mm
        for each in (run, replace(run, machine=honest))
    )
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


def follow(run):
    """States of a live estimate on the way, and the last."""
    live, states = LiveEstimator(run.machine, run.commanded), []
    for begin in range(0, len(run.tracker), 200):
        if live.add_block(run.tracker.select(slice(begin, begin + 200))):
            now = live.estimate()
            states.append(assess_live(now.check, now.done).state)
    live.finish()
    return states, live.estimate()


def test_a_live_estimate_names_no_knock_where_places_differ(differing):
    states, last = follow(differing[0])
    assert last.check.knocks == last.check.left_out == ()
    assert "not-usable" not in states
    verdict = assess_live(last.check, last.done)
    assert [reason.kind for reason in verdict.reasons] == ["places-differ"]


def test_a_live_estimate_of_single_shots_holds_none_back():
    run, _, shots = shoot(5)
    one, unknown = np.ones(1, np.int64), np.zeros((1, 3, 3))
    live = LiveEstimator(run.machine, run.commanded)
    for k in shots.sequence:
        rows = PointRows(shots.sequence[k : k + 1], one, unknown)
        if live.add_block(PointBlock(shots.select(slice(k, k + 1)), rows)):
            assert live.estimate().check.held == ()
    live.finish()
    assert live.estimate().check.knocks == ()
