"""Standstill points by a tracker that is polled, on devices in this process."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.run import Run, summarize_run
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import (
    BlockRecorded,
    CellVerb,
    FaultReported,
    LivePoints,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.time_limits import EngineSettings, StreamTimeouts
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    BeamLost,
    ConnectionLost,
    DeviceError,
    Refused,
)
from truepath_drivers.interfaces.records import Identity
from truepath_drivers.interfaces.tracker import EventSource, PolledTracker
from truepath_drivers.interfaces.tracker_records import (
    Air,
    Clock,
    PointMeasurement,
    TrackerCapabilities,
    TrackerEvent,
    TrackerEventKind,
)

pytestmark = pytest.mark.usefixtures("clock")

QUICK = EngineSettings(poll_s=0.01, settle_s=0.02, progress_s=0.0, confirm_s=30.0)
NOISE_MM = 0.001
PLACE_MM = np.array([2000.0, 300.0, 50.0])


class FakePolled(PolledTracker, EventSource):
    """Sees the axes of a controller in this process; shots come at 200 Hz."""

    def __init__(self, motion) -> None:
        self.motion = motion
        self.asked = self.connects = 0
        self.before: Callable[[int], None] = lambda _: None
        self.stopped = threading.Event()
        self.events: list[TrackerEvent] = []
        self._rng = np.random.default_rng(5)

    @property
    def capabilities(self) -> TrackerCapabilities:
        return TrackerCapabilities(streams=False, clock=Clock.HOST, distance="ADM")

    def connect(self) -> Identity:
        self.connects += 1
        return Identity("Us", "fake polled tracker", "P1", "0")

    def close(self) -> None:
        self.stop()

    def stop(self) -> None:
        self.stopped.set()

    def take_events(self) -> tuple[TrackerEvent, ...]:
        events, self.events = tuple(self.events), []
        return events

    def measure(self, dwell_s: float) -> PointMeasurement:
        self.stopped.clear()
        self.asked += 1
        self.before(self.asked)
        begin_s = host_clock.now_s()
        times, shots = [], []
        while host_clock.now_s() - begin_s < dwell_s or not shots:
            noise = self._rng.normal(0.0, NOISE_MM, 3)
            shots.append(PLACE_MM + self.motion.here + noise)
            times.append(host_clock.now_s())
            if host_clock.wait(self.stopped, 0.005):
                raise Refused("the measurement was stopped")
        air = Air(21.5, 1013.0, 40.0)
        return PointMeasurement.average(np.array(times), np.array(shots), air)


@pytest.fixture
def polled(motion) -> FakePolled:
    motion.speed = 2000.0
    return FakePolled(motion)


@pytest.fixture
def order(mill, tmp_path) -> MeasurementOrder:
    rng = np.random.default_rng(3)
    position = rng.uniform([10, 10, -290], [490, 390, -10], (4, 3))
    points = Configurations(("X", "Y", "Z"), position, np.full(4, 0.03))
    file = tmp_path / "points.sqlite"
    return MeasurementOrder("points", str(file), mill, points, reserve_bytes=0)


@pytest.fixture
def measure(polled, motion, order, journal):
    """Measure to the end; return the last state and the Run."""

    def made(
        order: MeasurementOrder = order, settings: EngineSettings = QUICK
    ) -> tuple[str, Run | None]:
        devices = {"tracker": polled.connect(), "motion": motion.connect()}
        made.measurement = Measurement(
            order, polled, motion, devices, journal.report, settings
        )
        made.measurement.run()
        closed = journal.of(RunClosed)[-1]
        run = open_run(closed.run_file) if closed.run_file else None
        return journal.states[-1], run

    return made


def codes(journal) -> list[str]:
    return [fault.code for fault in journal.of(FaultReported)]


def test_each_point_is_one_mean_of_its_row(measure, order, journal):
    state, run = measure()
    assert state == "finished"
    assert run.points.row.tolist() == list(range(4))
    assert (run.points.count >= 3).all()
    off = run.tracker.position_mm - PLACE_MM - order.commanded.position
    assert np.abs(off).max() < 5 * NOISE_MM
    spread = np.sqrt(np.einsum("nii->ni", run.points.covariance_mm2)).mean()
    assert spread == pytest.approx(NOISE_MM, rel=0.4)
    assert run.temperature.celsius[:, 0].tolist() == [21.5] * 4
    assert journal.of(RunClosed)[-1].samples == 4


def test_a_bundle_keeps_rows_shots_and_covariances(measure, tmp_path):
    _, run = measure()
    write_bundle(run, tmp_path / "bundle")
    again = read_bundle(tmp_path / "bundle")
    assert again.points.row.tolist() == run.points.row.tolist()
    assert again.points.count.tolist() == run.points.count.tolist()
    assert again.points.covariance_mm2 == pytest.approx(run.points.covariance_mm2)
    assert again.tracker.position_mm.tolist() == run.tracker.position_mm.tolist()
    first, second = align(run), align(again)
    assert first.row.tolist() == second.row.tolist() == list(range(4))
    assert first.scatter == pytest.approx(second.scatter)


def test_the_machine_stands_meanwhile_and_each_point_goes_to_the_live_estimate(
    measure, order, polled, motion, journal
):
    moved = []

    def look(_: int) -> None:
        moved.append(motion.status().state == "running")

    polled.before = look
    _, run = measure(replace(order, live=True))
    assert moved == [False] * 4
    blocks = [event.block for event in journal.of(BlockRecorded)]
    assert [block.points.row.tolist() for block in blocks] == [[0], [1], [2], [3]]
    told = [block.samples.position_mm[0].tolist() for block in blocks]
    assert told == run.tracker.position_mm.tolist()
    assert sum(len(event.tracker_mm) for event in journal.of(LivePoints)) == 4


def test_a_lost_target_holds_until_somebody_resumes_and_is_measured_again(
    measure, polled, journal
):
    def lose(asked: int) -> None:
        if asked == 3:
            timer = threading.Timer(0.3, measure.measurement.obey, (CellVerb.RESUME,))
            timer.start()
            raise BeamLost("no prism in the field of view")

    polled.before = lose
    state, run = measure()
    assert state == "finished"
    assert "beam-lost" in codes(journal)
    assert "paused" in journal.states
    assert run.points.row.tolist() == list(range(4))


def test_a_link_that_is_lost_is_connected_anew(measure, polled):
    def lose(asked: int) -> None:
        if asked == 2:
            raise ConnectionLost("the cable was pulled")

    polled.before = lose
    state, run = measure()
    assert (state, polled.connects) == ("finished", 2)
    assert run.points.row.tolist() == list(range(4))


@pytest.mark.parametrize("error", [ConnectionLost("gone"), DeviceError("broken")])
def test_what_does_not_come_back_is_a_fault(measure, polled, error):
    def fail(asked: int) -> None:
        if asked >= 2:
            raise error

    polled.before = fail
    state, run = measure()
    assert state == "faulted"
    assert run.points.row.tolist() == [0]


def test_a_point_that_never_ends_is_a_fault(measure, polled, journal):
    polled.before = lambda asked: (
        host_clock.wait(polled.stopped, 20.0) if asked == 2 else None
    )
    timeouts = StreamTimeouts(point_s=0.3)
    state, _ = measure(settings=replace(QUICK, timeouts=timeouts))
    assert (state, codes(journal)) == ("faulted", ["tracker-silent"])


def test_a_machine_that_is_moved_meanwhile_is_measured_anew(measure, polled, motion):
    def jog(asked: int) -> None:
        if asked == 2:
            here = motion.here.copy()
            motion.here = here + 5.0
            threading.Timer(0.1, setattr, (motion, "here", here)).start()

    polled.before = jog
    state, run = measure()
    assert state == "finished"
    assert run.points.row.tolist() == list(range(4))
    off = run.tracker.position_mm - PLACE_MM - run.commanded.position
    assert np.abs(off).max() < 5 * NOISE_MM


def test_abort_ends_a_point_under_way_and_keeps_the_others(measure, polled):
    def abort(asked: int) -> None:
        if asked == 4:
            measure.measurement.obey(CellVerb.ABORT)

    polled.before = abort
    state, run = measure()
    assert state == "aborted"
    assert run.points.row.tolist() == [0, 1, 2]


def test_a_path_is_refused_before_anything_moves(measure, order, square, motion):
    state, _ = measure(replace(order, commanded=square))
    assert state == "failed"
    assert "move_to" not in motion.calls


@pytest.mark.fault_row(10)
def test_warnings_of_the_instrument_are_told_and_recorded(
    measure, polled, journal, measured
):
    warning = TrackerEvent(TrackerEventKind.WARNING, "battery low", "plug it in")
    polled.before = lambda asked: polled.events.append(warning) if asked == 2 else None
    state, run = measure()
    assert state == "finished"
    assert journal.of(FaultReported)[0].text == "battery low"
    assert ("tracker-warning", "battery low") in [(e.kind, e.text) for e in run.events]
    assert summarize_run(run).told == ("battery low",)
    measured("1 of 1 told, in the Run and in its result")
