"""Circles driven on the fly, on simulated machines whose effects are known."""

from dataclasses import replace

import numpy as np
import pytest

from recorded import record_path
from results_fixtures import load_small
from truepath.alignment.align import align
from truepath.alignment.observations.observations import ArcDrive
from truepath.answers.verification import circle_figures as figures
from truepath.answers.verification.circular_test import read_commanded
from truepath.answers.verification.reduced_points import correlate_means
from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_report import write_verification
from truepath.estimation.problem.noise import NoiseModel
from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.configurations import append_part
from truepath.motion.paths.plan_segments import drive_arcs_again
from truepath.motion.paths.verification_points import make_circle_path
from truepath.numerics.rigid import RigidTransform
from truepath.service.api.models.results.verification import VerificationOut
from truepath_simulators.hidden import drives, structure
from truepath_simulators.worlds.synthetic import Defects, Setting

BACKLASH_UM, LAG_MS, LEAN_URAD = 8.0, 0.2, 60.0
PLAY, LAG = drives.Backlash("X", BACKLASH_UM), drives.ServoMismatch("Z", LAG_MS)
HIDDEN = (PLAY, LAG, structure.Squareness("A0Z", LEAN_URAD))
ANGLE = np.radians(figures.list_sector_angles())


def drive(machine, *, seed=7, again=(), **setting):
    """Return the Run of the circle path; rows of `again` come once more at its end."""
    path = make_circle_path(machine)
    if again:
        path = append_part(path, drive_arcs_again(path, again))
    run, _ = record_path(load_small(), path, seed, setting=Setting(**setting))
    return replace(run, machine=machine)


def evaluate(run):
    seen = align(run)
    noise = NoiseModel((1.0, 1.0), (0.2, 0.2, 0.2), 1.0, 0.0)  # of the simulated air
    planes, whole = {}, set()
    for arc in seen.arcs:
        commanded = read_commanded(run, run.commanded, arc.row)
        inside = slice(arc.first, arc.last)
        stream = run.tracker.device_time_s[inside], run.tracker.position_mm[inside]
        seen_from = seen.pose, noise, run.machine.tracker
        driven = figures.average_over_sectors(commanded, arc, *stream, *seen_from)
        if driven is not None:
            whole.add(arc.row)
            planes.setdefault(commanded.plane, {})[commanded.sense] = driven
    stated = {}
    for plane, senses in planes.items():
        radial = {sense: one.radial_mm for sense, one in senses.items()}
        covariance = {sense: one.covariance_mm2 for sense, one in senses.items()}
        stated[plane] = figures.estimate_figures(radial, covariance)
    arcs = {row for row, arc in enumerate(run.commanded.arc) if arc}
    return planes, stated, arcs - whole


@pytest.fixture(scope="module")
def demo():
    content = {**load_small(), "kinematic_chain": "w-b-X-Y-Z-t"}
    return machine_from_json(content, file="machine.json")


@pytest.fixture
def measured_again(calibrated):
    def measure(holds=(), again=()):
        how = {"machine_seed": 1, "defects": Defects(holds=holds)}
        return drive(calibrated.machine, seed=12, again=again, **how)

    return measure


def test_play_lag_and_lean_are_in_the_figures_of_the_planes_they_belong_to(demo):
    planes, stated, broken = evaluate(drive(demo, error_scale=0.0, hidden=HIDDEN))
    assert not broken
    assert set(planes) == {"XY", "YZ", "ZX"}

    def check(plane, name, expected_um):
        error_um = abs(stated[plane].value_um[name] - expected_um)
        assert error_um <= 2.0 * stated[plane].uncertainty_um[name], (plane, name)

    one = planes["YZ"]["counterclockwise"]
    assert one.feed_mm_min == pytest.approx(one.commanded.feed_mm_min, rel=1e-3)
    lag_um = LAG_MS * one.commanded.feed_mm_min / 60.0
    lean_um = 1e-3 * LEAN_URAD * one.commanded.radius_mm
    # Radii by the angle t: lean r sin t cos t, and lag v sin t cos t by the sense.
    check("XY", "H", BACKLASH_UM)
    check("YZ", "H", lag_um)
    in_yz = stated["YZ"].value_um
    senses = sorted([in_yz["G_clockwise"], in_yz["G_counterclockwise"]])
    assert senses[0] == pytest.approx(abs(lean_um - lag_um), abs=2.0)
    assert senses[1] == pytest.approx(lean_um + lag_um, abs=2.0)


def test_a_result_predicts_circles_in_motion(calibrated, measured_again, tmp_path):
    found = verify(calibrated, measured_again())
    assert found.consistency.is_consistent
    document = VerificationOut.model_validate(write_verification(found, tmp_path))
    assert [one.plane for one in document.circles_in_motion] == ["XY", "YZ", "ZX"]
    assert document.circles_missing == []
    for one in document.circles_in_motion:
        mean = np.mean(list(one.radial_um.values()), axis=0)
        columns = [np.cos(ANGLE), np.sin(ANGLE), np.ones(figures.SECTORS)]
        fitted = np.linalg.lstsq(np.column_stack(columns), mean)[0]
        assert one.centre_um is not None
        assert one.centre_um["measured"] == pytest.approx(fitted[:2])
    within = []
    for one in document.circles_in_motion:
        within += [difference.within for difference in one.difference_um.values()]
    assert sum(within) >= len(within) - 1
    sizes = [one.figures_um["G"] for one in document.circles_in_motion]
    assert max(sizes) > 10.0
    assert "Circles in motion" in (tmp_path / "report.html").read_text()


def test_an_exact_machine_has_no_hysteresis_beyond_its_uncertainty(demo):
    _, stated, _ = evaluate(drive(demo, error_scale=0.0))
    for one in stated.values():
        assert one.own_um["H"] > 1.0
        assert one.value_um["H"] <= 2.0 * one.uncertainty_um["H"]
        assert one.value_um["G"] <= 2.0 * one.uncertainty_um["G"]


def test_a_circle_that_was_driven_again_is_not_missing(calibrated, measured_again):
    holds = ((30.0, 2.0),)
    run = measured_again(holds)
    lost = verify(calibrated, run).circles
    (row,) = lost.broken  # with a stop in it; the others stand
    driven = {one.commanded.plane: len(one.driven) for one in lost.circles}
    assert driven["".join(run.commanded.arc[row].axes)] == 1
    assert sum(driven.values()) == 5
    found = verify(calibrated, measured_again(holds, {row})).circles
    assert found.broken == ()
    assert [one.commanded.plane for one in found.circles] == ["XY", "YZ", "ZX"]
    first = found.circles[0]
    assert set(first.driven) == {"counterclockwise", "clockwise"}
    assert max(first.row.values()) >= len(make_circle_path(calibrated.machine))
    assert "H" in first.measured.value_um


ELLIPSE, SENSE = np.cos(2 * ANGLE), np.sign(np.sin(ANGLE))
SHAPES_UM = {  # there and back
    "exact": (0.0 * ANGLE, 0.0 * ANGLE),
    "ellipse": (2.0 * ELLIPSE, 2.0 * ELLIPSE),
    "lost-motion": (5.0 * ELLIPSE + SENSE, 5.0 * ELLIPSE - SENSE),
    "spikes-at-reversals": [
        sign * 6.0 * np.exp(-(sign * ANGLE % np.pi) / 0.2) for sign in (1, -1)
    ],
}


@pytest.mark.parametrize("shape", SHAPES_UM)
def test_the_stated_uncertainty_covers_the_true_figures(shape, rng):
    there_um, back_um = SHAPES_UM[shape]
    true = {"counterclockwise": 1e-3 * there_um, "clockwise": 1e-3 * back_um}
    exact = figures.compute_figures({name: one[:, None] for name, one in true.items()})
    time_s = 0.16 * np.arange(figures.SECTORS)
    shared = correlate_means(time_s, np.full(figures.SECTORS, 0.16), 0.6)
    covariance = 1e-6 * (0.25 * np.eye(figures.SECTORS) + 0.36 * shared)
    factor = np.linalg.cholesky(covariance)
    inside, trials = 0, 12
    for _ in range(trials):
        noise = (factor @ rng.standard_normal(figures.SECTORS) for _ in true)
        seen = {name: true[name] + one for name, one in zip(true, noise, strict=True)}
        found = figures.estimate_figures(seen, dict.fromkeys(true, covariance))
        for name in figures.FIGURES:
            off_um = abs(found.value_um[name] - 1e3 * exact[name][0])
            inside += off_um <= 2.0 * found.uncertainty_um[name]
    assert inside >= 0.92 * trials * len(figures.FIGURES)


def turn(demo, radial_mm, *, turn_deg=732.0, centre_mm=(0.0, 0.0), commanded_deg=None):
    """Return the sectors of a circle driven without noise, or None if none are told.

    radial_mm : radius less the commanded one by the angle, rad; it grows by 50 µm over
        run-in and run-out, so that these would be seen
    commanded_deg : turn_deg if it is not given
    """
    time_s = np.arange(0.0, 24.0, 2e-3)
    turned = np.radians(turn_deg) * time_s / time_s[-1]
    radius = 100.0 + radial_mm(turned)
    out = np.abs(np.degrees(turned - 0.5 * np.radians(turn_deg))) > 180.5
    radius[out] += 0.05
    points = radius * [np.cos(turned), np.sin(turned), 0.0 * turned]
    points += np.array([[*centre_mm, 0.0]]).T
    about = "XY", np.zeros(3), np.eye(2, 3), 100.0, 0.0, commanded_deg or turn_deg
    pose = RigidTransform(np.eye(3), np.array([1000.0, 0.0, 0.0]))
    noise = NoiseModel((1.0, 1.0), (0.1, 0.1, 0.1), 1.0, 0.0)
    stream = ArcDrive(2, 0, len(time_s)), time_s, pose.apply(points.T)
    commanded = figures.CommandedCircle(*about, 3000.0)
    seen = *stream, pose, noise, demo.tracker
    driven = figures.average_over_sectors(commanded, *seen)
    return driven and driven.radial_mm


@pytest.mark.parametrize("turn_deg", [732.0, -732.0])
def test_an_ellipse_is_in_its_sectors_and_run_in_is_in_none(demo, turn_deg):
    how = {"radial_mm": lambda t: 0.005 * np.cos(2 * t), "turn_deg": turn_deg}
    assert turn(demo, **how, commanded_deg=-turn_deg) is None  # in the other sense
    radial = turn(demo, **how)
    # The first sector and the last one meet: a little of what is driven past is there.
    assert np.allclose(radial, 0.005 * np.cos(2 * ANGLE), atol=1e-4)


def test_a_spike_at_a_reversal_is_in_the_sectors_after_the_quadrant(demo):
    def spike(t):
        return 0.006 * np.exp(-(np.degrees(t) % 180.0) / 5.0)  # X turns back at 0, 180

    for sign, first in ((1.0, 0), (-1.0, figures.SECTORS - 1)):
        radial = turn(demo, lambda t, s=sign: spike(s * t), turn_deg=sign * 732.0)
        step = int(sign)
        for quadrant in (first, (first + figures.SECTORS // 2) % figures.SECTORS):
            seen = radial[quadrant + step * np.arange(3)]
            assert seen == pytest.approx([4.51e-3, 2.48e-3, 1.36e-3], rel=0.03)
            assert abs(radial[(quadrant - step) % figures.SECTORS]) < 1e-4


def test_a_circle_off_its_centre_is_as_round_about_its_own(demo):
    at = (0.012, -0.02)
    off = {"radial_mm": lambda t: 0.0 * t, "centre_mm": at}
    both = [turn(demo, **off, turn_deg=turn_deg) for turn_deg in (732.0, -732.0)]
    centre = figures.fit_centre(np.mean(both, axis=0)[:, None])
    assert centre[:, 0] == pytest.approx(at, abs=1e-4)
    for one in both:
        assert np.abs(figures.subtract_centre(one[:, None], centre)).max() < 2e-4
