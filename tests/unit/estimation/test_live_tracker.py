"""Live and batch know what a tracker that errs may do, and name steps beside it."""

import numpy as np
import pytest

from estimating import estimate_one, judge_map
from following import follow, follow_lines
from recorded import choose_program, load_erring, record_run, with_samples
from truepath.alignment.align import align_all
from truepath.estimation.checks.change_detection import KNOCK, RANGE
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.results.analysis import analyse
from truepath.results.result_assessment import assess
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.worlds.synthetic import BEAM_BROKEN, Defects, Setting

LOST_S = 0.4
PLACE_MM = np.array([0.03, -0.02, 0.025])
TILT_RAD = np.array([3e-5, -4e-5, 1e-5])
RANGE_MM = -0.06
LONGER = np.array([RANGE_MM, 0.0, 0.0])


def measure(seed, mode="otf", specification=None, rows=24, **setting):
    content = load_erring(specification)
    program = choose_program(content, seed, mode, rows=rows)
    setting = Setting(**(setting or {"machine_seed": seed}))
    run, made = record_run(content, program, seed, mode, setting)
    return run, made.truth


def lose_beam(run, off_mm, share=0.6):
    tracker = run.tracker
    time_s = tracker.device_time_s
    lost_s = time_s[0] + share * (time_s[-1] - time_s[0])
    late = time_s >= lost_s
    status = np.where(late & (time_s < lost_s + LOST_S), 1, tracker.status)
    moved = tracker.position_mm + late[:, None] * off_mm(tracker.position_mm)
    return with_samples(run, position_mm=moved, status=status)


def lengthen(by_mm):
    return lambda place: by_mm * place / np.linalg.norm(place, axis=1)[:, None]


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_live_uncertainty_ends_as_that_of_the_analysis_and_both_hold_the_truth(mode):
    inside = []  # of the live estimate and of the analysis
    for seed in (11, 12, 13):
        run, truth = measure(seed, mode)
        followed, batch = follow_lines(run), analyse(run).estimate
        gram = compute_volumetric_gram(batch.model)
        stated_mm = float(np.sqrt(np.sum(gram * batch.covariance)))
        last = followed.last
        assert last.volumetric_sigma_mm == pytest.approx(stated_mm, rel=0.1)
        inside.append([judge_map(x, truth.deviation_mm).inside for x in (last, batch)])
        assert not any(notices for _, notices in followed.noticed)
        assert not last.check.knocks
    assert (np.mean(inside, axis=0) > 0.86).all()
    assert min(of_batch for _, of_batch in inside) > 0.6


def test_a_perfect_tracker_has_no_errors_in_the_live_estimate():
    run, _ = measure(11, specification={})
    typical, _ = measure(11)
    one, other = (follow(each).last for each in (run, typical))
    assert not any(is_tracker_error(effect) for effect in one.model.effects)
    assert one.volumetric_sigma_mm < 0.8 * other.volumetric_sigma_mm


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_a_range_offset_after_a_new_lock_is_told_as_such(mode):
    run, truth = measure(12, mode)
    followed = follow_lines(lose_beam(run, lengthen(0.08)))
    (knock,) = followed.last.check.knocks
    assert knock.kind == "range"
    assert knock.moved_mm == pytest.approx(0.08, abs=0.004)
    (notice,) = followed.noticed[-1][1]
    assert (notice.kind, notice.is_over) == (RANGE, False)
    assert notice.size_mm == pytest.approx(0.08, abs=4.0 * notice.sigma_mm)
    told = {n.kind for _, notices in followed.noticed for n in notices}
    assert KNOCK not in told
    assert judge_map(followed.last, truth.deviation_mm).inside > 0.86


def test_after_a_new_lock_a_knock_is_a_knock_and_an_offset_as_specified_not_told():
    run, _ = measure(12)
    followed = follow_lines(lose_beam(run, lambda _: np.array([0.03, -0.03, 0.03])))
    (notice,) = followed.noticed[-1][1]
    assert notice.kind == KNOCK
    (knock,) = followed.last.check.knocks
    assert knock.kind == "place"
    followed = follow_lines(lose_beam(run, lengthen(0.004)))
    assert not any(notices for _, notices in followed.noticed)
    assert not followed.last.check.knocks
    assert not followed.last.check.held


def test_more_new_locks_than_were_foreseen_leave_the_estimate_as_it_is():
    run, truth = measure(13, "standstill")
    for share in np.linspace(0.3, 0.9, 9):
        run = lose_beam(run, lengthen(0.003), share)
    last = follow_lines(run).last
    assert not last.check.held
    assert judge_map(last, truth.deviation_mm).inside > 0.8


# What is done, how large it is, and which reason of the verdict says it.
KINDS = {
    "place": (
        lambda position_mm: position_mm + PLACE_MM,
        1e3 * np.linalg.norm(PLACE_MM),
        "set-up-moved",
    ),
    "tilt": (
        lambda position_mm: position_mm + np.cross(TILT_RAD, position_mm),
        1e6 * np.linalg.norm(TILT_RAD),
        "tracker-tilted",
    ),
    "range": (
        lambda position_mm: to_cartesian(to_spherical(position_mm) + LONGER),
        1e3 * RANGE_MM,
        "range-offset-changed",
    ),
}
SAID = {said for _, _, said in KINDS.values()}


def disturb(run, kind, share, broken_s=0.0):
    first = int(share * len(run.tracker))
    at_s = run.tracker.device_time_s[first]
    late = run.tracker.device_time_s >= at_s + broken_s
    moved, status = run.tracker.position_mm.copy(), run.tracker.status.copy()
    moved[late] = KINDS[kind][0](moved[late])
    status[first:][~late[first:]] = BEAM_BROKEN
    return with_samples(run, position_mm=moved, status=status), at_s


@pytest.mark.parametrize(
    ("kind", "mode", "broken_s"),
    [
        ("place", "standstill", 0.0),
        ("tilt", "standstill", 0.0),
        ("range", "standstill", 0.0),
        ("range", "otf", 0.4),
        pytest.param("place", "otf", 0.0, marks=pytest.mark.long),
        pytest.param("tilt", "otf", 0.4, marks=pytest.mark.long),
        pytest.param("range", "otf", 0.0, marks=pytest.mark.long),
    ],
)
def test_a_step_has_the_name_of_what_happened(kind, mode, broken_s):
    run, truth = measure(51, mode, rows=20, defects=Defects())
    moved, at_s = disturb(run, kind, 0.57, broken_s)
    found = estimate_one(*align_all([moved], ["run"]))
    (knock,) = found.knocks
    assert knock.kind == kind
    assert knock.time_s == pytest.approx(at_s, abs=2.5)
    _, size, said = KINDS[kind]
    (reason,) = (one for one in assess(found, ["run"]).reasons if one.kind in SAID)
    assert reason.kind == said
    told = reason.values["angle_urad" if kind == "tilt" else "distance_um"]
    assert told == pytest.approx(size, abs=5.0)
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75


def test_a_new_lock_within_the_specification_is_no_step():
    lost = Defects(beam_breaks=((30.0, 0.4),))
    run, truth = measure(53, rows=20, defects=lost)
    found = estimate_one(*align_all([run], ["run"]))
    assert found.knocks == ()
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75
