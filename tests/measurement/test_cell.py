"""Cell processes on simulated devices, over a pseudo-terminal and Modbus."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path as FilePath
from typing import TypeVar

import numpy as np
import psutil
import pytest

from truepath.alignment.align import align
from truepath.errors import MeasurementFailed, OutOfTravel, TruepathError
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    BlockRecorded,
    CellConfig,
    CellEvent,
    CellState,
    CellVerb,
    Connected,
    ControllerRead,
    FaultReported,
    LivePoints,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
    TemperaturesRead,
    TrackerTrial,
)
from truepath.measurement.process import cell as cell_module
from truepath.measurement.process.cell import Cell
from truepath.measurement.process.cell_process import MAX_BLOCKS, Outbox, serve
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.run_file.run_repair import repair_run
from truepath.measurement.time_limits import StreamTimeouts
from truepath.motion.configurations import Configurations
from truepath.planning.lines.default_path import default_path
from truepath.plugins import load
from truepath_drivers.interfaces.errors import ConnectionLost, WrongDevice
from truepath_drivers.interfaces.records import MotionStatus, TrackerSamples
from truepath_simulators.bench.bench import Bench

E = TypeVar("E")
SPEED = 10.0
HELD_S = 3.0  # by then a watchdog of one second holds, on a busy computer too
# A computer that is busy with other things is no silent tracker.
CALM = StreamTimeouts(silent_s=10.0, dead_s=30.0, beam_s=10.0)


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Iterator[Bench]:
    """One bench for all: every fault that is injected ends by itself."""
    folder = tmp_path_factory.mktemp("bench")
    with Bench(seed=3, speed=SPEED, workdir=folder) as started:
        yield started


def config_of(bench: Bench, timeouts: StreamTimeouts = CALM) -> CellConfig:
    return CellConfig(
        "streaming", bench.tracker_options, "modbus", bench.motion_options, timeouts
    )


class Driven:
    """A cell and all it has said."""

    def __init__(self, config: CellConfig) -> None:
        self.cell = Cell(config)
        self.events: list[CellEvent] = []

    def until(
        self, condition: Callable[[], bool], timeout_s: float = 30.0
    ) -> list[CellEvent]:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline_s, self.events[-5:]
            self.events += self.cell.poll(0.1)
        return self.events

    def of(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def states(self) -> list[str]:
        return [event.state for event in self.of(StateChanged)]

    @property
    def faults(self) -> list[str]:
        return [event.code for event in self.of(FaultReported)]

    def until_state(self, state: str) -> None:
        self.until(lambda: self.states[-1:] == [state])

    def until_line(self, line: int) -> None:
        self.until(lambda: any(p.done >= line for p in self.of(MeasurementProgress)))

    def until_closed(self) -> RunClosed:
        self.until(lambda: bool(self.of(RunClosed)), 45.0)
        return self.of(RunClosed)[-1]


@pytest.fixture
def driven(bench) -> Iterator[Driven]:
    made = Driven(config_of(bench))
    made.cell.start()
    yield made
    made.cell.close()


@pytest.fixture
def connected(driven) -> Driven:
    driven.cell.connect()
    return driven


@pytest.fixture
def watchful(bench) -> Iterator[Driven]:
    """A connected cell with the patience of the service, which asks for no search."""
    made = Driven(config_of(bench, StreamTimeouts(search_s=0.0)))
    made.cell.start()
    made.cell.connect()
    yield made
    made.cell.close()


@pytest.fixture
def searching(bench) -> Iterator[Driven]:
    """A connected cell with the patience of the service."""
    made = Driven(config_of(bench, StreamTimeouts()))
    made.cell.start()
    made.cell.connect()
    yield made
    made.cell.close()


@pytest.fixture
def order(bench, tmp_path) -> MeasurementOrder:
    machine = machine_from_json(bench.machine)
    path = default_path(machine, lines=4)
    return MeasurementOrder("bench", str(tmp_path / "bench.sqlite"), machine, path)


@pytest.fixture
def long_order(order) -> MeasurementOrder:
    """Some five seconds of motion: time to do something to it."""
    return replace(order, commanded=default_path(order.machine, lines=10))


@pytest.fixture
def machine_state(bench) -> Iterator[Callable[[], MotionStatus]]:
    """Looks at the CNC as somebody else would."""
    factory = load("truepath.motion_controllers", "modbus")
    with factory(**bench.motion_options) as controller:
        yield controller.status


def moves(run) -> int:
    """Count the motions in a stream by speed."""
    position = run.tracker.position_mm
    speed = np.linalg.norm(position[25:] - position[:-25], axis=1) / 0.05
    return int((np.diff((speed > 2.0).astype(int)) == 1).sum())


def test_at_rest_thermometers_are_read_and_the_tracker_can_be_heard(bench):
    config = replace(
        config_of(bench),
        thermometer_driver="modbus-registers",
        thermometer_options=bench.thermometer_options,
    )
    driven = Driven(config)
    driven.cell.start()
    try:
        driven.cell.connect()
        driven.until(lambda: bool(driven.of(TemperaturesRead)))
        readings = driven.of(TemperaturesRead)[0].readings
        assert readings
        assert all(10.0 < value < 40.0 for value in readings.values()), readings
        driven.until(lambda: bool(driven.of(ControllerRead)))
        read = driven.of(ControllerRead)[0]
        assert len(read.status.position) == len(read.axes)
        assert read.axes == ("X", "Y", "Z")
        tried = driven.cell.try_tracker(TrackerTrial(500.0, 0.2, streams_only=True))
        assert tried.rate_hz == pytest.approx(500.0, rel=0.01)
        assert tried.usable == tried.samples
    finally:
        driven.cell.close()


def test_a_whole_run_over_serial_and_modbus_loses_no_sample(
    connected, order, tmp_path, read_link_bytes
):
    connected.cell.begin(order)
    closed = connected.until_closed()
    assert closed.outcome == "finished"
    assert closed.lost_samples == 0
    assert connected.states == ["connecting", "ready", "running", "finished"]
    run = open_run(order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (run.tracker.status == 0).all()
    assert moves(run) == 4
    assert len(read_link_bytes(order.run_file)) > 44 * len(run.tracker)
    write_bundle(run, tmp_path / "bundle")
    copy = read_bundle(tmp_path / "bundle")
    np.testing.assert_array_equal(copy.tracker.position_mm, run.tracker.position_mm)
    np.testing.assert_array_equal(copy.tracker.device_time_s, run.tracker.device_time_s)
    np.testing.assert_array_equal(copy.tracker.status, run.tracker.status)
    np.testing.assert_array_equal(copy.commanded.position, order.commanded.position)
    np.testing.assert_array_equal(
        copy.tracker.sequence, run.tracker.sequence - run.tracker.sequence[0]
    )


def test_the_bytes_of_a_run_decode_to_its_samples_again(
    connected, order, read_link_bytes
):
    from truepath_drivers.tracker.streaming.codec import SampleDecoder
    from truepath_drivers.tracker.streaming.framing import FrameReader

    connected.cell.begin(order)
    connected.until_closed()
    bodies = FrameReader().feed(read_link_bytes(order.run_file))
    again = SampleDecoder().decode(bodies).samples
    run = open_run(order.run_file)
    at = np.searchsorted(again.device_time_s, run.tracker.device_time_s[0] - 1e-4)
    np.testing.assert_array_equal(
        again.position_mm[at : at + len(run.tracker)], run.tracker.position_mm
    )


def test_points_are_stepped_through_on_the_bench(connected, order):
    corners = order.commanded.position[:3]
    points = Configurations(order.commanded.axes, corners, np.full(3, 2.0))
    connected.cell.begin(replace(order, commanded=points, feed_mm_min=9000.0))
    assert connected.until_closed().outcome == "finished"
    run = open_run(order.run_file)
    assert run.mode == "standstill"
    assert moves(run) == 2
    assert connected.of(MeasurementProgress)[-1].done == 3


def test_enough_after_some_points_ends_the_standstill_run_in_order(connected, order):
    corners = order.commanded.position[:4]
    points = Configurations(order.commanded.axes, corners, np.full(4, 8.0))
    connected.cell.begin(replace(order, commanded=points, feed_mm_min=9000.0))
    connected.until_line(1)
    connected.cell.send(CellVerb.CONCLUDE)
    assert connected.until_closed().outcome == "finished"
    run = open_run(order.run_file)
    done = sum(event.kind == "point" for event in run.events)
    assert 1 <= done < 4
    assert [e.kind for e in run.events].count("concluded") == 1
    assert moves(run) == done - 1


def test_one_cell_measures_again_and_again(connected, order, tmp_path):
    for number in range(2):
        file = str(tmp_path / f"run{number}.sqlite")
        connected.cell.begin(replace(order, run_file=file))
        connected.until(lambda n=number: len(connected.of(RunClosed)) > n, 30.0)
    assert [c.outcome for c in connected.of(RunClosed)] == ["finished", "finished"]
    assert [c.lost_samples for c in connected.of(RunClosed)] == [0, 0]


def test_a_run_over_modbus_rtu(bench, order):
    config = replace(config_of(bench), motion_options=bench.motion_options_rtu)
    driven = Driven(config)
    driven.cell.start()
    try:
        driven.cell.connect()
        driven.cell.begin(order)
        assert driven.until_closed().outcome == "finished"
    finally:
        driven.cell.close()


def test_connect_tells_who_answers(driven):
    devices = driven.cell.connect()
    assert devices["tracker"].model == "Simulated tracker"
    assert devices["motion"].model == "Simulated CNC"
    assert driven.cell.connect() == devices


def test_pause_resume_and_abort_reach_the_machine(connected, long_order, machine_state):
    connected.cell.begin(long_order)
    connected.until_line(1)
    connected.cell.send(CellVerb.PAUSE)
    connected.until_state("paused")
    held = machine_state()
    assert (held.state, held.hold_reason) == ("held", "command")
    assert machine_state().position == held.position
    connected.cell.send(CellVerb.RESUME)
    connected.until_state("running")
    connected.cell.send(CellVerb.ABORT)
    assert connected.until_closed().outcome == "aborted"
    assert machine_state().state == "aborted"
    run = open_run(long_order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert run.provenance["outcome"] == "aborted"


def test_a_second_order_is_refused_while_one_runs(connected, long_order, tmp_path):
    connected.cell.begin(long_order)
    connected.until_line(1)
    connected.cell.begin(replace(long_order, run_file=str(tmp_path / "other.sqlite")))
    connected.until(lambda: connected.faults == ["busy"])
    assert connected.states[-1] == "running"
    assert connected.cell.connect()["motion"].model == "Simulated CNC"
    connected.cell.send(CellVerb.ABORT)
    connected.until_closed()
    assert not (tmp_path / "other.sqlite").exists()


@pytest.mark.fault_row(23)
def test_killing_the_cell_leaves_a_run_and_a_machine_that_holds(
    connected, long_order, machine_state
):
    order = long_order
    connected.cell.begin(order)
    connected.until_line(2)
    recorded = connected.of(MeasurementProgress)[-1].samples
    os.kill(connected.cell.process_id, signal.SIGKILL)
    killed_s = time.monotonic()
    while (status := machine_state()).state == "running":
        assert time.monotonic() < killed_s + HELD_S
        time.sleep(0.02)
    assert (status.state, status.hold_reason) == ("held", "watchdog")
    connected.until_state("faulted")
    assert connected.faults == ["cell-died"]
    assert not connected.cell.alive
    assert connected.cell.poll(0.0) == []
    with pytest.raises(MeasurementFailed, match="not alive"):
        connected.cell.send(CellVerb.PAUSE)
    run = open_run(order.run_file)
    # What was on its way to the disk, at ten times the usual rate, may be missing.
    assert len(run.tracker) > recorded - 0.5 * 500 * SPEED
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert run.provenance["outcome"] == "torn"
    assert moves(run) >= 2
    assert repair_run(order.run_file).samples == len(run.tracker)


def test_another_cell_takes_over_from_a_killed_one(
    bench, connected, order, long_order, tmp_path
):
    connected.cell.begin(long_order)
    connected.until_line(1)
    os.kill(connected.cell.process_id, signal.SIGKILL)
    connected.until_state("faulted")
    second = Driven(config_of(bench))
    second.cell.start()
    try:
        second.cell.connect()
        deadline_s = time.monotonic() + 30.0
        file = tmp_path / "second.sqlite"
        while not second.of(RunClosed) or second.of(RunClosed)[-1].outcome == "failed":
            # Until the watchdog has stopped it, the machine is still busy.
            assert time.monotonic() < deadline_s
            second.events.clear()
            second.cell.begin(replace(order, run_file=str(file)))
            second.until_closed()
        assert second.of(RunClosed)[-1].outcome == "finished"
    finally:
        second.cell.close()


def assert_held(status: MotionStatus) -> None:
    """By the cell on its way out; on a busy computer the watchdog may be faster."""
    assert status.state == "held"
    assert status.hold_reason in ("command", "watchdog")


PARENT = """
import sys, time
from truepath.measurement.process.cell import Cell
from truepath.measurement.messages import (
    CellConfig, MeasurementOrder, MeasurementProgress
)
from truepath.files.bundle.machine_file import machine_from_json
from truepath.planning.lines.default_path import default_path
def main():
    tracker, motion, machine, file = eval(sys.argv[1])
    machine = machine_from_json(machine)
    cell = Cell(CellConfig("streaming", tracker, "modbus", motion))
    cell.start()
    cell.connect()
    path = default_path(machine, lines=12)
    cell.begin(MeasurementOrder("orphan", file, machine, path))
    print(cell.process_id, flush=True)
    while True:
        for event in cell.poll(0.1):
            if isinstance(event, MeasurementProgress):
                print(event.done, flush=True)
if __name__ == "__main__":
    main()
"""


def test_a_cell_ends_with_its_parent_and_holds_the_feed(bench, tmp_path, machine_state):
    script, file = tmp_path / "parent.py", str(tmp_path / "orphan.sqlite")
    script.write_text(PARENT)
    arguments = (bench.tracker_options, bench.motion_options, bench.machine, file)
    parent = subprocess.Popen(
        [sys.executable, str(script), repr(arguments)],
        stdout=subprocess.PIPE,
        cwd=FilePath.cwd(),
        env=os.environ | {"PYTHONPATH": str(FilePath.cwd())},
    )
    with parent:
        assert parent.stdout is not None
        cell = psutil.Process(int(parent.stdout.readline()))
        while int(parent.stdout.readline()) < 1:
            pass
        parent.kill()
    cell.wait(25.0)
    assert_held(machine_state())
    run = open_run(file)
    assert run.provenance["outcome"] == "aborted"
    assert moves(run) >= 1


def test_a_cell_told_to_terminate_holds_the_feed_first(
    connected, long_order, machine_state
):
    connected.cell.begin(long_order)
    connected.until_line(1)
    os.kill(connected.cell.process_id, signal.SIGTERM)
    connected.until_closed()
    assert_held(machine_state())
    assert open_run(long_order.run_file).provenance["outcome"] == "aborted"


def test_closing_a_cell_that_measures_ends_the_run_properly(
    connected, long_order, machine_state
):
    connected.cell.begin(long_order)
    connected.until_line(1)
    connected.cell.close()
    connected.cell.close()
    assert not connected.cell.alive
    assert machine_state().state == "held"
    assert open_run(long_order.run_file).provenance["outcome"] == "aborted"


@pytest.mark.fault_row(5)
def test_a_silent_tracker_holds_the_machine_and_ends_the_run(
    bench, watchful, long_order, machine_state
):
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    bench.inject(f"tracker:silence+{5.6 * SPEED}s")
    watchful.until_state("paused")
    assert machine_state().hold_reason == "command"
    assert watchful.until_closed().outcome == "faulted"
    assert len(watchful.faults) >= 2
    assert set(watchful.faults) == {"tracker-silent"}
    assert machine_state().state == "held"


@pytest.mark.fault_row(5)
def test_a_short_silence_is_lived_through(bench, watchful, long_order, measured):
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    bench.inject(f"tracker:silence+{1.2 * SPEED}s")
    closed = watchful.until_closed()
    assert closed.outcome == "finished"
    assert set(watchful.faults) == {"tracker-silent"}
    assert closed.lost_samples > 0.5 * SPEED * 500
    measured(f"{closed.lost_samples} samples lost and counted, Run finished")


@pytest.mark.fault_row(16)
def test_a_closed_connection_of_the_controller_costs_nothing(bench, watchful, order):
    watchful.cell.begin(order)
    watchful.until_line(1)
    for _ in range(2):
        bench.inject("cnc:disconnect")
        time.sleep(0.3)
    closed = watchful.until_closed()
    assert closed.outcome == "finished"
    assert watchful.faults == []
    assert closed.lost_samples == 0


@pytest.mark.fault_row(1)
def test_a_stream_of_bad_frames_is_held_and_named(bench, watchful, order):
    watchful.cell.begin(order)
    watchful.until_line(1)
    bench.inject(f"tracker:bit-flip+{0.5 * SPEED}s*0.95")
    watchful.until_state("paused")
    closed = watchful.until_closed()
    assert closed.outcome == "finished"
    assert watchful.of(MeasurementProgress)[-1].crc_errors > 0
    assert set(watchful.faults) == {"stream-damaged"}
    run = open_run(closed.run_file)
    assert len(run.commanded) > len(order.commanded)
    assert "bad or lost" in run.provenance["stream"]


@pytest.mark.fault_row(30)
def test_a_service_that_falls_silent_is_a_hold_that_a_person_ends(connected, order):
    """Whoever has told the cell once that it can be reached has to go on."""
    connected.cell.send(CellVerb.BEAT)
    connected.cell.begin(order)
    connected.until_state("paused")
    assert set(connected.faults) == {"service-silent"}
    connected.cell.send(CellVerb.RESUME)
    connected.until(lambda: "resuming" in connected.states)

    def beat() -> bool:
        connected.cell.send(CellVerb.BEAT)
        return bool(connected.of(RunClosed))

    connected.until(beat, 45.0)
    assert connected.of(RunClosed)[-1].outcome == "finished"


@contextmanager
def suspended(*process_ids: int) -> Iterator[None]:
    """Let processes not run meanwhile."""
    for process_id in process_ids:
        os.kill(process_id, signal.SIGSTOP)
    try:
        yield
    finally:
        for process_id in process_ids:
            os.kill(process_id, signal.SIGCONT)


@pytest.mark.parametrize(
    ("who", "for_s"),
    [
        ("tracker", 0.6),
        ("cnc", 1.4),
        ("tracker cnc cell", 1.4),
        pytest.param("tracker", 2.0, marks=pytest.mark.long),
        pytest.param("cnc", 0.6, marks=pytest.mark.long),
        pytest.param("tracker cnc", 0.6, marks=pytest.mark.long),
        pytest.param("tracker cnc", 1.4, marks=pytest.mark.long),
        pytest.param("cell", 0.7, marks=pytest.mark.long),
    ],
)
@pytest.mark.fault_row(30)
def test_processes_that_stand_for_a_moment_cost_time_and_no_sample(
    bench, watchful, long_order, who, for_s, measured
):
    ids = bench.process_ids | {"cell": watchful.cell.process_id}
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    with suspended(*(ids[name] for name in who.split())):
        time.sleep(for_s)  # what is tested is that time passes
    closed = watchful.until_closed()
    assert closed.outcome == "finished"
    assert closed.lost_samples == 0
    assert set(watchful.faults) <= {"tracker-silent", "control-late"}
    run = open_run(long_order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert moves(run) >= len(long_order.commanded) - 1
    measured(f"{who} for {for_s} s: {closed.lost_samples} samples lost")


@pytest.mark.long
@pytest.mark.fault_row(30)
@pytest.mark.parametrize(
    ("who", "told"),
    [
        ("tracker", {"tracker-silent"}),
        ("cnc", {"no-answer", "link-lost"}),
        ("cell", {"held-at-machine"}),
    ],
)
def test_a_process_that_stands_for_ten_seconds_ends_in_a_machine_that_stands(
    bench, watchful, long_order, machine_state, who, told
):
    ids = bench.process_ids | {"cell": watchful.cell.process_id}
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    with suspended(ids[who]):
        time.sleep(10.0)  # what is tested is that time passes
    watchful.until(lambda: bool(told & set(watchful.faults)), 30.0)
    assert machine_state().state != "running"
    if who == "cell":
        watchful.cell.send(CellVerb.RESUME)
    closed = watchful.until_closed()
    assert closed.outcome in ("finished", "faulted")
    run = open_run(long_order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()


@pytest.mark.fault_row(23)
def test_a_cell_that_stands_is_held_by_the_watchdog_and_waits_for_somebody(
    bench, watchful, long_order, machine_state, measured
):
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    with suspended(watchful.cell.process_id):
        begun_s = time.monotonic()
        held_by_s = begun_s + HELD_S
        while (status := machine_state()).state != "held":
            assert time.monotonic() < held_by_s
            time.sleep(0.01)
        assert status.hold_reason == "watchdog"
        measured(f"held {time.monotonic() - begun_s:.2f} s after the cell stood")
    watchful.until_state("paused")
    watchful.until(lambda: watchful.faults[-1:] == ["held-at-machine"])
    assert "watchdog" in watchful.of(FaultReported)[-1].text
    assert machine_state().state == "held"
    watchful.cell.send(CellVerb.RESUME)
    closed = watchful.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)


@pytest.mark.fault_row(9)
def test_a_broken_beam_waits_for_somebody(bench, watchful, long_order):
    watchful.cell.begin(long_order)
    watchful.until_line(1)
    bench.inject(f"tracker:beam-break+{SPEED}s")
    watchful.until(lambda: "beam-lost" in watchful.faults)
    watchful.until_state("paused")
    assert watchful.faults[-1] == "beam-lost"
    seen = len(watchful.of(LivePoints))
    watchful.until(lambda: len(watchful.of(LivePoints)) > seen + 2)
    watchful.cell.send(CellVerb.RESUME)
    assert watchful.until_closed().outcome == "finished"
    assert (open_run(long_order.run_file).tracker.status != 0).any()


@pytest.mark.long
@pytest.mark.fault_row(9)
def test_a_target_that_only_a_search_finds_needs_nobody(bench, searching, order):
    searching.cell.begin(order)
    searching.until_line(2)
    bench.inject("tracker:beam-lost")
    assert searching.until_closed().outcome == "finished"
    assert searching.faults == ["beam-lost"]
    run = open_run(order.run_file)
    kinds = [event.kind for event in run.events]
    assert kinds.count("found") == 1
    assert "again" in kinds
    assert (run.tracker.status != 0).any()
    assert len(run.commanded) > len(order.commanded)
    seen = align(run)
    off = seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    assert np.abs(off).max() < 0.4
    missing = set(range(1, len(run.commanded))) - set(seen.row.tolist())
    assert len(missing) <= 1  # the line that the beam was lost on


@pytest.mark.fault_row(19)
def test_an_alarm_of_the_machine_ends_the_run(tmp_path, order, measured):
    faults = ["cnc:alarm@row2"]
    with Bench(speed=SPEED, faults=faults, workdir=tmp_path / "b", rtu=False) as bench:
        driven = Driven(config_of(bench))
        driven.cell.start()
        try:
            driven.cell.connect()
            driven.cell.begin(order)
            closed = driven.until_closed()
            assert (closed.outcome, closed.lost_samples) == ("faulted", 0)
            measured(f"{closed.samples} samples kept, none lost")
            assert driven.faults == ["motion-alarm"]
            (told,) = driven.of(FaultReported)
            assert "Servo alarm: following error of an axis" in told.text
            again = replace(order, run_file=str(tmp_path / "again.sqlite"))
            driven.cell.begin(again)
            driven.until(lambda: len(driven.of(RunClosed)) == 2)
            assert driven.of(RunClosed)[-1].outcome == "failed"
            assert driven.faults == ["motion-alarm"] * 2
        finally:
            driven.cell.close()
    run = open_run(order.run_file)
    assert run.provenance["outcome"] == "faulted"
    assert moves(run) >= 1


@pytest.mark.fault_row(20)
def test_a_hold_at_the_panel_is_a_pause_that_ends_there(
    bench, connected, long_order, measured
):
    connected.cell.begin(long_order)
    connected.until_line(1)
    bench.inject(f"cnc:feed-hold+{SPEED}s")
    closed = connected.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    measured(f"{closed.samples} samples, none lost")
    assert connected.states[2:] == ["running", "paused", "running", "finished"]
    assert connected.faults == ["held-at-machine"]
    assert "operator" in connected.of(FaultReported)[0].text


@pytest.mark.long
@pytest.mark.fault_row(20)
def test_an_override_of_nothing_is_named_and_ends_where_it_is_turned_up(
    bench, connected, long_order, machine_state
):
    connected.cell.begin(long_order)
    connected.until_line(1)
    bench.inject(f"cnc:override+{13 * SPEED}s*0")
    connected.until(lambda: bool(connected.faults))
    (told,) = connected.of(FaultReported)
    assert told.code == "feed-override"
    assert "the feed override is 0 %" in told.text
    standing = machine_state()
    assert (standing.state, standing.override) == ("running", 0.0)
    closed = connected.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert connected.faults == ["feed-override"]
    assert moves(open_run(closed.run_file)) >= len(long_order.commanded) - 1


@pytest.mark.fault_row(7)
def test_a_wrong_device_on_the_port_is_refused_by_name(tmp_path, measured):
    faults = ["tracker:wrong-identity"]
    with Bench(speed=SPEED, faults=faults, workdir=tmp_path / "b", rtu=False) as bench:
        driven = Driven(config_of(bench))
        driven.cell.start()
        try:
            begun_s = time.monotonic()
            with pytest.raises(WrongDevice):
                driven.cell.connect()
            measured(f"refused after {time.monotonic() - begun_s:.2f} s")
        finally:
            driven.cell.close()


def test_a_port_that_is_not_there_is_a_lost_connection(bench):
    options = {**bench.tracker_options, "port": "/dev/no-such-port"}
    driven = Driven(replace(config_of(bench), tracker_options=options))
    driven.cell.start()
    try:
        with pytest.raises(ConnectionLost, match="no-such-port"):
            driven.cell.connect()
    finally:
        driven.cell.close()


def test_a_cell_that_hangs_is_ended_by_force(driven, monkeypatch):
    monkeypatch.setattr(cell_module, "CLOSE_S", 0.2)
    monkeypatch.setattr(cell_module, "FORCE_S", 0.2)
    monkeypatch.setattr(cell_module, "CONNECT_S", 0.2)
    process = psutil.Process(driven.cell.process_id)
    process.suspend()
    with pytest.raises(MeasurementFailed, match=r"did not answer in 0\.2 s"):
        driven.cell.connect()
    driven.cell.close()
    assert not process.is_running()


def test_a_killed_cell_ends_at_once_and_its_death_is_reported(driven):
    driven.cell.kill()
    driven.until_state("faulted")
    assert driven.faults == ["cell-died"]


def test_a_cell_that_dies_while_it_connects_says_so(driven):
    process = psutil.Process(driven.cell.process_id)
    process.suspend()
    killer = threading.Timer(0.3, process.kill)
    killer.start()
    with pytest.raises(MeasurementFailed, match="died"):
        driven.cell.connect()
    killer.join()


def test_an_order_before_connecting_fails_and_opens_no_file(driven, order):
    driven.cell.begin(order)
    closed = driven.until_closed()
    assert (closed.outcome, closed.run_file) == ("failed", "")
    assert driven.faults == ["not-connected"]


def test_an_order_out_of_travel_never_leaves_the_parent(connected, order):
    far = replace(order.commanded, position=order.commanded.position + 9000.0)
    with pytest.raises(OutOfTravel, match="row 1: X"):
        connected.cell.begin(replace(order, commanded=far))


@pytest.mark.parametrize(
    ("tracker", "options", "said"),
    [
        ("no-such-tracker", {}, "no trackers called 'no-such-tracker'"),
        ("streaming", {"prot": "x"}, "prot"),
    ],
)
def test_an_unknown_driver_or_option_is_named(tracker, options, said):
    driven = Driven(CellConfig(tracker, options, "modbus", {}))
    driven.cell.start()
    try:
        with pytest.raises(TruepathError, match=said):
            driven.cell.connect()
    finally:
        driven.cell.close()


def test_a_cell_that_was_never_started_can_be_closed():
    cell = Cell(CellConfig("streaming", {}, "modbus", {}))
    assert not cell.alive
    assert cell.poll(0.0) == []
    with pytest.raises(MeasurementFailed, match="not alive"):
        cell.connect()
    cell.close()


def test_the_cell_uses_one_thread_for_linear_algebra(connected):
    environment = psutil.Process(connected.cell.process_id).environ()
    assert environment["OMP_NUM_THREADS"] == "1"
    assert environment["OPENBLAS_NUM_THREADS"] == "1"


def test_a_cell_obeys_in_the_same_process_as_well(bench, order):
    """For debugging; it also ends when its life line is ready."""
    ours, theirs = Pipe()
    reading, writing = os.pipe()
    thread = threading.Thread(target=serve, args=(theirs, config_of(bench), (reading,)))
    thread.start()
    try:
        ours.send(CellVerb.CONNECT)
        kinds = []
        while Connected not in kinds:
            assert ours.poll(10.0)
            kinds.append(type(ours.recv()))
        ours.send(CellVerb.PAUSE)
        ours.send(order)
        while not isinstance(ours.recv(), MeasurementProgress):
            pass
    finally:
        os.write(writing, b"x")
        thread.join(10.0)
        os.close(reading)
        os.close(writing)
        ours.close()
        theirs.close()
    assert not thread.is_alive()
    assert open_run(order.run_file).provenance["outcome"] == "aborted"


def progress(done: int, ballast: str = "") -> MeasurementProgress:
    return MeasurementProgress(done, 10, "lines", "measuring" + ballast, 0.0, 0.0)


def block(number: int) -> BlockRecorded:
    samples = TrackerSamples.empty()
    return BlockRecorded(replace(samples, sequence=np.array([number])))


def state(text: str = "") -> StateChanged:
    return StateChanged(CellState.PAUSED, text)


def test_a_slow_parent_gets_the_latest_and_every_state():
    ours, theirs = Pipe()
    outbox = Outbox(theirs)
    for number in range(50):
        outbox.report(progress(number, "x" * 1_000_000))
        outbox.report(state(str(number)))
    events: list[CellEvent] = []
    while not events or events[-1] != state("49"):
        assert ours.poll(5.0)
        events.append(ours.recv())
    outbox.close(1.0)
    states = [e.text for e in events if isinstance(e, StateChanged)]
    assert states == [str(n) for n in range(50)]
    done = [e.done for e in events if isinstance(e, MeasurementProgress)]
    assert done[-1] == 49
    assert len(done) < 10
    ours.close()
    theirs.close()


def test_a_parent_that_is_gone_does_not_hang_the_outbox():
    ours, theirs = Pipe()
    outbox = Outbox(theirs)
    ours.close()
    outbox.report(state())
    outbox.close(5.0)
    assert not outbox._thread.is_alive()
    theirs.close()


class Reluctant:
    """A pipe's end whose other side takes nothing until it is told to."""

    def __init__(self) -> None:
        self.taken: list[CellEvent] = []
        self.taking = threading.Event()
        self.asked = threading.Event()

    def send(self, event: CellEvent) -> None:
        self.asked.set()
        assert self.taking.wait(20.0)
        self.taken.append(event)


@pytest.fixture
def reluctant() -> Iterator[tuple[Reluctant, Outbox]]:
    link = Reluctant()
    outbox = Outbox(link)
    outbox.report(state())
    assert link.asked.wait(5.0)  # one event is on its way, the others wait
    yield link, outbox
    link.taking.set()
    outbox.close(5.0)


def test_blocks_that_nobody_takes_are_dropped_and_counted(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS + 7):
        outbox.report(block(number))
    assert outbox.dropped_blocks == 7
    link.taking.set()
    outbox.close(5.0)
    blocks = [e for e in link.taken if isinstance(e, BlockRecorded)]
    assert [b.block.sequence[0] for b in blocks] == list(range(MAX_BLOCKS))


def test_what_is_no_block_is_kept_in_order_beside_dropped_blocks(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS + 1):
        outbox.report(block(number))
    outbox.report(FaultReported("beam-lost", "", ""))
    outbox.report(state())
    link.taking.set()
    outbox.close(5.0)
    others = [type(e) for e in link.taken if not isinstance(e, BlockRecorded)]
    assert others == [StateChanged, FaultReported, StateChanged]


def test_no_state_is_dropped_however_many_wait(reluctant):
    link, outbox = reluctant
    for number in range(5000):
        outbox.report(state(str(number)))
    link.taking.set()
    outbox.close(5.0)
    assert [e.text for e in link.taken[1:]] == [str(n) for n in range(5000)]


def test_there_is_room_for_blocks_again_once_they_are_taken(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS):
        outbox.report(block(number))
    link.taking.set()
    deadline_s = time.monotonic() + 10.0
    while len(link.taken) <= MAX_BLOCKS:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    outbox.report(block(MAX_BLOCKS))
    outbox.close(5.0)
    assert outbox.dropped_blocks == 0
    assert link.taken[-1].block.sequence[0] == MAX_BLOCKS


def test_a_parent_that_has_gone_ends_the_outbox_quietly():
    ours, theirs = Pipe()
    outbox = Outbox(theirs)
    ours.close()
    outbox.report(state())
    outbox.close(5.0)
    assert not outbox._thread.is_alive()
