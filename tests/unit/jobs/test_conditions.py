"""What has to be so before the machine moves, and what a stream tells of it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from job_builders import CONNECTED
from scripted_cell import wait_until
from truepath.answers.machine_history import ToleranceJudgement
from truepath.catalogue.calibrations import CalibrationStatus
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.running.arming import assess_approach, assess_path, list_commanded
from truepath.machines import cell_status, conditions
from truepath.machines.cell_status import CellStatus, ControllerLevels, StreamLevels
from truepath.machines.conditions import ConditionLog, ConditionType, Level
from truepath.measurement import messages
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers.interfaces.records import UNABLE, MotionState, MotionStatus

NOW_S = 1000.0


@pytest.fixture(autouse=True)
def now(hand_clock):
    hand_clock.time_s = NOW_S


def shown(state=MotionState.IDLE, override=1.0, alarm="", read_s=NOW_S, **told):
    told = {"referenced": True, "compensation": False} | told
    told = {"alarm": alarm, "override": override} | told
    return ControllerLevels(MotionStatus(state, (0.0, 0.0, 0.0), 0, **told), "", read_s)


STREAM = StreamLevels(True, 0, 0, 0.2, "X_degC")
GOOD = conditions.Observed(CONNECTED, shown(), False, 10**9, 10**8, stream=STREAM)


def levels(seen, wants=None):
    found = conditions.find_conditions(seen, NOW_S, wants_compensation=wants)
    return {kind: one.level for kind, one in found.items()}


def only_false(seen):
    (kind,) = [k for k, level in levels(seen).items() if level is Level.FALSE]
    return kind, conditions.find_conditions(seen, NOW_S)[kind]


def test_a_machine_in_order_fulfils_every_condition():
    assert set(levels(GOOD).values()) == {Level.TRUE}
    measuring = CellStatus("running", devices=CONNECTED.devices)
    seen = replace(GOOD, controller=shown(read_s=NOW_S - 100.0), cell=measuring)
    assert levels(seen)[SILENT] is Level.TRUE, "who measures reads it"


def find(board, kind):
    (found,) = [one for one in board.read() if one.type is kind]
    return found


@pytest.mark.parametrize("state", UNABLE)
def test_a_machine_that_cannot_be_driven_says_why_and_what_to_do(state):
    kind, found = only_false(replace(GOOD, controller=shown(state, alarm="F 12")))
    assert kind is ConditionType.CONTROLLER_ABLE
    assert found.reason == state
    assert "F 12" in found.message
    assert found.message.endswith(UNABLE[state].remedy)


def state(*told, **more):
    return {"controller": shown(*told, **more)}


PROGRAM = ConditionType.CONTROLLER_FREE, "end or reset it at the panel"
OVERRIDE = ConditionType.FEED_OVERRIDE_FULL
REFERENCE = ConditionType.AXES_REFERENCED, "reference (home) them"
SILENT = ConditionType.CONTROLLER_ANSWERS
MUTE = ControllerLevels(None, "10.0.0.9 is mute", NOW_S)


@pytest.mark.parametrize(
    ("change", "condition", "said"),
    [
        (state(MotionState.RUNNING), *PROGRAM),
        (state(MotionState.HELD, hold_reason="operator"), *PROGRAM),
        (state(override=0.0), OVERRIDE, "0 %"),
        (state(override=0.7), OVERRIDE, "70 %"),
        (state(override=1.2), OVERRIDE, "120 %"),
        (state(MotionState.IDLE, referenced=False), *REFERENCE),
        (state(MotionState.READY, referenced=False), *REFERENCE),
        ({"controller": MUTE}, SILENT, "10.0.0.9"),
        (state(read_s=NOW_S - conditions.LATE_S - 1.0), SILENT, "11 s ago"),
        (
            {"cell": CellStatus("disconnected", "the port is gone")},
            ConditionType.DEVICES_CONNECTED,
            "the port is gone",
        ),
    ],
)
def test_what_is_not_in_order_stands_in_the_way_and_is_said(change, condition, said):
    seen = replace(GOOD, **change)
    kind, found = only_false(seen)
    assert kind is condition
    assert kind in conditions.REQUIRED
    assert said in found.message
    if kind is SILENT:
        assert levels(seen)[ConditionType.CONTROLLER_ABLE] is Level.UNKNOWN


@pytest.mark.parametrize("hold_reason", ["", "command", "watchdog"])
def test_what_an_earlier_measurement_has_left_held_stands_in_no_way(hold_reason):
    held = shown(MotionState.HELD, hold_reason=hold_reason)
    assert not ConditionLog(lambda: replace(GOOD, controller=held)).list_obstacles()


@pytest.mark.parametrize(
    ("told", "kind"),
    [
        ("override", OVERRIDE),
        ("referenced", ConditionType.AXES_REFERENCED),
        ("compensation", ConditionType.COMPENSATION_AS_ASKED),
    ],
)
def test_what_the_control_does_not_say_is_unknown_and_no_obstacle(told, kind):
    seen = replace(GOOD, controller=shown(**{told: None}))
    assert levels(seen)[kind] is Level.UNKNOWN
    assert not ConditionLog(lambda: seen).list_obstacles()


@pytest.mark.parametrize(
    ("told", "wants", "level", "reason"),
    [
        (True, None, Level.TRUE, "compensation-on"),
        (False, None, Level.TRUE, "compensation-off"),
        (True, True, Level.TRUE, "compensation-on"),
        (False, True, Level.FALSE, "compensation-not-on"),
        (True, False, Level.FALSE, "compensation-not-off"),
        (None, True, Level.UNKNOWN, "not-told-on"),
    ],
)
def test_compensation_hinders_only_who_asks_for_another(told, wants, level, reason):
    seen = replace(GOOD, controller=shown(compensation=told))
    board = ConditionLog(lambda: seen, wants_compensation=wants)
    found = find(board, ConditionType.COMPENSATION_AS_ASKED)
    assert (found.level, found.reason) == (level, reason)
    assert found.is_obstacle == (level is Level.FALSE)


def test_a_level_has_its_time_although_nobody_asks():
    seen = [GOOD]
    board = ConditionLog(lambda: seen[0], look_s=0.01)
    looks = board._since
    board.start()
    try:
        able = ConditionType.CONTROLLER_ABLE
        wait_until(lambda: able in looks, "a first look")
        seen[0] = replace(GOOD, controller=shown(MotionState.DOOR))
        wait_until(lambda: looks[able][0] is Level.FALSE, "the change")
        noted = looks[able][1]
    finally:
        board.close()
    assert find(board, able).since == noted


def test_a_controller_without_a_watchdog_needs_leave():
    bare = replace(CONNECTED, devices={"motion": {"has_watchdog": False}})
    kind, _ = only_false(replace(GOOD, cell=bare))
    assert kind is ConditionType.WATCHDOG_THERE
    only_false(replace(GOOD, cell=bare, allow_no_watchdog=True))
    devices = {"motion": {"has_watchdog": False, "stops_unasked": True}}
    bare = replace(bare, devices=devices)
    seen = replace(GOOD, cell=bare, allow_no_watchdog=True)
    assert levels(seen)[ConditionType.WATCHDOG_THERE] is Level.TRUE


@pytest.mark.fault_row(27)
@pytest.mark.fault_row(29)
def test_a_full_disk_stands_in_the_way_and_a_clock_that_was_set_is_told():
    kind, found = only_false(replace(GOOD, free_bytes=10**7))
    assert kind is ConditionType.DISK_HAS_ROOM
    assert "10 MB" in found.message
    kind, found = only_false(replace(GOOD, clock_step_s=-3600.0))
    assert kind is ConditionType.CLOCK_STEADY
    assert kind not in conditions.REQUIRED
    assert "-3600 s" in found.message


@pytest.mark.parametrize(
    ("change", "condition", "said"),
    [
        ({"has_beam": False}, ConditionType.TARGET_IN_SIGHT, "lock the beam"),
        ({"lost_samples": 3}, ConditionType.STREAM_HEALTHY, "3 samples were lost"),
        ({"crc_errors": 2}, ConditionType.STREAM_HEALTHY, "2 frames"),
        ({"usable_share": 0.8}, ConditionType.STREAM_HEALTHY, "80 % of the samples"),
        ({"rate_share": 0.5}, ConditionType.STREAM_HEALTHY, "50 % of the samples"),
        ({"failure": "it is mute"}, ConditionType.STREAM_HEALTHY, "it is mute"),
    ],
)
def test_what_the_stream_tells_stands_in_the_way_at_rest_only(change, condition, said):
    seen = replace(GOOD, stream=replace(STREAM, **change))
    kind, found = only_false(seen)
    assert kind is condition
    assert said in found.message
    assert seen.requires(kind)
    assert not replace(seen, cell=replace(CONNECTED, state="paused")).requires(kind)
    assert levels(replace(GOOD, stream=StreamLevels()))[condition] is Level.UNKNOWN


def test_a_drift_is_shown_and_stands_in_the_way_only_beyond_a_stated_limit():
    shown_now = (cell_status.Temperature("X_degC", 22.0, 0.2, 300.0),)
    stream = replace(STREAM, drift_degC=1.4, temperatures=shown_now)
    drifts = replace(GOOD, stream=stream)
    kind, found = only_false(drifts)
    assert kind is ConditionType.TEMPERATURE_STEADY
    assert "X has changed by 1.4 °C in 10 min" in found.message
    for limit_degc, obstacles in ((None, []), (1.2, [kind]), (1.5, [])):
        seen = replace(drifts, drift_limit_degC=limit_degc)
        read = ConditionLog(lambda seen=seen: seen).read()
        assert [one.type for one in read if one.is_obstacle] == obstacles
    assert {one.temperatures for one in read if one.type is kind} == {shown_now}
    assert {one.temperatures for one in read if one.type is not kind} == {()}


VICE = {"name": "vice", "min_mm": [100, 0, 0], "max_mm": [200, 50, 50]}
AVOIDS_VICE = workspace_from_json({"schema": "workspace/1", "keep_out": [VICE]})


def points_at(machine, *places):
    rows = [{"x_mm": x, "y_mm": y, "z_mm": 10} for x, y in places]
    return command_rows(machine, rows, is_path=False)


def test_a_path_out_of_travel_or_through_a_box_even_between_parts_is_told(machine):
    board = ConditionLog(lambda: GOOD)
    assert not board.list_obstacles()
    places = [{"x_mm": x, "y_mm": 10, "z_mm": 10} for x in (10, 400)]
    rows = command_rows(machine, places, is_path=True)
    wrong = replace(rows, position=rows.position + 1000.0)
    for parts, workspace, reason in (
        ([rows, wrong], workspace_from_json({}), "out-of-travel"),
        ([rows], AVOIDS_VICE, "keep-out"),
    ):
        board.path = assess_path(machine, parts, workspace)
        (obstacle,) = board.list_obstacles()
        assert obstacle.type is ConditionType.PATH_WITHIN_TRAVEL
        assert obstacle.reason == reason
    board.path = assess_path(machine, [rows], workspace_from_json({}))
    assert not board.list_obstacles()
    left = points_at(machine, (10, 10), (50, 10))
    right = points_at(machine, (300, 10), (400, 10))
    behind = points_at(machine, (50, 300), (300, 300))
    for parts in ([left], [right], [behind], [left, behind, right]):
        assert assess_path(machine, parts, AVOIDS_VICE).level is Level.TRUE
    found = assess_path(machine, [left, right], AVOIDS_VICE)
    assert (found.level, found.reason) == (Level.FALSE, "keep-out")
    assert "the way on to part 2 enters the keep-out box vice" in found.message


def test_a_station_that_goes_on_is_come_to_round_what_its_plan_avoids(machine):
    """Its first row is on this side of the vice, the row where it goes on beyond."""
    points = encode_commanded_json(points_at(machine, (10, 10), (50, 10)))
    rows = points_at(machine, (50, 300), (300, 300), (300, 10), (400, 10))
    station = encode_commanded_json(rows)
    for first_row, level in ((0, Level.TRUE), (2, Level.FALSE)):
        left = {**station, "resumption": {"first_row": first_row}}
        parts = list_commanded({"known_points": points, "stations": [left]})
        assert assess_path(machine, parts, AVOIDS_VICE).level is level


@pytest.mark.parametrize(
    ("here", "reason"),
    [
        ((50.0, 10.0, 10.0), ""),
        ((300.0, 300.0, 10.0), ""),
        ((300.0, 10.0, 10.0), "approach-blocked"),
        ((150.0, 10.0, 10.0), "approach-blocked"),  # within it
        (None, "place-not-told"),
    ],
)
def test_the_way_to_the_first_row_is_judged_from_where_it_begins(machine, here, reason):
    """By the names of the controller's axes, in whatever order it has them."""
    axes = machine.axis_names
    place = None if here is None else MotionStatus(MotionState.IDLE, here[::-1], 0)
    seen = replace(GOOD, controller=ControllerLevels(place, "", NOW_S, axes[::-1]))
    parts = [points_at(machine, (10, 10), (50, 10))]
    board = ConditionLog(lambda: seen)
    board.path = assess_path(machine, parts, AVOIDS_VICE)
    board.assess_approach = partial(assess_approach, machine, parts, AVOIDS_VICE)
    found = find(board, ConditionType.PATH_WITHIN_TRAVEL)
    assert (found.reason, found.is_obstacle) == (reason, bool(reason))
    without = assess_approach(machine, parts, workspace_from_json({}), {})
    assert without.level is Level.TRUE


def test_a_change_is_told_once_with_when_it_came_not_when_somebody_asked(monkeypatch):
    times = iter(f"2026-01-01T00:00:{n:02d}.000Z" for n in range(60))
    clock = "truepath.machines.conditions.format_utc_now"
    monkeypatch.setattr(clock, lambda: next(times))
    changes = []
    door = replace(GOOD, controller=shown(MotionState.DOOR))
    seen = iter([GOOD, GOOD, door, door])
    board = ConditionLog(lambda: next(seen), on_change=changes.append)
    able = [find(board, ConditionType.CONTROLLER_ABLE) for _ in range(4)]
    assert able[0].since == able[1].since
    assert able[2].since == able[3].since > able[1].since
    assert [one.is_obstacle for one in able] == [False, False, True, True]
    (told,) = changes
    assert (told.type, told.level) == (ConditionType.CONTROLLER_ABLE, Level.FALSE)


def test_what_the_calibrations_say_is_shown_and_stands_in_no_way():
    tolerance = ToleranceJudgement("over", 12.0, 0.5, 10.0)
    said = "EXX has changed."
    status = CalibrationStatus("mill", "job-2", tolerance, "job-1", True, said)
    found = conditions.find_conditions(replace(GOOD, calibration_status=status), NOW_S)
    over = found[ConditionType.WITHIN_TOLERANCE]
    changed = found[ConditionType.UNCHANGED]
    assert (over.level, over.reason) == (Level.FALSE, "tolerance-over")
    assert "12.0 ± 1.0 µm" in over.message
    assert (changed.level, changed.message) == (Level.FALSE, "EXX has changed.")
    watched = {ConditionType.WITHIN_TOLERANCE, ConditionType.UNCHANGED}
    assert not watched & conditions.REQUIRED
    text = "changes are not watched: job job-1 is no calibration"
    status = CalibrationStatus("mill", "job-2", None, "job-1", None, text, True)
    found = conditions.find_conditions(replace(GOOD, calibration_status=status), NOW_S)
    unusable = found[ConditionType.UNCHANGED]
    assert (unusable.level, unusable.message) == (Level.UNKNOWN, text)


@pytest.fixture
def watch(hand_clock):
    watch = cell_status.StreamStatus()
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    return watch


def progress(lost=0, damaged=0):
    return messages.MeasurementProgress(
        1, 4, "lines", "measuring", 1.0, 3.0, lost_samples=lost, crc_errors=damaged
    )


def seen(**readings):
    return messages.LivePoints([[1.0, 2.0, 3.0]], [0.0], 1.0, readings)


def test_a_lost_beam_is_told_until_the_machine_moves_and_points_come(watch, hand_clock):
    watch.follow(seen())
    assert watch.read().has_beam is True
    watch.follow(messages.FaultReported("beam-lost", "the beam is lost", "lock it"))
    watch.follow(messages.StateChanged(messages.CellState.PAUSED))
    assert watch.read().has_beam is False
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    watch.follow(seen())
    assert watch.read().has_beam is True
    hand_clock.time_s += 60.0
    assert watch.read().has_beam is None


@pytest.mark.fault_row(31)
def test_losses_of_the_last_seconds_of_one_measurement_are_counted(watch, hand_clock):
    for second, lost in enumerate((0, 0, 7, 7, 7, 7, 7, 7, 7, 7)):
        hand_clock.time_s = 200.0 + second
        watch.follow(progress(lost, damaged=lost // 7))
        if second == 3:
            assert (watch.read().lost_samples, watch.read().crc_errors) == (7, 1)
    assert (watch.read().lost_samples, watch.read().crc_errors) == (0, 0)
    hand_clock.time_s += 60.0
    assert watch.read().lost_samples is None
    watch.follow(progress(50))
    hand_clock.time_s += 1.0
    watch.follow(progress(0))  # of another measurement
    assert watch.read().lost_samples == 0


def test_the_thermometer_that_changes_most_is_named(watch, hand_clock):
    for step in range(20):
        hand_clock.time_s = 300.0 + 5.0 * step
        watch.follow(seen(X_degC=20.0 + 0.1 * step, Y_degC=21.0, air_hPa=990.0 + step))
        known = watch.read()
        assert (known.drift_degC is None) == (step < 12)
    assert (known.drift_degC, known.drifting) == (pytest.approx(1.9), "X_degC")
    hand_clock.time_s += cell_status.COURSE_S + 1.0
    assert watch.read().drift_degC is None


def heard(samples=100, usable=100, lost=0, rate_hz=500.0, **told):
    return messages.TrackerTried(samples, usable, lost, 1000.0, rate_hz, **told)


@pytest.mark.parametrize(
    ("tried", "aims", "level"),
    [
        (heard(), False, {"has_beam": True, "rate_share": 1.0}),
        (heard(rate_hz=None), False, {"has_beam": True, "rate_share": None}),
        (heard(rate_hz=250.0), False, {"has_beam": True, "rate_share": 0.5}),
        (heard(usable=80), False, {"has_beam": True, "usable_share": 0.8}),
        (heard(usable=0), False, {"has_beam": False}),
        (heard(usable=0), True, {"has_beam": None}),
        (heard(samples=0), False, {"failure": "the tracker sends no samples"}),
        (heard(lost=1), False, {"lost_samples": 0}),
        (heard(lost=9), False, {"lost_samples": 9}),
        (heard(samples=0, streams=False), False, {"has_beam": None, "failure": ""}),
    ],
)
def test_a_moment_at_rest_tells_beam_and_samples(hand_clock, tried, aims, level):
    watch = cell_status.StreamStatus()
    watch.record_trial(tried, 500.0, aims=aims)
    assert {name: getattr(watch.read(), name) for name in level} == level


def test_what_was_heard_is_believed_for_a_while_and_until_something_moves(hand_clock):
    watch = cell_status.StreamStatus()
    assert watch.read() == cell_status.StreamLevels()
    watch.record_failure("it is mute")
    assert watch.read().failure == "it is mute"
    hand_clock.time_s += cell_status.AT_REST_S + 1.0
    assert watch.read() == cell_status.StreamLevels()
    watch.record_trial(heard(), 500.0, aims=False)
    assert watch.read().has_beam is True
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    assert watch.read() == cell_status.StreamLevels()


def test_thermometers_at_rest_tell_temperature_and_change(hand_clock):
    watch = cell_status.StreamStatus()
    for n in range(10):
        readings = {"X_degC": 20.0 + 0.1 * n, "air_degC": np.nan}
        watch.follow(messages.TemperaturesRead(readings))
        hand_clock.time_s += 10.0
    (shown,) = watch.read().temperatures
    assert (shown.channel, shown.over_s) == ("X_degC", 90.0)
    assert (shown.value_degC, shown.change_degC) == pytest.approx((20.9, 0.9))
    assert watch.read().drift_degC == pytest.approx(0.9)
