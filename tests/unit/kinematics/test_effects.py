"""What effects do to the measured point."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects import conformance, free_form
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.effects.family import list_families
from truepath.kinematics.effects.pose_timing_seats import TimingLaw, TrackerPose
from truepath.kinematics.effects.position_wave import ScrewCyclic, ScrewCyclicFamily
from truepath.kinematics.effects.speed_error import ServoMismatchFamily
from truepath.kinematics.effects.tracker_air import ScaleDriftFamily
from truepath.kinematics.effects.tracker_error import LookErrorFamily
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.model import MachineModel

MACHINE = build_mill((20.0, -30.0, -150.0))
X = LinearAxis("X", 0.0, 500.0)


@pytest.mark.parametrize(
    ("low", "high", "zero"), [(0, 500, 0), (-200, 300, 0), (50, 550, 50)]
)
def test_tables_keep_the_gauge(low, high, zero, rng):
    axis = LinearAxis("X", float(low), float(high))
    for symbol in ("EXX", "EAX", "EBX", "ECX", "EYX", "EZX"):
        effect = make_error_motion(symbol, axis, 8)
        theta = rng.normal(size=len(effect.parameters))
        is_straightness = symbol in ("EYX", "EZX")
        fixed = [axis.low, axis.high] if is_straightness else [float(zero)]
        assert effect.rows(np.array(fixed)) @ theta == pytest.approx(0.0, abs=1e-9)


def test_phase_and_speed_move_along_their_own_line_only_and_not_at_a_standstill(rng):
    law = TimingLaw((0, 1))
    position = rng.uniform(0, 500, (3, 3))
    velocity = [[100.0, 0, 0], [100.0, 0, 0], [0, 0, -50.0]]
    still, line_time_s = make_standstill(MACHINE, position), np.array([-1.0, 1.0, 0.5])
    lines = {"line": np.array([0, 0, 1]), "line_time_s": line_time_s}
    at = replace(still, **lines, velocity_mm_s=np.array(velocity))
    moved = law.displacement_mm(at, np.array([0.1, 0.01, 0.0, 0.2]))
    assert np.allclose(moved, [[0.09, 0, 0], [0.11, 0, 0], [0, 0, -0.1]])
    assert not law.jacobian(make_standstill(MACHINE, position)).any()


def test_pose_is_a_shift_and_a_turn_about_its_centre(rng):
    at = make_standstill(MACHINE, rng.uniform(0, 500, (4, 3)))
    turn, shift = np.array([1e-5, 2e-5, -1e-5]), np.array([0.1, 0.0, -0.2])
    effect = TrackerPose((100.0, 50.0, 0.0))
    moved = effect.displacement_mm(at, np.concatenate([shift, turn]))
    assert np.allclose(moved, shift + np.cross(turn, at.point_mm - [100.0, 50.0, 0.0]))


def test_effects_alike_to_the_ninth_digit_are_two_and_two_of_one_name_are_refused():
    axis = MACHINE.linear_axes[0]
    effects = ScrewCyclic(axis, 10.0), ScrewCyclic(axis, 10.00000001)
    model = MachineModel(MACHINE, effects)
    assert (model.size, [s.start for s in model.slices.values()]) == (8, [0, 4])
    assert effects[0] == ScrewCyclic(axis, 10.0) != effects[1]
    assert hash(effects[0]) == hash(ScrewCyclic(axis, 10.0))
    pose = TrackerPose((0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="tracker-pose"):
        MachineModel(MACHINE, (pose, pose))


@pytest.fixture(scope="module")
def seen():
    return conformance.example_conditions()


def propose(family, at, **keys):
    return next(c.effect for c in family.propose(at) if keys.items() <= c.keys.items())


def test_a_tilt_moves_points_across_its_axis_and_by_their_distance(seen):
    tilt = propose(free_form.TiltWanderFamily(), seen, direction="Z")
    moved = tilt.jacobian(seen)[:, :, 0]
    arm = seen.point_mm - seen.point_mm.mean(axis=0)
    assert np.abs(moved[:, 2]).max() == 0.0
    assert np.abs(np.sum(moved * arm, axis=1)).max() < 1e-9
    size = np.linalg.norm(moved, axis=1) / np.linalg.norm(arm[:, :2], axis=1)
    assert size.max() == pytest.approx(size[0], rel=1e-6)


def test_a_turn_by_another_axis_needs_it_and_varying_play_has_two_sides(seen):
    turn = propose(free_form.PlaneTurnFamily(), seen, motion="ECX", by="Y")
    products = turn.shapes(seen)
    share = seen.axis_mm("Y") / 500.0
    np.testing.assert_allclose(products[:, 0], 2.0 * share - 1.0)
    shape = propose(free_form.SideShapeFamily(), seen, axis="X", direction="Y")
    ahead = seen.approach[:, 0] * shape.jacobian(seen)[:, 1, 0]
    np.testing.assert_allclose(ahead, 2.0 * seen.axis_mm("X") / 500.0 - 1.0)


def test_errors_of_the_range_are_along_the_beam_and_a_drift_moves_far_points_more(seen):
    moved = propose(LookErrorFamily(), seen, quantity="range").jacobian(seen)
    beam = seen.recorded.tracker_mm
    across = np.cross(moved[:, :, 0], beam)
    assert np.abs(across).max() < 1e-9 * np.linalg.norm(beam, axis=1).max()

    assert seen.sensor_degc("air") is None
    drift = propose(ScaleDriftFamily(), seen).jacobian(seen)[:, :, 0]
    late = seen.time_s - 0.5 * (seen.time_s.min() + seen.time_s.max())
    np.testing.assert_allclose(drift, seen.recorded.tracker_mm * late[:, None])


@pytest.mark.parametrize("check", conformance.CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("family", list_families(), ids=lambda family: family.name)
def test_an_installed_effect_conforms(family, check):
    check(family, conformance.example_conditions())


@dataclass(frozen=True)
class Crooked(Effect):
    """Its displacement is not what its Jacobian says."""

    kind = "crooked"
    units = {"": "mm"}  # noqa: RUF012 (declared as ClassVar in Effect)

    def jacobian(self, at):
        return columns_along("X", np.ones((len(at), 1)))

    def displacement_mm(self, at, theta):
        return 2.0 * super().displacement_mm(at, theta)


class CrookedFamily(ServoMismatchFamily):
    keys = {}  # noqa: RUF012 (declared as ClassVar in Family)
    words = {"en": ServoMismatchFamily.words["en"]}  # noqa: RUF012

    def propose(self, at):
        return [self.make_candidate(Crooked(), [1.0]) for _ in range(2)]


class EarlierFamily(ServoMismatchFamily):
    """Says its role itself, and names by `makes` alone what restores its effect."""

    effect = None
    makes = ServoMismatchFamily.effect
    role = Role.STRUCTURE


@pytest.mark.parametrize("check", conformance.CHECKS)
def test_a_family_of_earlier_versions_conforms_and_is_kept(check, seen):
    check(EarlierFamily(), seen)
    assert EarlierFamily().is_kept
    assert not EarlierFamily().names_cause


def test_an_effect_that_breaks_the_contract_or_proposes_nothing_is_told_so(seen):
    slope = conformance.jacobian_is_the_slope_of_the_displacement
    values, words = conformance.effects_are_values, conformance.words_are_there
    unrecorded = replace(seen, recorded=None)
    for check, family, at, complaint in (
        (slope, CrookedFamily(), seen, "is not the slope"),
        (values, CrookedFamily(), seen, "share names"),
        (words, CrookedFamily(), seen, "no words in de"),
        (words, ServoMismatchFamily(), unrecorded, "proposes nothing"),
    ):
        with pytest.raises(conformance.NotConforming, match=complaint):
            check(family, at)


class Pointwise(ScrewCyclic):
    """A wave as it is at the middle of a cell."""

    @property
    def harmonics(self):
        return (1,)

    units = dict.fromkeys(("sin", "cos"), "mm")

    def jacobian(self, at):
        return super().jacobian(replace(at, recorded=None))


class PointwiseFamily(ScrewCyclicFamily):
    effect = Pointwise

    def propose(self, at):
        return [self.make_candidate(Pointwise(X, 31.0), [0.005] * 2)]


class AveragedFamily(PointwiseFamily):
    def propose(self, at):
        return [self.make_candidate(ScrewCyclic(X, 31.0), [0.005] * 4)]


def test_a_wave_has_to_be_averaged_over_its_cells(seen):
    check = conformance.a_cell_is_the_mean_over_its_span
    number = r"\((-?[0-9.e-]+)\)"
    said = (
        rf"expected the mean over the cell {number}, found the value at its middle "
        rf"{number}: multiply sine and cosine of a wave by attenuate_wave"
    )
    with pytest.raises(conformance.NotConforming, match=said) as told:
        check(PointwiseFamily(), seen)
    mean, middle = (float(n) for n in re.search(said, str(told.value)).groups())
    assert mean / middle == pytest.approx(np.sinc(8.0 / 31.0), rel=5e-3)
    check(AveragedFamily(), seen)
    check(PointwiseFamily(), replace(seen, recorded=None))


@dataclass(frozen=True)
class Misshapen(Effect):
    kind = "misshapen"
    units = {"": "mm"}  # noqa: RUF012 (declared as ClassVar in Effect)

    def jacobian(self, at):
        return self.turn(columns_along("X", np.ones((len(at), 1))))

    def displacement_mm(self, at, theta):
        return self.displace(super().displacement_mm(at, theta))

    @staticmethod
    def turn(columns):
        return columns

    displace = turn


class MisshapenFamily(ServoMismatchFamily):
    effect = Misshapen
    keys = {}  # noqa: RUF012 (declared as ClassVar in Family)
    sigma = (1.0,)

    def propose(self, at):
        return [self.make_candidate(Misshapen(), self.sigma)]


EXPECTED = r"expected the shape \(400, 3, 1\): conditions, X Y Z, entries of units"
MISSHAPEN = {
    "flat": ("turn", lambda J: J[:, :, 0], rf"shape \(400, 3\), {EXPECTED}"),
    "turned": ("turn", lambda J: J.swapaxes(1, 2), rf"\(400, 1, 3\), {EXPECTED}"),
    "wide": ("turn", lambda J: np.tile(J, 2), rf"\(400, 3, 2\), {EXPECTED}"),
    "short": ("turn", lambda J: J[1:], rf"\(399, 3, 1\), {EXPECTED}"),
    "nothing": ("turn", lambda J: None, rf"shape \(\), {EXPECTED}"),
    "failing": (
        "turn",
        lambda J: J + np.ones((7, 1, 1)),
        rf"jacobian fails .*{EXPECTED}",
    ),
    "displaced": (
        "displace",
        lambda moved: moved.T,
        r"displacement_mm returns the shape \(3, 400\), expected \(400, 3\)",
    ),
    "sizes": (
        "sigma",
        (1.0, 2.0),
        r"prior_sigma has the shape \(2,\), expected \(1,\)",
    ),
    "stated": (
        "stated",
        {"a_um": 1e3, "b_um": 1e3},
        "stated has 2 entries, expected 1: one for each of units",
    ),
}


@pytest.mark.parametrize("case", MISSHAPEN)
def test_an_effect_of_a_wrong_shape_is_told_which_is_expected_and_no_more(
    case, monkeypatch
):
    name, value, said = MISSHAPEN[case]
    of = Misshapen if callable(value) else MisshapenFamily
    monkeypatch.setattr(of, name, staticmethod(value) if callable(value) else value)
    at, told = conformance.example_conditions(), set()
    for check in conformance.CHECKS:
        try:
            check(MisshapenFamily(), at)
        except conformance.NotConforming as error:
            told.add(str(error))
    (only,) = told
    assert re.search(said, only)
