"""Circles that were held or not seen whole are driven again by themselves."""

from dataclasses import asdict

import numpy as np
import pytest

from measurement_fixtures import FakeMotion, along
from truepath.files.bundle.run import summarize_run
from truepath.measurement import messages
from truepath.motion.configurations import append_part
from truepath.service.api.models.results.result import InterruptionsOut
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Arc

pytestmark = pytest.mark.usefixtures("clock")

HALF = Arc("XY", (210.0, 110.0), 180.0)
ARC_ROW = 2


class SlowMotion(FakeMotion):
    """A controller that begins each part slowly, so that a test is in time for it."""

    begins_slowly = True

    def start(self):
        self.speed = 3.0 if self.begins_slowly else self.speed
        super().start()


@pytest.fixture
def motion():
    return SlowMotion()


@pytest.fixture
def arc_order(order):
    """A straight line, half a turn, and straight lines; the last row has no arc."""
    corners = [[10, 110, -10], [110, 110, -10], [310, 110, -10], [310, 10, -10]]
    return along(order, corners, 3000.0, arc=(None, None, HALF, None))


def reach_line(running, line):
    running.until(lambda: [p.done for p in running.progress[-1:]] == [line - 1])


def finish(running, motion):
    motion.begins_slowly, motion.speed = False, 2000.0
    assert running.ended() == "finished"
    return running.run


def test_a_circle_that_was_held_is_driven_whole_at_the_end(begin, arc_order, motion):
    running = begin(arc_order)
    reach_line(running, ARC_ROW)
    running.pause_and_resume()
    run = finish(running, motion)
    rows = len(arc_order.commanded)
    (damaged,) = running.told(messages.LinesDamaged)
    assert damaged.row == ARC_ROW
    assert [arc for arc in run.commanded.arc[rows:] if arc][-1] == HALF
    ends = arc_order.commanded.position[ARC_ROW - 1 : ARC_ROW + 1]
    assert np.array_equal(run.commanded.position[-2:], ends)
    summary = summarize_run(run)
    assert summary.driven_again == (f"circles to rows {ARC_ROW + 1}",)
    stated = {**asdict(summary.interruptions), "driven_again": [*summary.driven_again]}
    InterruptionsOut.model_validate(stated)
    assert (running.faults, motion.calls.count("start")) == ([], 2)


def test_a_circle_with_a_short_loss_is_driven_again(begin, arc_order, motion, tracker):
    running = begin(arc_order)
    reach_line(running, ARC_ROW)
    tracker.beam = False
    blocks, deadline_s = {tracker.health.frames}, host_clock.now_s() + 25.0
    while len(blocks) < 3:  # of some 0.4 s of its clock each; one at least is without
        assert host_clock.now_s() < deadline_s
        blocks.add(tracker.health.frames)
        host_clock.sleep_s(0.001)
    tracker.beam = True
    running.look(8)
    run = finish(running, motion)
    assert "paused" not in running.states
    again = run.commanded.arc[len(arc_order.commanded) :]
    assert [arc for arc in again if arc][-1] == HALF


def test_a_hold_on_a_straight_line_costs_no_circle(begin, arc_order, motion):
    running = begin(arc_order)
    reach_line(running, 1)
    running.pause_and_resume()
    run = finish(running, motion)
    assert running.told(messages.LinesDamaged) == []
    assert len(run.commanded) == len(arc_order.commanded)


def test_a_circle_ever_broken_is_given_up_without_a_fault(begin, arc_order, motion):
    running, driven = begin(arc_order), arc_order.commanded
    reach_line(running, ARC_ROW)
    for times in range(1, 4):
        running.pause_and_resume()
        motion.speed = 2000.0
        running.until(lambda n=times: len(running.told(messages.LinesDamaged)) == n)
        driven = append_part(driven, running.told(messages.LinesDamaged)[-1].again)
        reach_line(running, len(driven) - 1)
    running.pause_and_resume()
    finish(running, motion)
    assert (len(running.told(messages.LinesDamaged)), running.faults) == (3, [])
