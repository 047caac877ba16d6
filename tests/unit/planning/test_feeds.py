"""The feeds of a plan: what the machine can, and what tells most a second."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.plan.plan_document import plan_document
from truepath.errors import BundleError, PlanningError
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.kinematics.machine.machine import MotionLimits
from truepath.motion.motion_times import Drive, Legs
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath_simulators.motion.profile import Limits, rest_to_rest


def moving_at(machine, **stated):
    return machine_from_json({**machine_to_json(machine), "motion": stated})


def test_a_file_keeps_what_the_machine_can_and_sluggish_ones_get_lower_feeds(mill):
    stated = {"max_feed_mm_min": 16_000.0, "jerk_mm_s3": 3e4}
    machine = moving_at(mill, **stated)
    assert machine_to_json(machine)["motion"] == stated
    assert machine.motion.assumed == ("acceleration_mm_s2",)
    assert "motion" not in machine_to_json(mill)
    sluggish = moving_at(mill, max_feed_mm_min=40_000, acceleration_mm_s2=200)
    feeds = PlanRequirements().feeds(sluggish)
    assert max(feeds) < 15_000.0
    longest_mm = np.linalg.norm([500.0, 400.0, 300.0])
    assert Drive.of_machine(sluggish, 0.4).shortest_mm(max(feeds))[0] <= longest_mm


@pytest.mark.parametrize("jerk_mm_s3", [np.inf, 3e4, 3e3])
@pytest.mark.parametrize("length_mm", [1.0, 40.0, 700.0])
def test_a_line_takes_as_long_as_a_jerk_limited_machine_does(length_mm, jerk_mm_s3):
    limits = MotionLimits(1.2e4, 1500.0, jerk_mm_s3)
    leg = Legs(np.zeros((1, 3)), np.array([[length_mm, 0, 0]]), np.array([1.2e4]))
    known = Limits(1500.0, jerk_mm_s3)
    expected = rest_to_rest(np.array([length_mm]), np.array([200.0]), known)
    drive = Drive.of("XYZ", 0.0, limits)
    assert drive.times_s(leg)[0] == pytest.approx(expected[0, :, 0].sum(), rel=1e-9)


def test_a_plan_keeps_to_the_highest_feed_and_says_why_it_has_its_feeds(small_mill):
    machine = moving_at(small_mill, max_feed_mm_min=16_000, acceleration_mm_s2=3000)
    planned = make_plan(machine, PlanRequirements(minutes=1.0))
    feeds = planned.commanded.feed_mm_min[1:]
    document = plan_document(planned)
    assert feeds.max() <= 16_000.0
    assert document["feeds_mm_min"] == sorted(set(feeds), reverse=True)
    assert "16000" in document["feed_choice"]["reason"]
    lines = {f["feed_mm_min"]: f["lines"] for f in document["feed_choice"]["feeds"]}
    assert sum(lines.values()) == len(feeds)
    assert max(planned.feeds_worth.values()) < 1.08


def test_no_plan_is_faster_than_the_machine_can_or_than_is_asked_for(small_mill, mill):
    slow = replace(small_mill, motion=MotionLimits(2400.0, assumed=()))
    plan = make_plan(slow, PlanRequirements(minutes=0.6))
    assert plan.commanded.feed_mm_min.max() <= 2400.0
    with pytest.raises(PlanningError, match="give 1 to 2400 mm"):
        make_plan(slow, PlanRequirements(minutes=1.0, feeds_mm_min=(6000.0,)))
    document = plan_document(make_plan(small_mill, PlanRequirements(minutes=0.4)))
    assert document["motion"]["max_feed_mm_min"] == 10_000.0
    assert any("10000" in text for text in document["motion"]["assumed"])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("max_feed_mm_min", value) for value in (0.0, -6000.0, 1e12)),
        ("acceleration_mm_s2", 1e-9),
        *(("jerk_mm_s3", value) for value in (0.0, float("nan"))),
    ],
)
def test_motion_that_no_machine_has_is_refused_by_its_name(mill, name, value):
    with pytest.raises(BundleError, match=rf"motion\.{name} is .*; "):
        moving_at(mill, **{name: value})


def test_no_feed_is_chosen_above_the_one_asked_for_or_that_controls_do_not_read(mill):
    assert max(PlanRequirements(max_feed_mm_min=3_000.0).feeds(mill)) == 3_000.0
    both = PlanRequirements(feeds_mm_min=(900.0,), max_feed_mm_min=3e3)
    with pytest.raises(PlanningError, match="leave it out where feeds are given"):
        both.reject_nonsense(mill)
    machine = moving_at(mill, max_feed_mm_min=200_000, acceleration_mm_s2=1e5)
    assert max(PlanRequirements().feeds(machine)) <= 99_999.0
