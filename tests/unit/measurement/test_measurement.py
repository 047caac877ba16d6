"""Measurements on devices in this process: procedures, verbs, faults."""

import threading
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from measurement_fixtures import JUDGED, Running, standing_at, there_and_back
from truepath.measurement import faults, messages
from truepath.measurement.engine.measurement_steps import arrange_axes
from truepath_drivers import host_clock
from truepath_drivers.interfaces import errors, tracker_records
from truepath_drivers.interfaces.records import MotionState

pytestmark = pytest.mark.usefixtures("clock")


@pytest.fixture
def short_order(order):
    """Almost two seconds of motion, there and back again."""
    return there_and_back(order, 4)


@pytest.fixture
def long_order(order):
    """A minute of motion: no test is so slow that it misses it."""
    return there_and_back(order, 110)


@pytest.fixture
def moving(begin, long_order):
    """A measurement that moves, with more patience than any test."""
    running = begin(long_order)
    running.until_done()
    return running


@pytest.fixture
def judged(begin, long_order):
    """A measurement that moves, with the patience of the service."""
    running = begin(long_order, settings=JUDGED)
    running.until_done()
    return running


def test_a_path_is_streamed_from_before_the_first_motion_to_after_the_last(
    begin, order, motion, journal, read_link_bytes
):
    motion.compensation = True
    running = begin(order)
    assert running.ended() == "finished"
    run = running.run
    assert motion.calls == ["abort", "move_to", "load", "start"]
    np.testing.assert_array_equal(motion.loaded.position, order.commanded.position)
    assert (run.mode, run.name, run.machine) == ("otf", "monday", order.machine)
    assert run.provenance["outcome"] == "finished"
    assert run.provenance["tracker"] == "Us fake tracker T1 0"
    assert run.provenance["control_compensation"] == "on"
    assert "watchdog" not in run.provenance, "it has one"
    # 3 lines of 100, 50, 105 mm at 100 mm/s and a second at both ends.
    assert np.ptp(run.tracker.device_time_s) > 2.55 + 2 * 0.9
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert len(read_link_bytes(order.run_file)) == len(run.tracker)
    axes = run.axis_samples
    assert axes.axes == ("X", "Y", "Z")
    assert (np.diff(axes.host_time_s) > 0).all()
    assert np.ptp(axes.position_mm[:, 0]) == pytest.approx(110.0, abs=1.0)
    assert running.states == ["running", "finished"]
    kinds = [type(event) for event in journal.events]
    assert kinds[-2:] == [messages.StateChanged, messages.RunClosed]
    closed = running.told(messages.RunClosed)[0]
    assert (closed.run_file, closed.outcome) == (order.run_file, "finished")
    assert (closed.samples, closed.lost_samples) == (len(run.tracker), 0)
    assert len(closed.sha256) == 64


def test_lines_are_counted_shown_and_watched(begin, short_order, journal, motion):
    motion.stale_looks = 3  # at the last line of the program before: not ours
    begin(short_order).ends("finished")
    assert motion.stale_looks == 0
    progress = journal.progress
    assert [p.done for p in progress] == sorted(p.done for p in progress)
    last = progress[-1]
    assert (last.done, last.total, last.unit) == (7, 7, "lines")
    assert (last.stage, last.remaining_s, last.crc_errors) == ("closing", 0.0, 2)
    assert last.samples > 0
    # The fake machine is twenty times faster than the 38 s that were planned.
    assert next(p for p in progress if p.done >= 3).remaining_s < 6.0
    # Live points are a tenth of a second apart.
    live = journal.of(messages.LivePoints)
    points = sum(len(body.tracker_mm) for body in live)
    assert points == pytest.approx(10 * (live[-1].device_time_s - 100.0), abs=3)
    away = np.subtract(live[-1].tracker_mm[0], live[-1].axes)
    assert (away, len(live[-1].axes)) == (pytest.approx([1.0, 2.0, 3.0], abs=1e-3), 3)
    assert motion.beats == motion.looks > 10


def test_points_are_stepped_through_with_a_dwell_at_each(begin, order, square, motion):
    motion.compensation = False
    running = begin(standing_at(order, square.position, 2.0))
    assert (running.ended(), motion.calls) == ("finished", ["abort"] + 4 * ["move_to"])
    run = running.run
    assert (run.mode, run.provenance["control_compensation"]) == ("standstill", "off")
    done = running.texts("point")
    assert [t.split(" until ")[0] for t in done] == [f"row {i}" for i in (1, 2, 3, 4)]
    assert (np.diff([float(text.split()[3]) for text in done]) > 2.3).all()
    last = running.progress[-1]
    assert (last.done, last.total, last.unit) == (4, 4, "points")


@pytest.mark.fault_row(22)
@pytest.mark.parametrize("comes_back", [True, False])
def test_a_point_that_the_machine_leaves_is_measured_anew_or_never(
    begin, order, square, motion, calm, comes_back, measured
):
    """Somebody jogs the machine while it is measured where it stands."""
    points = standing_at(order, square.position[:2], 60.0)
    settings = calm if comes_back else replace(calm, confirm_s=0.5)
    running = begin(points, settings=settings)
    running.until_seen(110.0)
    with motion._lock:
        motion.here = motion.here + 1.0
        left_s = running.told(messages.LivePoints)[-1].device_time_s
    running.until_seen(left_s + 10.0)
    if comes_back:
        with motion._lock:
            motion.here = motion.here - 1.0
        assert running.ended() == "finished"
        done = running.texts("point")
        assert "row 1: moved while it was measured" in done
        until_s = float(next(t for t in done if " until " in t).split()[3])
        assert until_s > left_s + 60.0
        measured(f"measured anew for {until_s - left_s:.0f} s of 60 s asked for")
    else:
        assert (running.ended(), running.faults) == ("faulted", ["ended-early"])


@pytest.mark.fault_row(20)
@pytest.mark.parametrize(
    ("override", "code", "said"),
    [
        (None, "not-moving", ("", "override")),
        (0.0, "feed-override", ("the feed override is 0 %", "")),
    ],
)
def test_a_machine_that_runs_without_moving_is_told_once_and_goes_on(
    begin, order, motion, calm, override, code, said
):
    """The feed override stands at 0 %, whether or not the controller tells."""
    running = begin(order, settings=replace(calm, stuck_s=0.1))
    running.until_done()
    speed, motion.speed, motion.override = motion.speed, 0.0, override
    running.until(lambda: bool(running.faults))
    motion.speed, motion.override = speed, override and 1.0
    running.ends("finished", code)
    assert said[0] in running.fault.text
    assert said[1] in running.fault.action


def test_pause_holds_and_resume_goes_on(moving, motion):
    moving.obey(messages.CellVerb.RESUME)  # without a pause it is nothing
    moving.pause()
    assert "resume" not in motion.calls
    here = motion.status().position
    assert motion.status().position == here
    moving.obey(messages.CellVerb.PAUSE)
    moving.resume_to_the_end()
    states = "running pausing paused resuming running finished"
    assert moving.states == states.split()
    kinds = [e.text.split(":")[0] for e in moving.run.events if e.kind == "state"]
    assert kinds == ["pausing", "paused", "resuming", "running"]


def test_a_pause_in_a_dwell_makes_the_dwell_start_over(begin, order, square, motion):
    running = begin(standing_at(order, square.position[:2], 60.0))
    running.until_seen(110.0)
    running.pause()
    assert motion.calls.count("move_to") == 1
    resumed_s = running.told(messages.LivePoints)[-1].device_time_s
    running.obey(messages.CellVerb.RESUME)
    assert running.ended() == "finished"
    assert float(running.texts("point")[0].split()[3]) > resumed_s + 59.0


@pytest.mark.parametrize("is_paused", [False, True])
def test_abort_stops_the_machine_and_keeps_the_run(moving, motion, is_paused):
    if is_paused:
        moving.pause()
    moving.obey(messages.CellVerb.ABORT)
    assert moving.ended() == "aborted"
    assert (motion.calls[-1], motion.status().state) == ("abort", "aborted")
    assert moving.run.provenance["outcome"] == "aborted"
    assert "control_compensation" not in moving.run.provenance, "it was not told"
    assert len(moving.run.tracker) > 100


def test_halt_holds_the_feed_and_forgets_nothing(moving, motion):
    moving.measurement.halt()
    assert (moving.ended(), motion.status().state) == ("aborted", "held")


@pytest.mark.fault_row(16)
@pytest.mark.fault_row(17)
@pytest.mark.parametrize("controller", ["ignores it", "is gone", "comes back"])
def test_an_abort_that_does_not_arrive_is_told_and_a_fault(moving, motion, controller):
    motion.ignores_abort = controller == "ignores it"
    motion.out_of_reach = not motion.ignores_abort
    with pytest.raises(errors.DeviceTimeout) if motion.out_of_reach else nullcontext():
        moving.obey(messages.CellVerb.ABORT)
    motion.out_of_reach = controller == "is gone"
    if controller == "comes back":
        assert (moving.ended(), motion.status().state) == ("aborted", "aborted")
    else:
        assert (moving.ended(), moving.faults[-1]) == ("faulted", "stop-unconfirmed")


def test_verbs_too_early_or_too_late_do_no_harm(order, tracker, motion, journal, calm):
    running = Running(order, tracker, motion, journal, calm)
    running.obey(messages.CellVerb.PAUSE)
    running.obey(messages.CellVerb.RESUME)
    running.obey(messages.CellVerb.ABORT)
    running.thread.start()
    assert running.ended() == "aborted"
    assert "start" not in motion.calls
    running.obey(messages.CellVerb.PAUSE)
    running.obey(messages.CellVerb.RESUME)
    assert journal.states[-1] == "aborted"


@pytest.mark.parametrize("is_paused", [False, True])
def test_enough_ends_the_path_in_order_after_its_line(moving, motion, is_paused):
    if is_paused:
        moving.pause()
    moving.obey(messages.CellVerb.CONCLUDE)
    if is_paused:
        moving.look()
        assert moving.states[-1] == "paused"
        moving.obey(messages.CellVerb.RESUME)
    assert moving.ended() == "finished"
    assert "enough is known" in moving.told(messages.StateChanged)[-1].text
    assert motion.calls[-1] == "abort"
    run = moving.run
    (text,) = moving.texts("concluded")
    assert "the rest is left out" in text
    last = moving.progress[-1]
    assert last.stage == "closing"
    assert 1 <= last.done < last.total
    assert run.provenance["outcome"] == "finished"


@pytest.mark.parametrize("points", [4, 1])
def test_enough_ends_points_after_their_dwell(begin, order, square, motion, points):
    running = begin(standing_at(order, square.position[:points], 30.0))
    running.until_seen(105.0)
    running.obey(messages.CellVerb.CONCLUDE)
    assert (running.ended(), motion.calls.count("move_to")) == ("finished", 1)
    kinds = [e.kind for e in running.run.events if e.kind in ("point", "concluded")]
    assert kinds == ["point", *["concluded"] * (points > 1)]  # else nothing is left out
    assert float(running.texts("point")[0].split()[3]) > 100.0 + 30.0
    last = running.progress[-1]
    assert (last.done, last.total, last.unit) == (1, points, "points")


@pytest.mark.fault_row(5)
def test_a_short_silence_holds_the_feed_and_goes_on_by_itself(judged, tracker, motion):
    tracker.silent = True
    judged.pass_until(lambda: "paused" in judged.states)
    assert motion.status().state == "held"
    missed = tracker.health.frames
    judged.pass_until(lambda: tracker.health.frames > missed + 200)
    tracker.silent = False
    judged.until_state("running")
    judged.finished_after("tracker-silent")
    run = judged.run
    assert (np.diff(run.tracker.sequence) > 1).sum() == 1
    assert any(e.kind == "gap" for e in run.events)
    assert judged.told(messages.RunClosed)[0].lost_samples > 100


@pytest.mark.fault_row(5)
def test_a_silence_of_a_moment_costs_samples_and_no_hold(judged, tracker, motion):
    tracker.silent = True
    host_clock.sleep_s(0.45)
    tracker.silent = False
    judged.finished_after()
    assert "hold" not in motion.calls
    assert judged.told(messages.RunClosed)[0].lost_samples > 100
    assert any(event.kind == "gap" for event in judged.run.events)


def test_a_hold_is_seen_through_though_the_stream_is_back(judged, tracker, motion):
    motion.ignores_hold = True  # as one that still brakes
    tracker.silent = True
    judged.pass_until(lambda: judged.states[-1] == "pausing")
    tracker.silent = False
    judged.see()
    assert "resume" not in motion.calls
    motion.ignores_hold = False
    judged.until_state("running")
    judged.finished()
    states = "running pausing paused resuming running finished"
    assert (judged.states, judged.faults) == (states.split(), ["tracker-silent"])


@pytest.mark.parametrize("who", ["operator", "watchdog"])
@pytest.mark.parametrize("first", ["machine", "tracker"])
def test_a_silences_end_undoes_no_hold_by_hand(judged, tracker, motion, who, first):
    if first == "machine":
        motion.stand(who)
        judged.until_state("paused")
        tracker.silent = True
        judged.pass_until(lambda: "tracker-silent" in judged.faults)
    else:
        motion.ignores_hold = True  # the machine's own hold comes before ours
        tracker.silent = True
        judged.pass_until(lambda: "tracker-silent" in judged.faults)
        motion.stand(who)
        judged.until_state("paused")
        motion.ignores_hold = False
    tracker.silent = False
    # What it waits for now is said last, for whoever has to do it.
    judged.until(lambda: judged.faults[-1] == "held-at-machine")
    judged.see()
    assert judged.states[-1] == "paused"
    assert who in judged.fault.text
    assert "resume" not in motion.calls
    judged.resume_to_the_end()


def test_a_hold_by_hand_while_a_stop_ends_by_itself_is_kept(judged, tracker, motion):
    tracker.silent = True
    judged.pass_until(lambda: judged.states[-1] == "paused")
    motion.ignores_resume = True
    tracker.silent = False
    judged.until_state("resuming")
    motion.go_on()
    motion.stand("operator")
    judged.until_state("paused")
    motion.ignores_resume = False
    resumes = motion.calls.count("resume")
    judged.see()
    assert (motion.status().state, motion.calls.count("resume")) == ("held", resumes)
    judged.resume_to_the_end()


@pytest.mark.fault_row(30)
def test_time_in_which_the_host_did_not_run_is_no_silence(judged, clock):
    judged.motion.override = 1000.0  # it moved on meanwhile, and is believed
    for _ in range(3):
        clock.time_s += 10.0  # as after a suspension of the process
        judged.look()
    judged.finished_after()
    assert judged.states == ["running", "finished"]


@pytest.mark.fault_row(29)
def test_a_wall_clock_that_jumps_changes_no_duration_nor_order(moving, clock, measured):
    for jump_s in (3600.0, -3600.0, -host_clock.wall_s()):
        clock.wall_jump_s = jump_s
        moving.look(9)
    moving.finished_after()
    elapsed_s = [p.elapsed_s for p in moving.progress if p.stage == "measuring"]
    assert (np.diff(elapsed_s) >= 0.0).all()
    assert elapsed_s[-1] < 60.0
    run = moving.run
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (np.diff(run.axis_samples.host_time_s) > 0.0).all()
    times_ns = [event.mono_ns for event in run.events]
    assert times_ns == sorted(times_ns)
    measured("+1 h, -1 h and back to 1970: no gap, order and durations as without")


def test_a_silence_does_not_undo_a_pause(judged, tracker):
    judged.pause()
    tracker.silent = True
    judged.pass_until(lambda: judged.faults == ["tracker-silent"])
    judged.obey(messages.CellVerb.RESUME)
    judged.until_told("tracker-silent", "not-resumed")
    tracker.silent = False
    judged.see()
    assert judged.states[-1] == "paused"
    judged.resume_to_the_end()


@pytest.mark.fault_row(5)
def test_a_long_silence_is_a_fault_with_the_feed_held(judged, tracker, motion):
    tracker.silent = True
    judged.pass_until(lambda: len(judged.faults) == 2)
    assert (judged.ended(), motion.status().state) == ("faulted", "held")
    assert judged.faults == ["tracker-silent", "tracker-silent"]
    assert "check the tracker and its cable" in judged.fault.action
    assert judged.run.provenance["outcome"] == "faulted"


@pytest.mark.fault_row(1)
def test_damage_holds_and_lines_are_driven_again(begin, short_order, tracker, motion):
    running = begin(short_order)
    running.until_done()
    tracker.damaged = True
    running.until_state("paused")
    assert "hold" in motion.calls
    assert running.faults == ["stream-damaged"]
    tracker.damaged = False
    running.finished()
    commanded = running.run.commanded.position
    rows = len(short_order.commanded)
    assert np.array_equal(commanded[:rows], short_order.commanded.position)
    assert len(commanded) > rows
    assert motion.calls.count("start") == 2
    assert "again" in [event.kind for event in running.run.events]
    assert "bad or lost" in running.run.provenance["stream"]
    assert running.told(messages.LinesDamaged)[0].again is not None
    assert "some twice" in running.told(messages.StateChanged)[-1].text


def test_lasting_damage_is_a_held_fault(begin, long_order, tracker, motion, journal):
    tracker.speed = motion.speed = 1.0  # as the second in which damage is counted
    judged = begin(long_order, settings=JUDGED)
    judged.until_done()
    tracker.damaged = True
    judged.until_state("paused")
    judged.pass_until(lambda: bool(journal.of(messages.RunClosed)))
    assert (judged.ended(), set(journal.faults)) == ("faulted", {"stream-damaged"})
    assert motion.status().state == "held"


def test_damage_before_the_path_costs_no_line(begin, short_order, tracker, motion):
    tracker.damaged = True
    running = begin(short_order)
    running.until_state("paused")
    tracker.damaged = False
    running.finished()
    assert motion.calls.count("start") == 1


@pytest.mark.fault_row(9)
def test_a_lost_beam_holds_until_somebody_resumes(judged, tracker):
    tracker.beam = False
    judged.pass_until(lambda: "paused" in judged.states)
    assert judged.faults == ["beam-lost"]
    judged.obey(messages.CellVerb.RESUME)
    judged.until(lambda: judged.faults[-1] == "not-resumed")
    tracker.beam = True
    judged.see(2)
    assert judged.states[-1] == "paused"
    judged.resume_to_the_end()
    assert (judged.run.tracker.status != 0).any()


@pytest.mark.fault_row(9)
def test_a_dwell_in_which_the_beam_was_lost_begins_anew(begin, order, square, tracker):
    running = begin(standing_at(order, square.position[:2], 20.0), settings=JUDGED)
    running.until_seen(105.0)
    tracker.beam = False
    running.pass_until(lambda: running.states[-1] == "paused")
    assert running.faults == ["beam-lost"]
    tracker.beam = True
    running.see(2)
    running.obey(messages.CellVerb.RESUME)
    assert running.ended() == "finished"
    stream = running.run.tracker
    lost_s = stream.device_time_s[stream.status != 0].max()
    ends = [text.split()[3] for text in running.texts("point")]
    assert float(ends[0]) > lost_s + 20.0
    assert float(ends[1]) > float(ends[0]) + 20.0


@pytest.mark.parametrize(
    ("given", "state", "code"),
    [
        ({"silent": True}, "faulted", "tracker-silent"),
        ({"beam": False}, "failed", "beam-lost"),
        ({"refusal": errors.Refused("500 Hz is too fast")}, "failed", "refused"),
    ],
)
def test_a_tracker_that_gives_nothing_ends_the_order_before_the_path_starts(
    begin, order, tracker, motion, given, state, code
):
    vars(tracker).update(given)
    running = begin(order, settings=JUDGED)
    running.pass_until(lambda: bool(running.told(messages.RunClosed)))
    assert running.ended() == state
    assert code in running.faults
    if code == "refused":
        assert "500 Hz is too fast" in running.fault.text
    assert "start" not in motion.calls


def test_no_path_is_driven_without_stamps(begin, order, tracker, motion, monkeypatch):
    stamps = tracker_records.TrackerCapabilities(clock=tracker_records.Clock.HOST)
    monkeypatch.setattr(type(tracker), "capabilities", stamps)
    begin(order).ends("failed", "no-times")
    assert not {"move_to", "load", "start"} & set(motion.calls)


@pytest.mark.parametrize(
    ("given", "state", "said"),
    [
        ({"error": errors.ConnectionLost("unplugged")}, "faulted", "link-lost"),
        ({"error": OSError("odd")}, "faulted", "internal"),
        ({"restarted": True}, "failed", "counter went back"),
    ],
)
def test_a_tracker_gone_or_reset_ends_it(moving, tracker, motion, given, state, said):
    vars(tracker).update(given)
    assert (moving.ended(), motion.status().state) == (state, "held")
    (fault,) = moving.told(messages.FaultReported)
    assert said in f"{fault.code} {fault.text}"


@pytest.mark.parametrize(
    ("told", "code", "said"),
    [
        ({"_state": MotionState.ESTOP}, "estop", ("stop is active", "release it")),
        ({"_state": MotionState.UNHOMED}, "unhomed", ("not homed", "home it")),
        ({"_state": MotionState.NOT_READY}, "not-ready", ("drives are off", "switch")),
        ({"_state": MotionState.DOOR}, "door", ("door is open", "close it")),
        ({"_state": MotionState.ALARM, "alarm": "1201 axis"}, "alarm", ("1201", "")),
        ({"referenced": False}, "unhomed", ("", "")),
    ],
)
@pytest.mark.fault_row(19)
def test_a_machine_that_cannot_be_driven_is_not_and_says_why(
    begin, long_order, motion, journal, told, code, said
):
    vars(motion).update(told)
    assert (begin(long_order).ended(), motion.calls) == ("failed", [])
    (fault,) = journal.of(messages.FaultReported)
    assert fault.code == f"motion-{code}"
    assert said[0] in fault.text
    assert said[1] in fault.action


@pytest.mark.fault_row(19)
@pytest.mark.parametrize(
    ("state", "said"),
    [
        (MotionState.ESTOP, "emergency stop"),
        (MotionState.DOOR, "door"),
        (MotionState.UNHOMED, "home"),
        (MotionState.ALARM, "1201 following error x"),
    ],
)
def test_what_cannot_go_on_is_a_fault_with_why(moving, motion, state, said, measured):
    if state is MotionState.ALARM:
        motion.raise_alarm("1201 following error X")
    else:
        motion._state = state
    moving.ends("faulted", f"motion-{state}")
    (fault,) = moving.told(messages.FaultReported)
    assert said in f"{fault.text} {fault.action}".lower()
    run = moving.run
    assert len(run.tracker) > 100
    assert run.provenance["outcome"] == "faulted"
    assert (np.diff(run.tracker.sequence) == 1).all()
    measured(f"{state}: {len(run.tracker)} samples kept, none lost")


@pytest.mark.fault_row(21)
def test_a_motion_that_ends_early_is_a_fault(moving, motion):
    motion.ends_after_s = 0.0
    moving.ends("faulted", "ended-early")
    assert "not at 410.000, 310.000, -210.000" in moving.fault.text


@pytest.mark.fault_row(21)
@pytest.mark.parametrize("state", ["running", "finished"])
def test_moving_on_after_the_end_is_a_fault(begin, order, motion, calm, state):
    motion.runs_on = state == "running"
    running = begin(order, settings=replace(calm, lead_s=5.0))
    if state == "finished":
        running.until(lambda: any(p.stage == "closing" for p in running.progress))
        motion.here = motion.here + 2.0
    running.ends("faulted", "runs-on")
    assert running.fault.text.endswith(f"the controller says that it is {state}")
    assert state == "finished" or "hold" in motion.calls


@pytest.mark.fault_row(22)
def test_a_point_not_reached_is_never_measured(begin, order, square, motion, calm):
    """The controller says that it has finished, and stands elsewhere."""
    points = standing_at(order, square.position[:3], 0.2)
    motion.ends_after_s = 0.1
    running = begin(points, settings=replace(calm, confirm_s=0.5))
    running.ends("faulted", "ended-early")
    assert "not at" in running.fault.text
    assert len(running.texts("point")) <= 1


@pytest.mark.fault_row(20)
@pytest.mark.parametrize("ends", ["there", "here"])
def test_a_hold_at_the_machine_is_a_pause_that_ends_there_or_here(moving, motion, ends):
    motion.stand("operator")
    moving.until_state("paused")
    said = moving.told(messages.StateChanged)[-1].text
    assert "held at the machine: operator" in said
    moving.until_told("held-at-machine")
    assert "operator" in moving.fault.text
    if ends == "here":
        moving.resume_to_the_end()
        assert "resume" in motion.calls
    else:
        motion.go_on()
        moving.finished()
        assert moving.states == ["running", "paused", "running", "finished"]


@pytest.mark.fault_row(20)
def test_a_hold_at_the_machine_may_last_for_hours(judged, tracker, motion, clock):
    motion.stand("operator")
    judged.until_told("held-at-machine")
    left_s = judged.progress[-1].remaining_s
    for _ in range(4):
        tracker._begun_s += 3600.0  # nobody looks at the samples of hours
        clock.time_s += 3600.0
        judged.look()
    assert judged.progress[-1].remaining_s == left_s
    assert judged.states == ["running", "paused"]
    motion.go_on()
    judged.finished_after("held-at-machine")
    assert "resume" not in motion.calls


def test_a_pause_is_kept_against_a_release_at_the_machine(moving, motion):
    moving.pause()
    holds = motion.calls.count("hold")
    motion.go_on()
    moving.until(lambda: motion.calls.count("hold") > holds)
    moving.until(lambda: motion.status().state == "held")
    assert moving.states[-1] == "paused"
    moving.resume_to_the_end()


def test_a_hold_that_is_not_obeyed_is_a_fault(judged, motion):
    motion.ignores_hold = True
    judged.obey(messages.CellVerb.PAUSE)
    judged.pass_until(lambda: "hold-unconfirmed" in judged.faults)
    motion.ignores_hold = False
    assert judged.ended() == "faulted"


def test_a_resume_that_is_not_obeyed_stays_a_pause(judged, motion):
    judged.pause()
    motion.ignores_resume = True
    judged.obey(messages.CellVerb.RESUME)
    judged.pass_until(lambda: judged.faults == ["resume-unconfirmed"])
    judged.until_state("paused")
    motion.ignores_resume = False
    judged.resume_to_the_end()


def test_a_controller_out_of_reach_for_a_moment_is_borne(moving, motion):
    motion.out_of_reach = True
    moving.look(2)
    motion.out_of_reach = False
    moving.finished_after()


@pytest.mark.fault_row(16)
def test_a_controller_out_of_reach_for_long_is_a_fault(judged, motion):
    motion.out_of_reach = True
    judged.pass_until(lambda: "no-answer" in judged.faults)
    judged.ends("faulted", "control-late", "no-answer")
    motion.out_of_reach = False


@pytest.mark.fault_row(24)
def test_nothing_moves_when_a_row_is_out_of_travel(begin, order, motion, square):
    far = replace(square, position=square.position + np.array([450.0, 0, 0]))
    running = begin(replace(order, commanded=far))
    assert (running.ended(), motion.calls) == ("failed", [])
    assert "X = 560 mm exceeds 500 mm" in running.fault.text
    assert running.told(messages.RunClosed)[0].run_file == ""


def test_a_missing_watchdog_is_allowed_and_told(begin, order, motion, calm, tmp_path):
    motion.has_watchdog = False
    begin(order).ends("failed", "no-watchdog")
    assert motion.calls == []
    motion.stops_unasked = True
    again = replace(order, run_file=str(tmp_path / "again.sqlite"))
    running = begin(again, settings=replace(calm, allow_no_watchdog=True))
    running.finished()
    assert running.texts("no-watchdog")
    assert "no watchdog" in running.run.provenance["watchdog"]


@pytest.mark.parametrize("held", ["", "operator", "command", "watchdog"])
def test_a_foreign_program_is_left_and_ours_called_off(begin, order, motion, held):
    """Theirs runs, or is held at the panel, with the tool in the work."""
    motion.begin_elsewhere()
    if held:
        motion.stand(held)
    if held in ("command", "watchdog"):
        begin(order).finished()
        assert motion.calls[:2] == ["abort", "move_to"]
    else:
        begin(order).ends("failed", "motion-busy")
        assert motion.calls == []
        motion.abort()


@pytest.mark.parametrize(
    ("error", "code", "state"),
    [
        (errors.OutOfTravel("X beyond 400 mm"), "out-of-travel", "failed"),
        (errors.Refused("too many rows"), "refused", "failed"),
        (errors.MotionFault("read back differs"), "motion-alarm", "faulted"),
        (ZeroDivisionError("of ours"), "internal", "faulted"),  # not a hang
    ],
)
def test_a_path_that_the_controller_does_not_take_ends_the_order(
    begin, order, motion, journal, monkeypatch, caplog, error, code, state
):
    def load(_path):
        raise error

    monkeypatch.setattr(motion, "load", load)
    assert (begin(order).ended(), journal.faults) == (state, [code])
    assert str(error) in journal.of(messages.FaultReported)[0].text
    assert "start" not in motion.calls
    assert ("defect while measuring" in caplog.text) == (code == "internal")


@pytest.mark.fault_row(27)
@pytest.mark.parametrize("said", ["No space left", "almost full"])
def test_a_failing_or_full_disk_holds_and_keeps_all(moving, motion, monkeypatch, said):
    recorder = moving.measurement._recorder

    def fail(_item):
        raise OSError(28, "No space left on device")

    if said == "almost full":
        monkeypatch.setattr("truepath.measurement.run_file.recorder.SPACE_CHECK_S", 0.0)
        free_bytes = recorder._reserve_bytes - 1
        monkeypatch.setattr(recorder, "_free_bytes", lambda: free_bytes)
    else:
        monkeypatch.setattr(recorder, "_commit", fail)
    assert (moving.ended(), motion.status().state) == ("failed", "held")
    assert moving.faults[0] == "storage"
    assert said in moving.told(messages.FaultReported)[0].text
    run = moving.run
    assert len(run.tracker) > 0
    assert said == "No space left" or run.provenance["outcome"] == "failed"


@pytest.mark.fault_row(28)
def test_a_slow_disk_holds_the_feed_until_it_catches_up(moving, monkeypatch, measured):
    recorder = moving.measurement._recorder
    slow, commit = threading.Event(), recorder._commit

    def wait_then_commit(item):
        host_clock.wait(slow, 20.0)
        commit(item)

    monkeypatch.setattr(recorder._queue, "maxsize", 24)
    monkeypatch.setattr(recorder, "_commit", wait_then_commit)
    moving.until_told("slow-disk")
    moving.until_state("paused")
    slow.set()
    moving.finished()
    assert moving.told(messages.RunClosed)[0].lost_samples == 0
    measured(f"{moving.told(messages.RunClosed)[0].samples} samples, none lost")


def test_a_run_file_that_exists_is_never_overwritten(begin, order, journal, tmp_path):
    (tmp_path / "monday.sqlite").write_bytes(b"precious")
    assert begin(order).ended() == "failed"
    assert "exists" in journal.of(messages.FaultReported)[0].text
    assert (tmp_path / "monday.sqlite").read_bytes() == b"precious"


def test_rows_are_put_into_the_axis_order_of_the_control_or_the_axis_is_named(square):
    turned = arrange_axes(square, ("Z", "C", "X", "Y"), (1.0, 2.0, 3.0, 4.0))
    np.testing.assert_array_equal(turned.position[:, 0], square.position[:, 2])
    np.testing.assert_array_equal(turned.position[:, 1], np.full(4, 2.0))
    np.testing.assert_array_equal(turned.position[:, 2:], square.position[:, :2])
    with pytest.raises(faults.Fault, match="axes X, Y, none is Z"):
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
    begin, order, motion, override, can_limit, told, left
):
    motion.override, motion.limits_override = override, can_limit
    running = begin(order, settings=JUDGED)
    running.until_done()
    assert motion.override == left
    running.finished()
    assert running.faults == told
    if told:
        said = running.fault
        assert f"{100 * override:.0f} %" in said.text
        assert "100 %" in said.action
    kinds = [event.kind for event in running.run.events]
    assert ("override" in kinds) == (override == 1.2 and can_limit)
