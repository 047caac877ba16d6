"""A step of the set-up has the name of what happened, with a tracker that errs."""

import numpy as np
import pytest

from estimating import judge_map
from recorded import choose_program, load_erring, record_run, with_samples
from truepath.alignment.align import align_all
from truepath.estimation.checks.disturbances import estimate_checked
from truepath.kinematics.coarse_model import build_run_models
from truepath.results.verdict import judge
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.worlds.synthetic import BEAM_BROKEN, Defects, Setting

PLACE_MM = np.array([0.03, -0.02, 0.025])
TILT_RAD = np.array([3e-5, -4e-5, 1e-5])
RANGE_MM = -0.06
LONGER = np.array([RANGE_MM, 0.0, 0.0])


def measure(seed, mode, **setting):
    """Return a Run of a small machine whose tracker errs as is typical; its truth."""
    content = load_erring()
    program = choose_program(content, seed, mode, rows=20)
    run, made = record_run(content, program, seed, mode, Setting(**setting))
    return run, made.truth


def check(run):
    """Return the checked estimate of a Run."""
    (seen,) = align_all([run], ["run"])
    return estimate_checked(build_run_models(run.machine, [seen.at]), [seen])


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
    """Return a Run to which something happens, and when; the beam is lost before."""
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
    run, truth = measure(51, mode)
    moved, at_s = disturb(run, kind, 0.57, broken_s)
    found = check(moved)
    (knock,) = found.knocks
    assert knock.kind == kind
    assert knock.time_s == pytest.approx(at_s, abs=2.5)
    _, size, said = KINDS[kind]
    (reason,) = (one for one in judge(found, ["run"]).reasons if one.kind in SAID)
    assert reason.kind == said
    told = reason.values["angle_urad" if kind == "tilt" else "distance_um"]
    assert told == pytest.approx(size, abs=5.0)
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75


def test_a_new_lock_within_the_specification_is_no_step():
    lost = Defects(beam_breaks=((30.0, 0.4),))
    run, truth = measure(53, "otf", defects=lost)
    found = check(run)
    assert found.knocks == ()
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75
