"""Requirements on every motion controller: travel, moves, paths, hold and abort."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np

from truepath_drivers import host_clock
from truepath_drivers.conformance.checking import (
    DEVICE_CHECKS,
    TERMS,
    NotConforming,
    expect,
    require,
    running,
    soon,
)
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    MotionFault,
    OutOfTravel,
    Refused,
)
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import MotionState, MotionStatus, Path

REACH = 2.0
FEED_MM_MIN = 600.0
_SLOW_FEED, _ENDLESS_FEED = 10 * REACH, REACH  # some seconds, or a minute, to `_near`
STAND = 1e-3  # tolerated motion of an axis at rest, mm or deg

_UNASKED_SHARE = 0.6  # of the silence, in which it may still drive
_BLOCKED_S = 3.0  # the service waits no longer

MakeController = Callable[[], MotionController]
Provoke = Callable[[], None]


def axes_and_travel_are_known(make: MakeController) -> None:
    """After `connect` each axis has a unique name and a travel with an extent."""
    with make() as controller:
        axes, travel = controller.axes, controller.travel
        position = controller.status().position
    require(bool(axes), "the controller has no axes")
    require(len(set(axes)) == len(axes), f"names of axes are not unique: {axes}")
    require(len(travel) == len(axes), "travels and axes differ in number")
    require(len(position) == len(axes), "positions and axes differ in number")
    require(all(low < high for low, high in travel), f"a travel is empty: {travel}")


def out_of_travel_is_refused(make: MakeController) -> None:
    """`move_to` and `load` beyond the travel, or to no number, are OutOfTravel."""
    with make() as controller:
        before = controller.status()
        for position in _outside(controller):
            path = _path(controller, [list(before.position), position])
            move, load = f"move_to {position}", f"load of a path to {position}"
            expect(
                OutOfTravel, lambda p=position: controller.move_to(p, FEED_MM_MIN), move
            )
            expect(OutOfTravel, lambda p=path: controller.load(p), load)
        after = controller.status()
    _require_state("after refused positions", after, before.state)
    same = before.position == after.position
    moved = f"expected {before.position}, found {after.position}"
    require(same, f"position after refused positions: {moved}")


def a_path_of_other_axes_is_refused(make: MakeController) -> None:
    """`load` of a path whose axes are not the machine's is Refused."""
    with make() as controller:
        here = list(controller.status().position)
        strange = tuple(f"{axis}9" for axis in controller.axes)
        path = Path(strange, np.array([here]), np.array([FEED_MM_MIN]), np.zeros(1))
        expect(Refused, lambda: controller.load(path), f"load of axes {strange}")


def hold_and_abort_are_idempotent_in_any_state(make: MakeController) -> None:
    """`hold` and `abort` before `connect`, twice, at rest, after `close`."""
    controller = make()
    for verb in (controller.hold, controller.abort):
        verb()
        with controller:
            verb()
            verb()
        verb()


def a_move_ends_where_it_was_sent(make: MakeController) -> None:
    """`move_to` and `wait` end at the position, to 1 µm."""
    with make() as controller:
        there = _near(controller)
        controller.move_to(there, FEED_MM_MIN)
        status = _wait(controller, "after move_to", MotionState.FINISHED)
    _require_place("after move_to", status, there)


def a_path_runs_to_its_last_row(make: MakeController) -> None:
    """`load`, `start`, `wait` end FINISHED in the last row."""
    with make() as controller:
        here = list(controller.status().position)
        path = _path(controller, [here, _near(controller), here])
        controller.load(path)
        _require_state("after load", controller.status(), MotionState.READY)
        controller.start()
        status = _wait(controller, "after start", MotionState.FINISHED)
    _require_place("after a path", status, here)


def hold_and_resume_are_absolute(make: MakeController) -> None:
    """`hold` twice holds, `resume` twice resumes: neither is a toggle."""
    with make() as controller:
        controller.move_to(_near(controller), _SLOW_FEED)
        controller.hold()
        controller.hold()
        status = _wait(controller, "after hold twice", MotionState.HELD)
        reason = "hold_reason after hold: expected 'command', found an empty one"
        require(bool(status.hold_reason), reason)
        controller.resume()
        controller.resume()
        _wait(controller, "after resume twice", MotionState.FINISHED)


def hold_means_standstill(make: MakeController) -> None:
    """Once a status says HELD, the axes are at rest: none is still braking."""
    with make() as controller:
        controller.move_to(_near(controller), FEED_MM_MIN / 2)
        controller.hold()
        held = _wait(controller, "after hold", MotionState.HELD)
        host_clock.sleep_s(0.3)
        later = controller.status()
        controller.abort()
    moved = np.abs(np.subtract(later.position, held.position)).max()
    require(bool(moved <= STAND), f"HELD, it went on by {moved:.4f}")


def the_line_is_the_row_moved_towards(make: MakeController) -> None:
    """`line` is the row that the axes move to; at the end it is the last."""
    with make() as controller:
        here = np.array(controller.status().position)
        step = np.array(_near(controller)) - here
        rows = [list(here + share * step) for share in (0.0, 0.5, 1.0)]
        controller.load(_path(controller, rows, _SLOW_FEED))
        controller.start()
        status = controller.status()
        while status.state is MotionState.RUNNING:
            share = float((np.array(status.position) - here) @ step / (step @ step))
            off = abs(share - 0.5 * status.line + 0.25)
            told = f"at {share:.2f} of the path it says line {status.line} of 2"
            require(status.line == 0 or off <= 0.3, told)
            controller.send_heartbeat()
            host_clock.sleep_s(0.05)
            status = controller.status()
    _require_state("after a path", status, MotionState.FINISHED)
    last = f"line after a path of 3 rows: expected 2, found {status.line}"
    require(status.line == 2, last)


def resume_of_nothing_does_nothing(make: MakeController) -> None:
    """`resume` without a hold moves nothing, and starts no path either."""
    with make() as controller:
        before = controller.status()
        controller.resume()
        after = controller.status()
        here = list(controller.status().position)
        controller.load(_path(controller, [here, _near(controller)], _SLOW_FEED))
        controller.resume()
        loaded = controller.status()
        controller.abort()
    require(before.position == after.position, "resume moved a machine that stood")
    _require_state("after load and resume", loaded, MotionState.READY)


def abort_from_another_thread_ends_the_motion(make: MakeController) -> None:
    """`abort` during `wait` ends both; the path is discarded."""
    with make() as controller:
        here = list(controller.status().position)
        path = _path(controller, [here, _near(controller)], _SLOW_FEED)
        controller.load(path)
        controller.start()
        with running(controller.abort):
            _wait(controller, "after abort", MotionState.ABORTED)
        expect(Refused, controller.start, "start after abort")


def wait_ends_in_time(make: MakeController) -> None:
    """`wait` for a motion that continues is DeviceTimeout, within its time."""
    with make() as controller:
        controller.move_to(_near(controller), _SLOW_FEED)
        with soon("wait(0.1)", 0.1):
            expect(DeviceTimeout, lambda: controller.wait(0.1), "wait(0.1) in motion")
        controller.abort()
        controller.wait(TERMS.get().motion_s)


def a_claimed_watchdog_holds_the_feed(make: MakeController) -> None:
    """A claimed watchdog holds within `watchdog_s` of the last beat, with a reason."""
    with make() as controller:
        if not controller.connect().has_watchdog:
            return
        controller.move_to(_near(controller), _ENDLESS_FEED)
        status = controller.status()
        begin_s = host_clock.now_s()
        while status.state is MotionState.RUNNING:
            waited_s = host_clock.now_s() - begin_s
            require(
                waited_s < TERMS.get().watchdog_s,
                f"no beat for {waited_s:.1f} s, no hold",
            )
            host_clock.sleep_s(0.05)
            status = controller.status()
        controller.abort()
    _require_state("without a beat", status, MotionState.HELD)
    reason = "hold_reason without a beat: expected 'watchdog', found an empty one"
    require(bool(status.hold_reason), reason)


def a_motion_that_nobody_asks_for_ends(make: MakeController) -> None:
    """A motion fed piece by piece stops soon without requests or beats."""
    with make() as controller:
        if not controller.connect().stops_unasked:
            return
        feed, unasked_s = _SLOW_FEED, TERMS.get().watchdog_s
        controller.move_to(_near(controller), feed)
        before = controller.status().position
        host_clock.sleep_s(unasked_s)
        after = controller.status().position
        controller.abort()
    gone = float(np.linalg.norm(np.subtract(after, before)))
    most = feed / 60.0 * _UNASKED_SHARE * unasked_s
    require(
        gone <= most, f"nobody asked for {unasked_s:g} s, and it went {gone:.3f} on"
    )


def an_alarm_ends_the_motion(make: MakeController, provoke: Provoke) -> None:
    """An alarm is reported with its text, and prevents motion until it is cleared."""
    _require_hindrance(make, provoke, MotionState.ALARM)


def an_open_door_ends_the_motion(make: MakeController, provoke: Provoke) -> None:
    """An open door is reported, and prevents motion."""
    _require_hindrance(make, provoke, MotionState.DOOR)


def an_unhomed_machine_does_not_move(make: MakeController, provoke: Provoke) -> None:
    """A machine that has lost its reference reports it, and does not move."""
    _require_hindrance(make, provoke, MotionState.UNHOMED)


def a_lost_reply_moves_nothing_twice(make: MakeController, provoke: Provoke) -> None:
    """A path whose reply is lost runs once, or not at all and with an error."""
    with make() as controller:
        here = list(controller.status().position)
        controller.load(_path(controller, [here, _near(controller), here]))
        provoke()
        lines: list[int] = []
        try:
            controller.start()
            status = controller.status()
            while status.state is MotionState.RUNNING:
                lines.append(status.line)
                controller.send_heartbeat()
                host_clock.sleep_s(0.05)
                status = controller.status()
        except DeviceError:
            return
        host_clock.sleep_s(1.0)
        later = controller.status()
    require(lines == sorted(lines), f"the rows were driven as {lines}")
    same = (status.state, status.position) == (later.state, later.position)
    require(
        same,
        f"a second after the end: expected {status.state} at {status.position}, "
        f"found {later.state} at {later.position}",
    )


def a_blocked_device_is_told_in_time(make: MakeController, provoke: Provoke) -> None:
    """A device that stops answering is a DeviceError, soon, from every verb."""
    with make() as controller:
        provoke()
        with soon("status of a blocked device", _BLOCKED_S):
            expect(DeviceError, controller.status, "status of a blocked device")
        for stop in (controller.hold, controller.abort):
            doing = f"{stop.__name__} of a blocked device"
            with soon(doing, _BLOCKED_S), suppress(DeviceError):
                stop()


def close_stops_the_motion(make: MakeController) -> None:
    """`close` during a motion stops the machine."""
    controller = make()
    controller.connect()
    controller.move_to(_near(controller), _SLOW_FEED)
    controller.close()
    with controller:
        ends = MotionState.ABORTED, MotionState.HELD
        _wait(controller, "after close in motion and connect", *ends)


def a_closed_controller_moves_nothing(make: MakeController) -> None:
    """Motion is ConnectionLost before `connect` and after `close`."""
    controller = make()
    for when in ("before connect", "after close"):
        expect(ConnectionLost, controller.start, f"start {when}")
        expect(ConnectionLost, controller.status, f"status {when}")
        expect(
            ConnectionLost,
            lambda: controller.move_to([0.0], FEED_MM_MIN),
            f"move_to {when}",
        )
        controller.connect()
        controller.close()


MOTION_CHECKS: tuple[Callable[[MakeController], None], ...] = (
    *DEVICE_CHECKS,
    axes_and_travel_are_known,
    out_of_travel_is_refused,
    a_path_of_other_axes_is_refused,
    hold_and_abort_are_idempotent_in_any_state,
    a_move_ends_where_it_was_sent,
    a_path_runs_to_its_last_row,
    hold_and_resume_are_absolute,
    hold_means_standstill,
    the_line_is_the_row_moved_towards,
    resume_of_nothing_does_nothing,
    abort_from_another_thread_ends_the_motion,
    wait_ends_in_time,
    a_claimed_watchdog_holds_the_feed,
    a_motion_that_nobody_asks_for_ends,
    close_stops_the_motion,
    a_closed_controller_moves_nothing,
)


PROVOKED_CHECKS: tuple[Callable[[MakeController, Provoke], None], ...] = (
    an_alarm_ends_the_motion,
    an_open_door_ends_the_motion,
    an_unhomed_machine_does_not_move,
    a_lost_reply_moves_nothing_twice,
    a_blocked_device_is_told_in_time,
)
"""Each also takes a function that causes its fault, at the machine or on the link."""


def _require_hindrance(
    make: MakeController, provoke: Provoke, state: MotionState
) -> None:
    with make() as controller:
        there = _near(controller)
        controller.move_to(there, _SLOW_FEED)
        provoke()
        provoked = f"after the provoked {state}"
        expect(
            MotionFault,
            lambda: controller.wait(TERMS.get().motion_s),
            f"wait {provoked}",
        )
        told = controller.status()
        _require_state(provoked, told, state)
        require(bool(told.alarm), f"alarm {provoked}: expected a text, found none")
        expect(
            MotionFault,
            lambda: controller.move_to(there, FEED_MM_MIN),
            f"move_to {provoked}",
        )
        host_clock.sleep_s(0.5)
        later = controller.status()
    moved = np.abs(np.subtract(later.position, told.position)).max()
    _require_state(f"0.5 s {provoked}", later, state)
    require(bool(moved <= REACH / 4), f"in {state} it went on by {moved:.3f}")


def _wait(
    controller: MotionController, when: str, *states: MotionState
) -> MotionStatus:
    try:
        status = controller.wait(TERMS.get().motion_s)
    except DeviceError as error:
        wanted = " or ".join(states)
        told = f"state {when}: expected {wanted}, but wait raised {error!r}"
        raise NotConforming(told) from error
    _require_state(when, status, *states)
    return status


def _require_state(when: str, status: MotionStatus, *states: MotionState) -> None:
    alarm = f" ({status.alarm})" if status.alarm else ""
    told = f"expected {' or '.join(states)}, found {status.state}{alarm}"
    require(status.state in states, f"state {when}: {told}")


def _require_place(when: str, status: MotionStatus, there: list[float]) -> None:
    off = np.abs(np.subtract(status.position, there)).max()
    told = f"expected {there}, found {list(status.position)}"
    require(bool(off <= 1e-3), f"position {when}: {told}")


def _near(controller: MotionController) -> list[float]:
    """`REACH` away, towards the middle of each travel."""
    near: list[float] = []
    here = controller.status().position
    for at, (low, high) in zip(here, controller.travel, strict=True):
        step = min(REACH, (high - low) / 4)
        near.append(at + step if at < (low + high) / 2 else at - step)
    return near


def _outside(controller: MotionController) -> Iterator[list[float]]:
    for axis, (low, high) in enumerate(controller.travel):
        for beyond in (low - 0.01, high + 0.01, float("nan")):
            position = [(a + b) / 2 for a, b in controller.travel]
            position[axis] = beyond
            yield position


def _path(
    controller: MotionController, rows: list[list[float]], feed: float = FEED_MM_MIN
) -> Path:
    n = len(rows)
    return Path(controller.axes, np.array(rows), np.full(n, feed), np.zeros(n))
