"""Samples on ramps tell what is across the line, whatever acceleration does."""

import numpy as np
import pytest

from estimating import estimate_one, judge_map
from truepath.alignment.align import align
from truepath.estimation.checks.lack_of_fit import assess_lack_of_fit
from truepath_simulators.hidden.drives import InertialBend
from truepath_simulators.motion.profile import Limits
from truepath_simulators.worlds.synthetic import Setting

FAST = {"rows": 45, "feed": 40_000.0}  # most of a line of half a metre is ramp
LIMITS = Limits(3000.0, 1e5)


def bends(amount_um, frequency_hz=0.0):
    """Every carriage leans in all directions by so much at the tool, at its peak."""
    sizes = np.random.default_rng(4).uniform(-1.0, 1.0, 18) * amount_um / 3.0
    sizes /= np.tile(np.repeat([1.0, 0.3], 3), 3)
    names = [f"E{kind}{axis}" for axis in "XYZ" for kind in "XYZABC"]
    pairs = zip(names, sizes.tolist(), strict=True)
    return tuple(InertialBend(*pair, frequency_hz, 0.2) for pair in pairs)


@pytest.fixture(scope="module")
def judge(record):
    def judged(seed, hidden=(), *, ramps=True):
        run, truth = record(seed, **FAST, setting=Setting(limits=LIMITS, hidden=hidden))
        seen = align(run)
        if not ramps:
            seen = seen.exclude_ramps()
        checked = estimate_one(seen)
        left = judge_map(checked.estimate, truth.deviation_mm)
        return left.left_mm.mean(), left.inside, checked

    return judged


@pytest.fixture(scope="module")
def clean(judge):
    return judge(31)


@pytest.fixture(scope="module")
def without(judge):
    return judge(31, ramps=False)


def test_the_acceleration_of_the_axes_is_measured_on_ramps(record):
    run, truth = record(31, **FAST, setting=Setting(limits=LIMITS))
    seen, timeline = align(run), truth.recording.timeline
    known_s = truth.recording.clock.true_s(seen.at.time_s)
    told = seen.at.acceleration[seen.is_ramp]
    piece = np.searchsorted(timeline.start_s, known_s, side="right") - 1
    true = timeline.accelerations(known_s)[:, None] * timeline.direction[piece]
    off = np.linalg.norm(told - true[seen.is_ramp], axis=1)
    assert np.median(off) < 0.05 * LIMITS.acceleration_mm_s2
    assert not seen.at.acceleration[~seen.is_ramp].any()


def test_ramps_of_a_sound_machine_are_used_as_other_cells_are(clean, without):
    left_mm, inside, checked = clean
    assert inside > 0.88
    assert not checked.left_out[0]
    assert left_mm < 0.9 * without[0]
    fit = checked.estimate.fit
    misfit, ramp = assess_lack_of_fit(fit, 0), fit.runs[0].observations.is_ramp
    assert np.median(misfit.cell[ramp]) < 1.3 * np.median(misfit.cell[~ramp])


def test_bending_carriages_cost_little_and_swinging_counts_less(clean, judge, without):
    left_mm, inside, _ = judge(31, bends(8.0))
    assert inside > 0.88
    assert left_mm < 1.2 * clean[0]
    left_mm, inside, checked = judge(31, bends(20.0, frequency_hz=15.0))
    noise, usual = checked.estimate.runs[0].noise, clean[2].estimate.runs[0].noise
    assert noise.ramp_sigma_mm > 0.001 > usual.ramp_sigma_mm
    assert inside > 0.88
    assert left_mm < 1.1 * without[0]
