"""Circles that were held or not seen whole are driven again by themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path as FilePath

import numpy as np
import pytest
from tests.measurement.conftest import FakeMotion
from tests.measurement.running_measurement import RunningMeasurement, run_measurements

from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run, summarize_run
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    LinesDamaged,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.motion.configurations import append_part
from truepath.service.api.models.results.result_run import InterruptionsOut
from truepath_drivers import host_clock
from truepath_drivers.interfaces.arcs import turn_about
from truepath_drivers.interfaces.records import Arc, Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.scenario import load_machine

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
def arc_order(mill, tmp_path) -> MeasurementOrder:
    """A straight line, half a turn, and straight lines; the last row has no arc."""
    corners = [[10, 110, -10], [110, 110, -10], [310, 110, -10], [310, 10, -10]]
    path = Path(
        ("X", "Y", "Z"),
        np.array(corners, float),
        np.full(4, 3000.0),
        np.zeros(4),
        arc=(None, None, HALF, None),
    )
    return MeasurementOrder(
        "arcs", str(tmp_path / "arcs.sqlite"), mill, path, reserve_bytes=0
    )


@pytest.fixture
def begin(
    tracker, motion, journal, calm
) -> Iterator[Callable[[MeasurementOrder], RunningMeasurement]]:
    with run_measurements(motion, journal) as begin:
        yield lambda order: begin(tracker, order, calm)


def reach_line(running: RunningMeasurement, line: int) -> None:
    """Wait for the motion along a line, counted from 1."""
    running.wait_for_progress(lambda done: done == line - 1)


def finish(running: RunningMeasurement, motion: SlowMotion) -> Run:
    """Let the rest be driven fast; return the Run."""
    motion.begins_slowly, motion.speed = False, 2000.0
    run = running.wait_for_run()
    assert running.journal.states[-1] == "finished"
    return run


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
    looks = len(journal.of(MeasurementProgress))
    journal.wait(lambda: len(journal.of(MeasurementProgress)) > looks + 8)
    run = finish(running, motion)
    assert "paused" not in journal.states
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
        journal.wait(lambda n=times: len(journal.of(LinesDamaged)) == n)
        reach_line(running, len(read_driven(journal, arc_order)) - 1)
    running.pause_and_resume()
    finish(running, motion)
    assert len(running.journal.of(LinesDamaged)) == 3
    assert running.journal.faults == []


def make_small_circles() -> Path:
    """Return two circles of 60 mm radius, six seconds each, between straight lines."""
    centre, turn_deg = (250.0, 200.0), 732.0
    begin = np.array([310.0, 200.0, 150.0])
    arcs = [Arc("XY", centre, turn_deg), Arc("XY", centre, -turn_deg)]
    axes = ("X", "Y", "Z")
    (end,) = turn_about(axes, begin, arcs[0], np.array([turn_deg]))
    corners = np.array([[100.0, 100.0, 50.0], [400.0, 320.0, 250.0]])
    more = np.array([[100.0, 320.0, 250.0], [400.0, 100.0, 50.0]])
    rows = np.vstack([corners, begin, end, begin, more, corners])
    count = len(rows)
    arc = (None, None, None, *arcs, *(None,) * (count - 5))
    return Path(axes, rows, np.full(count, 7500.0), np.full(count, 1.0), arc=arc)


def drive(cell: Cell, order: MeasurementOrder) -> list[LinesDamaged]:
    """Return what was driven again."""
    damaged: list[LinesDamaged] = []
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        deadline_s = time.monotonic() + 120.0
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.1):
                assert not isinstance(event, FaultReported), event
                if isinstance(event, LinesDamaged):
                    damaged.append(event)
                if isinstance(event, RunClosed):
                    return damaged
        raise AssertionError("the run was not closed")
    finally:
        cell.close()


@pytest.mark.long
def test_a_beam_break_in_a_circle_of_simulated_devices_costs_nothing(
    tmp_path: FilePath,
) -> None:
    content = load_machine("demo")
    machine = machine_from_json(content)
    path = make_small_circles()
    order = MeasurementOrder(
        "circles", str(tmp_path / "run.sqlite"), machine, path, feed_mm_min=20_000.0
    )
    faults = ["tracker:beam-break@14s+0.2s"]
    with Bench(
        content, seed=3, speed=4.0, workdir=tmp_path / "b", rtu=False, faults=faults
    ) as bench:
        config = CellConfig(
            "streaming", bench.tracker_options, "modbus", bench.motion_options
        )
        damaged = drive(Cell(config), order)
    run = open_run(order.run_file)
    seen = align(run)
    (first,) = damaged
    assert isinstance(run.commanded, Path)
    assert path.arc[first.row]
    again = [
        row for row in range(len(path), len(run.commanded)) if run.commanded.arc[row]
    ]
    whole = {run.commanded.arc[arc.row] for arc in seen.arcs if arc.row in again}
    assert path.arc[first.row] in whole
