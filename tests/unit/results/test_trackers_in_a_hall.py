"""What real trackers do, each kind by itself: where a result is usable, U holds it.

Sizes are sampled, from half to twice those seen on real trackers. The machine file says
nothing of the tracker's errors.
"""

from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

from estimating import judge_map
from following import shift
from recorded import choose_program, load_small, record_run
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.results.analysis import analyse
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.paths import chord_path, turning_points
from truepath_simulators.worlds.synthetic import Setting

WORLDS = 3
TYPICAL = asdict(TrackerSpecification())


def sample_size(rng):
    return 2.0 ** rng.uniform(-1.0, 1.0)


def load_gantry():
    content = load_small("demo")
    for axis, length_mm in {"X": 6000.0, "Y": 2500.0, "Z": 1200.0}.items():
        content["axes"][axis] |= {"min_mm": 0.0, "max_mm": length_mm}
    return content


def record(kind, seed, errors=None, error_scale=1.0):
    """Record a program of a kind with a tracker that errs and does not say so."""
    names = {"turning": "trunnion"}
    content = load_gantry() if kind == "gantry" else load_small(names.get(kind, "demo"))
    content["tracker"]["specification"] = errors or {}
    machine = parse_machine(content)
    if kind == "gantry":
        program = chord_path(machine, seed, 60, 24_000.0)
    elif kind == "turning":
        program = turning_points(machine, seed, 120, dwell_s=0.4)
    else:
        program = choose_program(content, seed, "otf" if kind == "lines" else kind)
    mode = "otf" if kind in ("lines", "gantry") else "standstill"
    setting = Setting(machine_seed=seed % 100, error_scale=error_scale)
    run, made = record_run(content, program, seed, mode, setting)
    silent = replace(run.machine.tracker, specification=TrackerSpecification())
    return replace(run, machine=replace(run.machine, tracker=silent)), made.truth


def judge(runs, truth):
    target = "T1" if runs[0].machine.rotary_axes else ""
    found = analyse(*runs)
    deviation_mm = partial(truth.deviation_mm, target=target)
    inside = judge_map(found.estimate, deviation_mm, target).inside
    return found.verdict.state, inside


def judge_specified(kind, places, typical, rng, seed):
    errors = {key: size * sample_size(rng) for key, size in typical.items()}
    made = [record(kind, seed + 100 * place, errors) for place in range(places)]
    return judge([run for run, _ in made], made[0][1])


def judge_misread(misread, rng, seed, **how):
    run, truth = record("lines", seed, **how)
    seen_mm, time_s = run.tracker.position_mm, run.tracker.device_time_s
    polar = to_spherical(seen_mm)
    wrong_mm = to_cartesian(polar + misread(rng, polar, time_s - time_s[0])) - seen_mm
    return judge([shift(run, wrong_mm)], truth)


def misread_fine_cycles(rng, polar, time_s):
    """Four, eight and sixteen cycles a turn, 1.5 µrad each."""
    wrong = np.zeros_like(polar)
    for column in (1, 2):
        for cycles in (4, 8, 16):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            swing = np.sin(cycles * polar[:, column] + phase)
            wrong[:, column] += 1.5e-6 * sample_size(rng) * swing
    return wrong


def misread_as_it_warms(rng, polar, time_s):
    """Range, azimuth and elevation go to another value within minutes."""
    share = 1.0 - np.exp(-time_s / (120.0 * sample_size(rng)))
    ends = np.array([0.010, 10e-6, 10e-6]) * rng.choice([-1.0, 1.0], 3)
    return share[:, None] * ends * sample_size(rng)


def misread_like_a_real_stream(rng, polar, time_s):
    """Correlated over some tenths of a second, by far more than samples scatter."""
    step_s = np.median(np.diff(time_s))
    wrong = np.zeros_like(polar)
    across = 1.0 / polar[:, 0]
    for column, size in enumerate((0.0003, 0.0025 * across, 0.0025 * across)):
        keep = np.exp(-step_s / rng.uniform(0.3, 1.0))
        drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(len(polar))
        swing = lfilter([1.0], [1.0, -keep], drive)
        wrong[:, column] = size * rng.uniform(1.0, 2.4) * swing
    return wrong


def misread_all_lengths(rng, polar, time_s):
    """Pressure, wavelength or another instrument's constant."""
    ppm = rng.choice([-1.0, 1.0]) * rng.uniform(68.0, 136.0)
    return 1e-6 * ppm * polar * [1.0, 0.0, 0.0]


ROWS = {
    "specified, one place": partial(judge_specified, "lines", 1, TYPICAL),
    "specified, two places": partial(judge_specified, "lines", 2, TYPICAL),
    "specified, at points": partial(judge_specified, "standstill", 1, TYPICAL),
    "specified, five axes": partial(judge_specified, "turning", 1, TYPICAL),
    "specified, gantry": partial(judge_specified, "gantry", 1, TYPICAL),
    "fine cycles": partial(judge_misread, misread_fine_cycles),
    "warm-up": partial(judge_misread, misread_as_it_warms),
    "a real stream": partial(judge_misread, misread_like_a_real_stream),
} | {
    f"{key} of {size}": partial(judge_specified, kind, 1, {key: size})
    for kind, key, size in (
        ("lines", "reflector_um", 4.0),
        ("lines", "beam_offset_um", 10.0),
        ("lines", "index_urad", 20.0),
        ("lines", "tilt_urad", 7.0),
        ("lines", "scale_drift_ppm", 4.0),
        ("lines", "delay_us", 30.0),
        ("gantry", "bending_urad_per_m", 0.5),
    )
}


@pytest.mark.long
def test_lengths_that_are_all_wrong_are_never_usable_without_a_known_length():
    rng = np.random.default_rng(68)
    for seed in range(1, 9):
        state, _ = judge_misread(misread_all_lengths, rng, seed, error_scale=0.3)
        assert state != "usable"


@pytest.mark.long
@pytest.mark.parametrize("row", ROWS)
def test_a_usable_result_holds_the_truth_whatever_the_tracker_does(row):
    rng = np.random.default_rng(list(row.encode()))
    judged = [ROWS[row](rng, seed) for seed in range(1, WORLDS + 1)]
    inside = [share for state, share in judged if state != "not-usable"]
    assert not inside or np.mean(inside) > 0.85
    assert all(share > 0.6 for state, share in judged if state == "usable")
