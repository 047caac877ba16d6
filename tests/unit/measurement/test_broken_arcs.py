"""Circles that were held or not seen whole are driven again by themselves."""

from dataclasses import asdict

import numpy as np
import pytest

from measurement_fixtures import FakeMotion, Running, along
from truepath.files.bundle.run import Run, summarize_run
from truepath.measurement.messages import (
    LinesDamaged,
    MeasurementOrder,
    MeasurementProgress,
)
from truepath.motion.configurations import append_part
from truepath.service.api.models.results.result_run import InterruptionsOut
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Arc, Path

HALF = Arc("XY", (210.0, 110.0), 180.0)
ARC_ROW = 2


class SlowMotion(FakeMotion):
    """A controller that begins each part slowly, so that a test is in time for it."""

    begins_slowly = True

    def start(self) -> None:
        self.speed = 3.0 if self.begins_slowly else self.speed
        super().start()


@pytest.fixture
def motion() -> SlowMotion:
    return SlowMotion()


@pytest.fixture
def arc_order(order) -> MeasurementOrder:
    """A straight line, half a turn, and straight lines; the last row has no arc."""
    corners = [[10, 110, -10], [110, 110, -10], [310, 110, -10], [310, 10, -10]]
    return along(order, corners, 3000.0, arc=(None, None, HALF, None))


def reach_line(running: Running, line: int) -> None:
    """Wait for the motion along a line, counted from 1."""
    told = running.journal.of
    running.until(
        lambda: any(p.done == line - 1 for p in told(MeasurementProgress)[-1:])
    )


def finish(running: Running, motion: SlowMotion) -> Run:
    """Let the rest be driven fast; return the Run."""
    motion.begins_slowly, motion.speed = False, 2000.0
    assert running.ended() == "finished"
    return running.run


def list_again(path: Path, rows: int) -> list[Arc]:
    """Return the arcs that were driven after so many rows."""
    return [arc for arc in path.arc[rows:] if arc]


@pytest.mark.usefixtures("clock")
def test_a_circle_that_was_held_is_driven_again_whole_at_the_end(
    begin, arc_order, motion
):
    running = begin(arc_order)
    reach_line(running, ARC_ROW)
    running.pause_and_resume()
    run = finish(running, motion)
    rows = len(arc_order.commanded)
    (damaged,) = running.journal.of(LinesDamaged)
    assert damaged.row == ARC_ROW
    assert isinstance(run.commanded, Path)
    assert list_again(run.commanded, rows)[-1] == HALF
    assert np.array_equal(
        run.commanded.position[-2:], arc_order.commanded.position[ARC_ROW - 1 :][:2]
    )
    summary = summarize_run(run)
    assert summary.driven_again == (f"circles to rows {ARC_ROW + 1}",)
    stated = {
        **asdict(summary.interruptions),
        "driven_again": list(summary.driven_again),
    }
    InterruptionsOut.model_validate(stated)
    assert running.journal.faults == []
    assert motion.calls.count("start") == 2


@pytest.mark.usefixtures("clock")
def test_a_circle_with_a_short_loss_of_the_beam_is_driven_again(
    begin, arc_order, motion, tracker, journal
):
    running = begin(arc_order)
    reach_line(running, ARC_ROW)
    tracker.beam = False
    blocks, deadline_s = {tracker.health.frames}, host_clock.now_s() + 25.0
    while len(blocks) < 3:  # of some 0.4 s of its clock each; one at least is without
        assert host_clock.now_s() < deadline_s
        blocks.add(tracker.health.frames)
        host_clock.sleep_s(0.001)
    tracker.beam = True
    looks = len(running.told(MeasurementProgress))
    journal.wait(lambda: len(running.told(MeasurementProgress)) > looks + 8)
    run = finish(running, motion)
    assert "paused" not in running.states
    assert list_again(run.commanded, len(arc_order.commanded))[-1] == HALF


@pytest.mark.usefixtures("clock")
def test_a_hold_on_a_straight_line_costs_no_circle(begin, arc_order, motion):
    running = begin(arc_order)
    reach_line(running, 1)
    running.pause_and_resume()
    run = finish(running, motion)
    assert running.journal.of(LinesDamaged) == []
    assert len(run.commanded) == len(arc_order.commanded)


def read_driven(journal, order: MeasurementOrder) -> Path:
    """Return all rows that are driven so far."""
    driven = order.commanded
    for each in journal.of(LinesDamaged):
        driven = append_part(driven, each.again)
    assert isinstance(driven, Path)
    return driven


@pytest.mark.usefixtures("clock")
def test_a_circle_that_is_broken_again_and_again_is_given_up_without_a_fault(
    begin, arc_order, motion, journal
):
    running = begin(arc_order)
    reach_line(running, ARC_ROW)
    for times in range(1, 4):
        running.pause_and_resume()
        motion.speed = 2000.0
        journal.wait(lambda n=times: len(running.told(LinesDamaged)) == n)
        reach_line(running, len(read_driven(journal, arc_order)) - 1)
    running.pause_and_resume()
    finish(running, motion)
    assert len(running.journal.of(LinesDamaged)) == 3
    assert running.journal.faults == []
