"""Measurements on devices in this process: procedures, verbs, faults."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from truepath.measurement.engine.axis_order import arrange_axes
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.faults import Fault
from truepath.measurement.messages import (
    CellVerb,
    FaultReported,
    LinesDamaged,
    LivePoints,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.time_limits import EngineSettings
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    MotionFault,
    OutOfTravel,
    Refused,
)
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.interfaces.tracker_records import Clock, TrackerCapabilities

pytestmark = pytest.mark.usefixtures("clock")

JUDGED = EngineSettings(poll_s=0.02, progress_s=0.0, axes_rows=5)
"""The patience of the service."""


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for a condition that nobody tells of."""
    deadline_s = host_clock.now_s() + 25.0
    while not condition():
        assert host_clock.now_s() < deadline_s
        host_clock.sleep_s(0.005)


class Running:
    """A measurement on fake devices, in a thread."""

    def __init__(self, order, tracker, motion, journal, settings) -> None:
        devices = {"tracker": tracker.connect(), "motion": motion.connect()}
        self.order, self.journal, self.motion = order, journal, motion
        self.measurement = Measurement(
            order,
            tracker,
            motion,
            devices,
            journal.report,
            settings,
        )
        self.thread = threading.Thread(target=self.measurement.run)

    def start(self) -> Running:
        self.thread.start()
        return self

    def until(self, condition: Callable[[], bool]) -> None:
        self.journal.wait(condition)

    def until_state(self, state: str) -> None:
        self.until(lambda: state in self.journal.states)

    def until_moving(self) -> None:
        self.until(
            lambda: any(p.done >= 1 for p in self.journal.of(MeasurementProgress))
        )

    def pass_until(self, condition: Callable[[], bool]) -> None:
        """Let time pass, a tenth of a second a look, until something has happened."""
        deadline_s = host_clock.now_s() + 25.0
        while not condition():
            assert host_clock.now_s() < deadline_s, self.journal.events[-8:]
            host_clock.sleep_s(0.1)

    def finished(self) -> None:
        """Let the machine be quick about the rest; it ends in order."""
        self.motion.speed = 5000.0
        self.motion.override = 5000.0  # it says so, or it would not be believed
        assert self.ended() == "finished"

    def ended(self) -> str:
        self.until(lambda: bool(self.journal.of(RunClosed)))
        host_clock.join(self.thread, 5.0)
        assert not self.thread.is_alive()
        return self.journal.states[-1]

    @property
    def run(self):
        return open_run(self.order.run_file)


@pytest.fixture
def order(mill, square, tmp_path) -> MeasurementOrder:
    return MeasurementOrder(
        "monday", str(tmp_path / "monday.sqlite"), mill, square, reserve_bytes=0
    )


def there_and_back(order: MeasurementOrder, times: int) -> MeasurementOrder:
    """Return the order with a path of long lines, a quarter of a second each."""
    position = np.tile([[10.0, 10.0, -10.0], [410.0, 310.0, -210.0]], (times, 1))
    n = len(position)
    path = replace(
        order.commanded,
        position=position,
        feed_mm_min=np.full(n, 6000.0),
        dwell_s=np.zeros(n),
    )
    return replace(order, commanded=path)


@pytest.fixture
def short_order(order) -> MeasurementOrder:
    """Almost two seconds of motion, there and back again."""
    return there_and_back(order, 4)


@pytest.fixture
def long_order(order) -> MeasurementOrder:
    """A minute of motion: no test is so slow that it misses it."""
    return there_and_back(order, 110)


@pytest.fixture
def begin(tracker, motion, journal, calm) -> Iterator[Callable[..., Running]]:
    begun: list[Running] = []

    def start(
        order: MeasurementOrder,
        *,
        settings: EngineSettings = calm,
    ) -> Running:
        begun.append(Running(order, tracker, motion, journal, settings).start())
        return begun[-1]

    yield start
    for one in begun:
        if one.thread.is_alive():
            one.measurement.obey(CellVerb.ABORT)
            host_clock.join(one.thread, 5.0)


def test_a_path_is_streamed_from_before_the_first_motion_to_after_the_last(
    begin, order, motion, journal
):
    running = begin(order)
    assert running.ended() == "finished"
    run = running.run
    assert motion.calls == ["abort", "move_to", "load", "start"]
    np.testing.assert_array_equal(motion.loaded.position, order.commanded.position)
    assert run.mode == "otf"
    assert run.name == "monday"
    assert run.machine == order.machine
    assert run.provenance["outcome"] == "finished"
    assert run.provenance["tracker"] == "Us fake tracker T1 0"
    # 3 lines of 100, 50, 105 mm at 100 mm/s and a second at both ends.
    assert np.ptp(run.tracker.device_time_s) > 2.55 + 2 * 0.9
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert journal.states == ["running", "finished"]


def test_what_is_told_at_the_end_is_what_the_file_holds(begin, order, journal):
    running = begin(order)
    running.ended()
    kinds = [type(event) for event in journal.events]
    assert kinds[-2:] == [StateChanged, RunClosed]
    closed = journal.of(RunClosed)[0]
    assert closed.run_file == order.run_file
    assert closed.samples == len(running.run.tracker)
    assert closed.lost_samples == 0
    assert closed.outcome == "finished"
    assert len(closed.sha256) == 64


def test_the_bytes_of_the_link_are_kept_beside_the_samples(
    begin, order, read_link_bytes
):
    running = begin(order)
    running.ended()
    assert len(read_link_bytes(order.run_file)) == len(running.run.tracker)


def test_axis_positions_are_recorded_slowly(begin, order):
    running = begin(order)
    running.ended()
    axes = running.run.axis_samples
    assert axes.axes == ("X", "Y", "Z")
    assert (np.diff(axes.host_time_s) > 0).all()
    assert np.ptp(axes.position_mm[:, 0]) == pytest.approx(110.0, abs=1.0)


def test_progress_counts_lines_and_foresees_the_end(begin, short_order, journal):
    begin(short_order).ended()
    progress = journal.of(MeasurementProgress)
    assert [p.done for p in progress] == sorted(p.done for p in progress)
    last = progress[-1]
    assert (last.done, last.total, last.unit) == (7, 7, "lines")
    assert last.stage == "closing"
    assert last.remaining_s == 0.0
    assert last.crc_errors == 2
    assert last.samples > 0
    # The fake machine is twenty times faster than the 38 s that were planned.
    half_way = next(p for p in progress if p.done >= 3)
    assert half_way.remaining_s < 6.0


def test_live_points_are_a_tenth_of_a_second_apart(begin, short_order, journal):
    begin(short_order).ended()
    live = journal.of(LivePoints)
    points = sum(len(body.tracker_mm) for body in live)
    device_s = live[-1].device_time_s - 100.0
    assert points == pytest.approx(10 * device_s, abs=3)
    away = np.subtract(live[-1].tracker_mm[0], live[-1].axes)
    assert away == pytest.approx([1.0, 2.0, 3.0], abs=1e-3)
    assert len(live[-1].axes) == 3


def test_the_watchdog_is_fed_at_every_look_while_the_machine_moves(
    begin, short_order, motion
):
    begin(short_order).ended()
    assert motion.looks > 10
    assert motion.beats == motion.looks


def test_points_are_stepped_through_with_a_dwell_at_each(
    begin, order, square, motion, journal
):
    points = Configurations(square.axes, square.position, np.full(4, 2.0))
    running = begin(replace(order, commanded=points))
    assert running.ended() == "finished"
    assert motion.calls == ["abort"] + 4 * ["move_to"]
    run = running.run
    assert run.mode == "standstill"
    done = [e.text for e in run.events if e.kind == "point"]
    assert [text.split(" until ")[0] for text in done] == [
        f"row {i}" for i in (1, 2, 3, 4)
    ]
    until_s = [float(text.split()[3]) for text in done]
    assert (np.diff(until_s) > 2.3).all()
    last = journal.of(MeasurementProgress)[-1]
    assert (last.done, last.total, last.unit) == (4, 4, "points")


@pytest.mark.fault_row(22)
@pytest.mark.parametrize("comes_back", [True, False])
def test_a_point_that_the_machine_leaves_is_measured_anew_or_never(
    begin, order, square, motion, journal, calm, comes_back, measured
):
    """Somebody jogs the machine while it is measured where it stands."""
    points = Configurations(square.axes, square.position[:2], np.full(2, 60.0))
    settings = calm if comes_back else replace(calm, confirm_s=0.5)
    running = begin(replace(order, commanded=points), settings=settings)
    running.until(lambda: any(b.device_time_s > 110.0 for b in journal.of(LivePoints)))
    with motion._lock:
        motion.here = motion.here + 1.0
        left_s = journal.of(LivePoints)[-1].device_time_s
    running.until(lambda: journal.of(LivePoints)[-1].device_time_s > left_s + 10.0)
    if comes_back:
        with motion._lock:
            motion.here = motion.here - 1.0
        assert running.ended() == "finished"
        done = [e.text for e in running.run.events if e.kind == "point"]
        assert "row 1: moved while it was measured" in done
        until_s = float(next(t for t in done if " until " in t).split()[3])
        assert until_s > left_s + 60.0
        measured(f"measured anew for {until_s - left_s:.0f} s of 60 s asked for")
    else:
        assert running.ended() == "faulted"
        assert journal.faults == ["ended-early"]


@pytest.mark.fault_row(20)
def test_a_machine_that_runs_without_moving_is_told_once_and_goes_on(
    begin, order, motion, journal, calm
):
    """The feed override stands at 0 %, and the controller does not tell."""
    running = begin(order, settings=replace(calm, stuck_s=0.1))
    running.until_moving()
    speed, motion.speed = motion.speed, 0.0
    running.until(lambda: bool(journal.faults))
    motion.speed = speed
    assert running.ended() == "finished"
    assert journal.faults == ["not-moving"]
    assert "override" in journal.of(FaultReported)[0].action


def test_pause_holds_and_resume_goes_on(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    here = motion.status().position
    assert motion.status().position == here
    running.measurement.obey(CellVerb.PAUSE)
    running.measurement.obey(CellVerb.RESUME)
    running.finished()
    assert journal.states == [
        "running",
        "pausing",
        "paused",
        "resuming",
        "running",
        "finished",
    ]
    kinds = [e.text.split(":")[0] for e in running.run.events if e.kind == "state"]
    assert kinds == ["pausing", "paused", "resuming", "running"]


def test_resume_without_a_pause_is_nothing(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.RESUME)
    running.finished()
    assert "resume" not in motion.calls
    assert journal.states == ["running", "finished"]


def test_a_pause_in_a_dwell_makes_the_dwell_start_over(
    begin, order, square, motion, journal
):
    points = Configurations(square.axes, square.position[:2], np.full(2, 60.0))
    running = begin(replace(order, commanded=points))
    running.until(lambda: any(b.device_time_s > 110.0 for b in journal.of(LivePoints)))
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    assert motion.calls.count("move_to") == 1
    resumed_s = journal.of(LivePoints)[-1].device_time_s
    running.measurement.obey(CellVerb.RESUME)
    assert running.ended() == "finished"
    first = next(e.text for e in running.run.events if e.kind == "point")
    assert float(first.split()[3]) > resumed_s + 59.0


def test_abort_stops_the_machine_and_keeps_the_run(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.ABORT)
    assert running.ended() == "aborted"
    assert motion.calls[-1] == "abort"
    assert motion.status().state == "aborted"
    assert running.run.provenance["outcome"] == "aborted"
    assert len(running.run.tracker) > 100


@pytest.mark.fault_row(17)
def test_an_abort_that_the_controller_ignores_is_a_fault(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.ignores_abort = True
    running.measurement.obey(CellVerb.ABORT)
    assert running.ended() == "faulted"
    assert journal.faults[-1] == "stop-unconfirmed"


@pytest.mark.fault_row(16)
def test_an_abort_of_a_controller_out_of_reach_is_a_fault(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.out_of_reach = True
    with pytest.raises(DeviceTimeout):
        running.measurement.obey(CellVerb.ABORT)
    assert running.ended() == "faulted"
    assert journal.faults[-1] == "stop-unconfirmed"


def test_abort_while_paused_is_an_abort(begin, long_order, journal):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    running.measurement.obey(CellVerb.ABORT)
    assert running.ended() == "aborted"


def test_verbs_before_the_beginning_and_after_the_end_do_no_harm(
    order, tracker, motion, journal, calm
):
    running = Running(order, tracker, motion, journal, calm)
    running.measurement.obey(CellVerb.PAUSE)
    running.measurement.obey(CellVerb.RESUME)
    running.measurement.obey(CellVerb.ABORT)
    running.start()
    assert running.ended() == "aborted"
    assert "start" not in motion.calls
    running.measurement.obey(CellVerb.PAUSE)
    running.measurement.obey(CellVerb.RESUME)
    assert journal.states[-1] == "aborted"


def test_enough_ends_the_path_in_order_after_the_line_under_way(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.CONCLUDE)
    assert running.ended() == "finished"
    assert "enough is known" in journal.of(StateChanged)[-1].text
    assert motion.calls[-1] == "abort"
    run = running.run
    (event,) = [e for e in run.events if e.kind == "concluded"]
    assert "the rest is left out" in event.text
    last = journal.of(MeasurementProgress)[-1]
    assert last.stage == "closing"
    assert 1 <= last.done < last.total
    assert run.provenance["outcome"] == "finished"


def test_enough_ends_standstill_points_in_order_after_the_dwell_under_way(
    begin, order, square, motion, journal
):
    points = Configurations(square.axes, square.position, np.full(4, 30.0))
    running = begin(replace(order, commanded=points))
    running.until(lambda: any(b.device_time_s > 105.0 for b in journal.of(LivePoints)))
    running.measurement.obey(CellVerb.CONCLUDE)
    assert running.ended() == "finished"
    assert motion.calls.count("move_to") == 1
    run = running.run
    kinds = [e.kind for e in run.events if e.kind in ("point", "concluded")]
    assert kinds == ["point", "concluded"]
    first = next(e.text for e in run.events if e.kind == "point")
    assert float(first.split()[3]) > 100.0 + 30.0  # the dwell was finished
    last = journal.of(MeasurementProgress)[-1]
    assert (last.done, last.total, last.unit) == (1, 4, "points")


def test_enough_at_the_last_point_leaves_nothing_out(
    begin, order, square, motion, journal
):
    points = Configurations(square.axes, square.position[:1], np.full(1, 20.0))
    running = begin(replace(order, commanded=points))
    running.until(lambda: any(b.device_time_s > 102.0 for b in journal.of(LivePoints)))
    running.measurement.obey(CellVerb.CONCLUDE)
    assert running.ended() == "finished"
    assert not [e for e in running.run.events if e.kind == "concluded"]


def test_enough_while_paused_waits_for_resume(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    running.measurement.obey(CellVerb.CONCLUDE)
    told = len(journal.of(MeasurementProgress))
    running.until(lambda: len(journal.of(MeasurementProgress)) > told + 3)
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.RESUME)
    assert running.ended() == "finished"
    assert [e.kind for e in running.run.events].count("concluded") == 1


def test_halt_holds_the_feed_and_forgets_nothing(begin, long_order, motion):
    running = begin(long_order)
    running.until_moving()
    running.measurement.halt()
    assert running.ended() == "aborted"
    assert motion.status().state == "held"


@pytest.mark.fault_row(5)
def test_a_short_silence_holds_the_feed_and_goes_on_by_itself(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.silent = True
    running.pass_until(lambda: "paused" in journal.states)
    assert motion.status().state == "held"
    missed = tracker.health.frames
    wait_until(lambda: tracker.health.frames > missed + 200)
    tracker.silent = False
    running.until(lambda: journal.states[-1] == "running")
    running.finished()
    assert journal.faults == ["tracker-silent"]
    run = running.run
    assert (np.diff(run.tracker.sequence) > 1).sum() == 1
    assert any(e.kind == "gap" for e in run.events)
    assert journal.of(RunClosed)[0].lost_samples > 100


@pytest.mark.fault_row(5)
def test_a_silence_of_a_moment_costs_its_samples_and_asks_for_no_hold(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.silent = True
    host_clock.sleep_s(0.45)
    tracker.silent = False
    running.finished()
    assert journal.faults == []
    assert "hold" not in motion.calls
    assert journal.of(RunClosed)[0].lost_samples > 100
    assert any(event.kind == "gap" for event in running.run.events)


def test_a_hold_is_seen_through_even_if_the_stream_is_back_before_the_machine_stands(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    motion.ignores_hold = True  # as one that still brakes
    tracker.silent = True
    running.pass_until(lambda: journal.states[-1] == "pausing")
    tracker.silent = False
    live = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > live + 3)
    assert "resume" not in motion.calls
    motion.ignores_hold = False
    running.until(lambda: journal.states[-1] == "running")
    running.finished()
    assert journal.states[:-1] == [
        "running",
        "pausing",
        "paused",
        "resuming",
        "running",
    ]
    assert journal.faults == ["tracker-silent"]


@pytest.mark.parametrize("who", ["operator", "watchdog"])
@pytest.mark.parametrize("first", ["machine", "tracker"])
def test_the_end_of_a_silence_does_not_undo_a_hold_at_the_machine(
    begin, long_order, tracker, motion, journal, who, first
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    if first == "machine":
        motion.stand(who)
        running.until_state("paused")
        tracker.silent = True
        running.pass_until(lambda: "tracker-silent" in journal.faults)
    else:
        motion.ignores_hold = True  # the machine's own hold comes before ours
        tracker.silent = True
        running.pass_until(lambda: "tracker-silent" in journal.faults)
        motion.stand(who)
        running.until(lambda: journal.states[-1] == "paused")
        motion.ignores_hold = False
    tracker.silent = False
    # What it waits for now is said last, for whoever has to do it.
    running.until(lambda: journal.faults[-1] == "held-at-machine")
    live = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > live + 3)
    assert journal.states[-1] == "paused"
    assert who in journal.of(FaultReported)[-1].text
    assert "resume" not in motion.calls
    running.measurement.obey(CellVerb.RESUME)
    running.finished()


def test_a_hold_at_the_machine_while_a_stop_ends_by_itself_is_kept(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.silent = True
    running.pass_until(lambda: journal.states[-1] == "paused")
    motion.ignores_resume = True
    tracker.silent = False
    running.until(lambda: journal.states[-1] == "resuming")
    motion.go_on()
    motion.stand("operator")
    running.until(lambda: journal.states[-1] == "paused")
    motion.ignores_resume = False
    resumes = motion.calls.count("resume")
    live = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > live + 3)
    assert motion.status().state == "held"
    assert motion.calls.count("resume") == resumes
    running.measurement.obey(CellVerb.RESUME)
    running.finished()


@pytest.mark.fault_row(30)
def test_time_in_which_the_host_did_not_run_is_no_silence(
    begin, long_order, journal, clock
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    running.motion.override = 1000.0  # it moved on meanwhile, and is believed
    for _ in range(3):
        clock.time_s += 10.0  # as after a suspension of the process
        told = len(journal.of(MeasurementProgress))
        running.until(lambda told=told: len(journal.of(MeasurementProgress)) > told + 3)
    running.finished()
    assert journal.faults == []
    assert journal.states == ["running", "finished"]


@pytest.mark.fault_row(29)
def test_a_wall_clock_that_jumps_changes_neither_durations_nor_order(
    begin, long_order, journal, clock, measured
):
    running = begin(long_order)
    running.until_moving()
    for jump_s in (3600.0, -3600.0, -host_clock.wall_s()):
        clock.wall_jump_s = jump_s
        seen = len(journal.of(MeasurementProgress))
        running.until(lambda seen=seen: len(journal.of(MeasurementProgress)) > seen + 9)
    running.finished()
    assert journal.faults == []
    told = [p for p in journal.of(MeasurementProgress) if p.stage == "measuring"]
    elapsed_s = [each.elapsed_s for each in told]
    assert (np.diff(elapsed_s) >= 0.0).all()
    assert elapsed_s[-1] < 60.0
    run = running.run
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (np.diff(run.axis_samples.host_time_s) > 0.0).all()
    times_ns = [event.mono_ns for event in run.events]
    assert times_ns == sorted(times_ns)
    measured("+1 h, -1 h and back to 1970: no gap, order and durations as without")


def test_a_silence_does_not_undo_a_pause(begin, long_order, tracker, motion, journal):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    tracker.silent = True
    running.pass_until(lambda: journal.faults == ["tracker-silent"])
    running.measurement.obey(CellVerb.RESUME)
    running.until(lambda: journal.faults == ["tracker-silent", "not-resumed"])
    tracker.silent = False
    events = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > events + 3)
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.RESUME)
    running.finished()


@pytest.mark.fault_row(5)
def test_a_long_silence_is_a_fault_with_the_feed_held(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.silent = True
    running.pass_until(lambda: len(journal.faults) == 2)
    assert running.ended() == "faulted"
    assert motion.status().state == "held"
    assert journal.faults == ["tracker-silent", "tracker-silent"]
    assert "check the tracker and its cable" in journal.of(FaultReported)[-1].action
    assert running.run.provenance["outcome"] == "faulted"


@pytest.mark.fault_row(1)
def test_a_damaged_stream_holds_and_its_lines_are_driven_again(
    begin, short_order, tracker, motion, journal
):
    running = begin(short_order)
    running.until_moving()
    tracker.damaged = True
    running.until_state("paused")
    assert "hold" in motion.calls
    assert journal.faults == ["stream-damaged"]
    tracker.damaged = False
    running.finished()
    commanded = running.run.commanded.position
    rows = len(short_order.commanded)
    assert np.array_equal(commanded[:rows], short_order.commanded.position)
    assert len(commanded) > rows
    assert motion.calls.count("start") == 2
    assert "again" in [event.kind for event in running.run.events]
    assert "bad or lost" in running.run.provenance["stream"]
    assert journal.of(LinesDamaged)[0].again is not None
    ends = [event for event in journal.of(StateChanged) if event.state == "finished"]
    assert "some twice" in ends[0].text


def test_a_stream_that_stays_damaged_is_a_fault_with_the_feed_held(
    begin, long_order, tracker, motion, journal
):
    tracker.speed = motion.speed = 1.0  # as the second in which damage is counted
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.damaged = True
    running.until_state("paused")
    running.pass_until(lambda: bool(journal.of(RunClosed)))
    assert running.ended() == "faulted"
    assert set(journal.faults) == {"stream-damaged"}
    assert motion.status().state == "held"


def test_a_damaged_stream_before_the_path_costs_no_line(
    begin, short_order, tracker, motion, journal
):
    tracker.damaged = True
    running = begin(short_order)
    running.until_state("paused")
    tracker.damaged = False
    running.finished()
    assert motion.calls.count("start") == 1


@pytest.mark.fault_row(9)
def test_a_lost_beam_holds_until_somebody_resumes(
    begin, long_order, tracker, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    tracker.beam = False
    running.pass_until(lambda: "paused" in journal.states)
    assert journal.faults == ["beam-lost"]
    running.measurement.obey(CellVerb.RESUME)
    running.until(lambda: journal.faults[-1] == "not-resumed")
    tracker.beam = True
    live = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > live + 2)
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.RESUME)
    running.finished()
    assert (running.run.tracker.status != 0).any()


@pytest.mark.fault_row(9)
def test_a_dwell_in_which_the_beam_was_lost_begins_anew(
    begin, order, square, tracker, journal
):
    points = Configurations(square.axes, square.position[:2], np.full(2, 20.0))
    ordered = replace(order, commanded=points)
    running = begin(ordered, settings=JUDGED)
    running.until(lambda: any(b.device_time_s > 105.0 for b in journal.of(LivePoints)))
    tracker.beam = False
    running.pass_until(lambda: journal.states[-1] == "paused")
    assert journal.faults == ["beam-lost"]
    tracker.beam = True
    live = len(journal.of(LivePoints))
    running.until(lambda: len(journal.of(LivePoints)) > live + 2)
    running.measurement.obey(CellVerb.RESUME)
    assert running.ended() == "finished"
    stream = running.run.tracker
    lost_s = stream.device_time_s[stream.status != 0].max()
    ends = [e.text.split()[3] for e in running.run.events if e.kind == "point"]
    assert float(ends[0]) > lost_s + 20.0
    assert float(ends[1]) > float(ends[0]) + 20.0


def test_a_tracker_that_never_sends_is_a_fault_before_the_path_starts(
    begin, order, tracker, motion, journal
):
    tracker.silent = True
    running = begin(order, settings=JUDGED)
    running.pass_until(lambda: bool(journal.of(RunClosed)))
    assert running.ended() == "faulted"
    assert journal.faults[-1] == "tracker-silent"
    assert "start" not in motion.calls


def test_a_tracker_without_a_beam_fails_before_the_path_starts(
    begin, order, tracker, motion, journal
):
    tracker.beam = False
    running = begin(order, settings=JUDGED)
    running.pass_until(lambda: bool(journal.of(RunClosed)))
    assert "beam-lost" in journal.faults
    assert running.ended() == "failed"
    assert "start" not in motion.calls


def test_a_tracker_that_refuses_the_rate_fails_the_order(
    begin, order, tracker, motion, journal
):
    tracker.refusal = Refused("500 Hz is too fast for this instrument")
    assert begin(order).ended() == "failed"
    assert journal.of(FaultReported)[-1].code == "refused"
    assert "500 Hz is too fast" in journal.of(FaultReported)[-1].text


def test_no_path_is_driven_for_a_tracker_that_stamps_samples_as_they_arrive(
    begin, order, tracker, motion, journal, monkeypatch
):
    stamps = TrackerCapabilities(clock=Clock.HOST)
    monkeypatch.setattr(type(tracker), "capabilities", stamps)
    assert begin(order).ended() == "failed"
    assert journal.of(FaultReported)[-1].code == "no-times"
    assert not {"move_to", "load", "start"} & set(motion.calls)


@pytest.mark.parametrize("error", [ConnectionLost("unplugged"), OSError("odd")])
def test_a_tracker_that_goes_away_is_a_fault(
    begin, long_order, tracker, motion, journal, error
):
    running = begin(long_order)
    running.until_moving()
    tracker.error = error
    assert running.ended() == "faulted"
    assert motion.status().state == "held"
    code = "link-lost" if isinstance(error, ConnectionLost) else "internal"
    assert journal.faults == [code]


def test_a_counter_that_goes_back_fails_the_run(begin, long_order, tracker, journal):
    running = begin(long_order)
    running.until_moving()
    tracker.restarted = True
    assert running.ended() == "failed"
    assert "counter went back" in journal.of(FaultReported)[-1].text


@pytest.mark.fault_row(19)
def test_an_alarm_is_a_fault_with_its_text(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    motion.raise_alarm("1201 following error X")
    assert running.ended() == "faulted"
    assert journal.faults == ["motion-alarm"]
    assert "1201 following error X" in journal.of(FaultReported)[0].text
    assert len(running.run.tracker) > 100


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (MotionState.ESTOP, ("emergency stop is active", "release it")),
        (MotionState.UNHOMED, ("not homed", "home it")),
        (MotionState.NOT_READY, ("drives are off", "switch the machine on")),
        (MotionState.DOOR, ("door is open", "close it")),
    ],
)
@pytest.mark.fault_row(19)
def test_a_machine_that_cannot_be_driven_is_not_and_says_why(
    begin, long_order, motion, journal, state, said
):
    motion._state = state
    assert begin(long_order).ended() == "failed"
    assert motion.calls == []
    (fault,) = journal.of(FaultReported)
    assert fault.code == f"motion-{state}"
    assert said[0] in fault.text
    assert said[1] in fault.action


def test_a_machine_that_says_it_is_not_referenced_is_not_driven(
    begin, long_order, motion, journal
):
    motion.referenced = False
    assert begin(long_order).ended() == "failed"
    assert motion.calls == []
    assert journal.faults == ["motion-unhomed"]


@pytest.mark.parametrize(
    ("told", "noted"), [(True, "on"), (False, "off"), (None, None)]
)
def test_a_run_tells_whether_the_control_compensated(begin, order, motion, told, noted):
    motion.compensation = told
    running = begin(order)
    assert running.ended() == "finished"
    assert running.run.provenance.get("control_compensation") == noted


@pytest.mark.fault_row(19)
@pytest.mark.parametrize(
    ("state", "code", "said"),
    [
        (MotionState.ESTOP, "motion-estop", "emergency stop"),
        (MotionState.DOOR, "motion-door", "door"),
        (MotionState.UNHOMED, "motion-unhomed", "home"),
    ],
)
def test_a_machine_that_cannot_go_on_is_a_fault_that_says_why(
    begin, long_order, motion, journal, state, code, said
):
    running = begin(long_order)
    running.until_moving()
    motion._state = state
    assert running.ended() == "faulted"
    assert journal.faults == [code]
    (fault,) = journal.of(FaultReported)
    assert said in f"{fault.text} {fault.action}".lower()
    assert len(running.run.tracker) > 100


@pytest.mark.fault_row(19)
def test_overtravel_is_told_in_the_words_of_the_controller(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.raise_alarm("510: X beyond its software limit")
    assert running.ended() == "faulted"
    assert "510: X beyond its software limit" in journal.of(FaultReported)[0].text
    assert len(running.run.tracker) > 100


@pytest.mark.fault_row(21)
def test_a_motion_that_ends_early_is_a_fault(begin, long_order, motion, journal):
    running = begin(long_order)
    running.until_moving()
    motion.ends_after_s = 0.0
    assert running.ended() == "faulted"
    assert journal.faults == ["ended-early"]
    assert "not at 410.000, 310.000, -210.000" in journal.of(FaultReported)[0].text


@pytest.mark.fault_row(21)
def test_a_machine_that_runs_on_after_its_last_row_is_a_fault(
    begin, order, motion, journal
):
    motion.runs_on = True
    running = begin(order)
    assert running.ended() == "faulted"
    assert journal.faults == ["runs-on"]
    text = journal.of(FaultReported)[0].text
    assert text.endswith("the controller says that it is running")
    assert "hold" in motion.calls


def test_a_line_of_the_program_before_is_not_taken_for_the_last_one(
    begin, order, motion, journal
):
    motion.stale_looks = 3
    running = begin(order)
    assert running.ended() == "finished"
    assert motion.stale_looks == 0
    assert journal.faults == []


@pytest.mark.fault_row(21)
def test_a_machine_that_moves_once_it_has_finished_is_a_fault(
    begin, order, motion, journal, calm
):
    running = begin(order, settings=replace(calm, lead_s=5.0))
    told = journal.of
    running.until(lambda: any(p.stage == "closing" for p in told(MeasurementProgress)))
    motion.here = motion.here + 2.0
    assert running.ended() == "faulted"
    assert journal.faults == ["runs-on"]
    text = journal.of(FaultReported)[0].text
    assert text.endswith("the controller says that it is finished")


@pytest.mark.fault_row(20)
def test_an_override_of_nothing_is_told_as_such_and_it_goes_on(
    begin, order, motion, journal, calm
):
    running = begin(order, settings=replace(calm, stuck_s=0.1))
    running.until_moving()
    speed, motion.speed, motion.override = motion.speed, 0.0, 0.0
    running.until(lambda: bool(journal.faults))
    motion.speed, motion.override = speed, 1.0
    assert running.ended() == "finished"
    assert journal.faults == ["feed-override"]
    assert "the feed override is 0 %" in journal.of(FaultReported)[0].text


@pytest.mark.fault_row(22)
def test_a_point_that_the_machine_does_not_come_to_is_never_measured(
    begin, order, square, motion, journal, calm
):
    """The controller says that it has finished, and stands elsewhere."""
    points = Configurations(square.axes, square.position[:3], np.full(3, 0.2))
    motion.ends_after_s = 0.1
    settings = replace(calm, confirm_s=0.5)
    running = begin(replace(order, commanded=points), settings=settings)
    assert running.ended() == "faulted"
    assert journal.faults == ["ended-early"]
    assert "not at" in journal.of(FaultReported)[0].text
    measured = [event for event in running.run.events if event.kind == "point"]
    assert len(measured) <= 1


@pytest.mark.fault_row(20)
def test_a_hold_at_the_machine_is_a_pause_that_ends_there(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.stand("operator")
    running.until_state("paused")
    assert "held at the machine: operator" in journal.of(StateChanged)[-1].text
    running.until(lambda: journal.faults == ["held-at-machine"])
    assert "operator" in journal.of(FaultReported)[0].text
    motion.go_on()
    running.finished()
    assert journal.states == ["running", "paused", "running", "finished"]


@pytest.mark.fault_row(20)
def test_a_hold_at_the_machine_may_last_for_hours(
    begin, long_order, tracker, motion, journal, clock
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    motion.stand("operator")
    running.until(lambda: journal.faults == ["held-at-machine"])
    left_s = journal.of(MeasurementProgress)[-1].remaining_s
    for _ in range(4):
        tracker._begun_s += 3600.0  # nobody looks at the samples of hours
        clock.time_s += 3600.0
        told = len(journal.of(MeasurementProgress))
        running.until(lambda told=told: len(journal.of(MeasurementProgress)) > told + 3)
    assert journal.of(MeasurementProgress)[-1].remaining_s == left_s
    assert journal.states == ["running", "paused"]
    motion.go_on()
    running.finished()
    assert journal.faults == ["held-at-machine"]
    assert "resume" not in motion.calls


@pytest.mark.fault_row(20)
def test_a_hold_at_the_machine_may_be_ended_by_resume(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.stand("watchdog")
    running.until_state("paused")
    running.measurement.obey(CellVerb.RESUME)
    running.finished()
    assert "resume" in motion.calls


def test_a_pause_is_kept_against_a_release_at_the_machine(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    holds = motion.calls.count("hold")
    motion.go_on()
    running.until(lambda: motion.calls.count("hold") > holds)
    running.until(lambda: motion.status().state == "held")
    assert journal.states[-1] == "paused"
    running.measurement.obey(CellVerb.RESUME)
    running.finished()


def test_a_hold_that_is_not_obeyed_is_a_fault(begin, long_order, motion, journal):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    motion.ignores_hold = True
    running.measurement.obey(CellVerb.PAUSE)
    running.pass_until(lambda: "hold-unconfirmed" in journal.faults)
    motion.ignores_hold = False
    assert running.ended() == "faulted"


def test_a_resume_that_is_not_obeyed_stays_a_pause(begin, long_order, motion, journal):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    running.measurement.obey(CellVerb.PAUSE)
    running.until_state("paused")
    motion.ignores_resume = True
    running.measurement.obey(CellVerb.RESUME)
    running.pass_until(lambda: journal.faults == ["resume-unconfirmed"])
    running.until(lambda: journal.states[-1] == "paused")
    motion.ignores_resume = False
    running.measurement.obey(CellVerb.RESUME)
    running.finished()


def test_a_controller_out_of_reach_for_a_moment_is_borne(
    begin, long_order, motion, journal
):
    running = begin(long_order)
    running.until_moving()
    motion.out_of_reach = True
    told = len(journal.of(MeasurementProgress))
    running.until(lambda: len(journal.of(MeasurementProgress)) > told + 2)
    motion.out_of_reach = False
    running.finished()
    assert journal.faults == []


@pytest.mark.fault_row(16)
def test_a_controller_out_of_reach_for_long_is_a_fault(
    begin, long_order, motion, journal
):
    running = begin(long_order, settings=JUDGED)
    running.until_moving()
    motion.out_of_reach = True
    running.pass_until(lambda: "no-answer" in journal.faults)
    assert running.ended() == "faulted"
    assert journal.faults == ["control-late", "no-answer"]
    motion.out_of_reach = False


def test_a_verb_that_does_not_reach_the_controller_says_so(begin, long_order, motion):
    running = begin(long_order)
    running.until_moving()
    motion.out_of_reach = True
    with pytest.raises(DeviceTimeout):
        running.measurement.obey(CellVerb.ABORT)
    motion.out_of_reach = False
    assert running.ended() == "aborted"
    assert motion.status().state == "aborted"


@pytest.mark.fault_row(24)
def test_nothing_moves_when_a_row_is_out_of_travel(
    begin, order, motion, journal, square
):
    far = replace(square, position=square.position + np.array([450.0, 0, 0]))
    running = begin(replace(order, commanded=far))
    assert running.ended() == "failed"
    assert motion.calls == []
    assert "X = 560 mm exceeds 500 mm" in journal.of(FaultReported)[0].text
    assert journal.of(RunClosed)[0].run_file == ""


def test_a_machine_without_a_watchdog_is_not_moved(begin, order, motion, journal):
    motion.has_watchdog = False
    running = begin(order)
    assert running.ended() == "failed"
    assert journal.faults == ["no-watchdog"]
    assert motion.calls == []


def test_a_machine_without_a_watchdog_is_moved_if_allowed_and_the_run_says_so(
    begin, order, motion, calm
):
    motion.has_watchdog, motion.stops_unasked = False, True
    running = begin(order, settings=replace(calm, allow_no_watchdog=True))
    running.finished()
    assert "no-watchdog" in [event.kind for event in running.run.events]
    assert "no watchdog" in running.run.provenance["watchdog"]


def test_a_watched_run_says_nothing_of_a_watchdog(begin, order):
    running = begin(order)
    running.finished()
    assert "watchdog" not in running.run.provenance


@pytest.mark.parametrize("held", [False, True])
def test_a_program_of_somebody_else_is_left_alone(begin, order, motion, journal, held):
    """It runs, or somebody holds it at the panel, with the tool in the work."""
    motion.begin_elsewhere()
    if held:
        motion.stand("operator")
    running = begin(order)
    assert running.ended() == "failed"
    assert journal.faults == ["motion-busy"]
    assert motion.calls == []
    motion.abort()


@pytest.mark.parametrize("reason", ["command", "watchdog"])
def test_what_an_earlier_measurement_has_left_held_is_called_off(
    begin, order, motion, reason
):
    motion.begin_elsewhere()
    motion.stand(reason)
    begin(order).finished()
    assert motion.calls[:2] == ["abort", "move_to"]


@pytest.mark.parametrize(
    ("error", "code", "state"),
    [
        (OutOfTravel("X beyond 400 mm"), "out-of-travel", "failed"),
        (Refused("too many rows"), "refused", "failed"),
        (MotionFault("read back differs"), "motion-alarm", "faulted"),
    ],
)
def test_a_path_that_the_controller_does_not_take_ends_the_order(
    begin, order, motion, journal, monkeypatch, error, code, state
):
    def load(_path):
        raise error

    monkeypatch.setattr(motion, "load", load)
    assert begin(order).ended() == state
    assert journal.faults == [code]
    assert "start" not in motion.calls


def test_a_defect_of_ours_is_a_fault_not_a_hang(
    begin, order, motion, journal, monkeypatch, caplog
):
    monkeypatch.setattr(motion, "load", lambda _path: 1 / 0)
    assert begin(order).ended() == "faulted"
    assert journal.faults == ["internal"]
    assert "ZeroDivisionError" in journal.of(FaultReported)[0].text
    assert "defect while measuring" in caplog.text


@pytest.mark.fault_row(27)
def test_a_disk_that_fails_holds_the_machine_first(
    begin, long_order, motion, journal, monkeypatch
):
    running = begin(long_order)
    running.until_moving()
    recorder = running.measurement._recorder

    def full(_item) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder, "_commit", full)
    assert running.ended() == "failed"
    assert motion.status().state == "held"
    assert journal.faults[0] == "storage"
    assert "No space left" in journal.of(FaultReported)[0].text
    assert len(running.run.tracker) > 0


@pytest.mark.fault_row(27)
def test_a_disk_that_is_almost_full_ends_the_run_cleanly(
    begin, long_order, motion, journal, monkeypatch
):
    monkeypatch.setattr("truepath.measurement.run_file.recorder.SPACE_CHECK_S", 0.0)
    running = begin(long_order)
    running.until_moving()
    recorder = running.measurement._recorder
    monkeypatch.setattr(recorder, "_free_bytes", lambda: recorder._reserve_bytes - 1)
    assert running.ended() == "failed"
    assert motion.status().state == "held"
    assert "almost full" in journal.of(FaultReported)[0].text
    assert running.run.provenance["outcome"] == "failed"


@pytest.mark.fault_row(28)
def test_a_slow_disk_holds_the_feed_until_it_has_caught_up(
    begin, long_order, motion, journal, monkeypatch, measured
):
    running = begin(long_order)
    running.until_moving()
    recorder = running.measurement._recorder
    slow, commit = threading.Event(), recorder._commit

    def wait_then_commit(item) -> None:
        host_clock.wait(slow, 20.0)
        commit(item)

    monkeypatch.setattr(recorder._queue, "maxsize", 24)
    monkeypatch.setattr(recorder, "_commit", wait_then_commit)
    running.until(lambda: journal.faults == ["slow-disk"])
    running.until_state("paused")
    slow.set()
    running.finished()
    assert journal.of(RunClosed)[0].lost_samples == 0
    measured(f"{journal.of(RunClosed)[0].samples} samples, none lost")


def test_a_run_file_that_exists_is_never_overwritten(begin, order, journal, tmp_path):
    (tmp_path / "monday.sqlite").write_bytes(b"precious")
    assert begin(order).ended() == "failed"
    assert "exists" in journal.of(FaultReported)[0].text
    assert (tmp_path / "monday.sqlite").read_bytes() == b"precious"


def test_rows_are_put_into_the_axis_order_of_the_controller(square):
    turned = arrange_axes(square, ("Z", "C", "X", "Y"), (1.0, 2.0, 3.0, 4.0))
    np.testing.assert_array_equal(turned.position[:, 0], square.position[:, 2])
    np.testing.assert_array_equal(turned.position[:, 1], np.full(4, 2.0))
    np.testing.assert_array_equal(turned.position[:, 2:], square.position[:, :2])


def test_an_axis_that_the_controller_lacks_is_named(square):
    with pytest.raises(Fault, match="axes X, Y, none is Z"):
        arrange_axes(square, ("X", "Y"), (0.0, 0.0))


@pytest.mark.parametrize(
    ("override", "can_limit", "told", "left"),
    [
        (None, True, [], None),
        (1.0, True, [], 1.0),
        (1.2, True, [], 1.0),
        (1.2, False, ["feed-override"], 1.2),
        (0.5, True, ["feed-override"], 0.5),
    ],
)
def test_an_override_is_lowered_or_told(
    begin, order, motion, journal, override, can_limit, told, left
):
    motion.override, motion.limits_override = override, can_limit
    running = begin(order, settings=JUDGED)
    running.until_moving()
    assert motion.override == left
    running.finished()
    assert journal.faults == told
    if told:
        said = journal.of(FaultReported)[0]
        assert f"{100 * override:.0f} %" in said.text
        assert "100 %" in said.action
    kinds = [event.kind for event in running.run.events]
    assert ("override" in kinds) == (override == 1.2 and can_limit)
