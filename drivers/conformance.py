"""What every driver keeps, as checks that any author can run against a device.

A check takes a factory that makes a fresh driver, not connected, for a device that
answers; it returns nothing, or raises NotConforming, which says what was not kept. With
pytest:

    @pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
    def test_my_tracker_conforms(check):
        check(lambda: MyTracker(port="/dev/ttyUSB0"))

The checks of motion controllers MOVE THE AXES, by `REACH` mm or deg at `FEED_MM_MIN`
from where they stand towards the middle of the travel: clear the machine first.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from drivers.interfaces.device import Device
from drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    DeviceTimeout,
    OutOfTravel,
    Refused,
)
from drivers.interfaces.motion import MotionController
from drivers.interfaces.records import Identity, MotionState, Path, TrackerSamples
from drivers.interfaces.tracker import Tracker

REACH = 2.0
FEED_MM_MIN = 600.0
RATE_HZ = 500.0
# Beyond a timeout that was asked for: the scheduler of a busy computer.
PATIENCE_S = 1.0
MOTION_TIMEOUT_S = 30.0

MakeDevice = Callable[[], Device]
MakeTracker = Callable[[], Tracker]
MakeController = Callable[[], MotionController]


class NotConforming(AssertionError):
    """A driver does not keep what `drivers.interfaces` promises."""


def construction_opens_nothing(make: MakeDevice) -> None:
    """A driver that is only constructed holds no file, no socket and no thread."""
    before = _holdings()
    device = make()
    _require(_holdings() <= before, "the constructor opened something")
    device.close()


def connect_tells_who_answers(make: MakeDevice) -> None:
    """`connect` returns an Identity with a model and a serial number."""
    with make() as device:
        identity = device.connect()
    _require(isinstance(identity, Identity), f"connect returned {identity!r}")
    _require(bool(identity.model), "the identity has no model")
    _require(bool(identity.serial_number), "the identity has no serial number")


def connect_twice_is_one_connection(make: MakeDevice) -> None:
    """A second `connect` returns the same identity and opens nothing."""
    with make() as device:
        before = _holdings()
        _require(device.connect() == device.connect(), "the identity changed")
        _require(_holdings() <= before, "a second connect opened something")


def close_is_idempotent_and_leaves_nothing(make: MakeDevice) -> None:
    """`close` may come before `connect`, twice, and gives everything back."""
    before = _holdings()
    device = make()
    device.close()
    device.connect()
    device.close()
    device.close()
    _wait_until(lambda: _holdings() <= before, "close left a file or a thread behind")


def a_closed_device_connects_again(make: MakeDevice) -> None:
    """`close` is not the end of a driver."""
    device = make()
    identities = []
    for _ in range(2):
        identities.append(device.connect())
        device.close()
    _require(identities[0] == identities[1], "the identity changed")


def a_device_that_is_not_there_is_a_device_error(make_absent: MakeDevice) -> None:
    """`connect` to nothing ends soon, in a DeviceError with a text.

    make_absent : makes a driver for a port where nothing answers
    """
    device = make_absent()
    with _soon("connect to an absent device", 3.0):
        try:
            device.connect()
        except DeviceError as error:
            _require(bool(str(error)), "the error has no text")
        else:
            raise NotConforming("connect found a device that is not there")
    device.close()


def stop_is_idempotent_in_any_state(make: MakeTracker) -> None:
    """`stop` before `connect`, twice, without a stream, in a stream, after `close`."""
    tracker = make()
    tracker.stop()
    with tracker:
        tracker.stop()
        tracker.start(RATE_HZ)
        tracker.stop()
        tracker.stop()
    tracker.stop()


def stop_from_another_thread_ends_the_stream(make: MakeTracker) -> None:
    """`stop` needs no agreement with the thread that reads."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        _read(tracker, 10)
        with _thread(tracker.stop):
            tracker.read(0.2)
        tracker.read(0.2)
        _require(len(tracker.read(0.2)) == 0, "samples come after stop")


def silence_is_an_empty_block_in_time(make: MakeTracker) -> None:
    """`read` without a stream returns an empty block within its timeout."""
    with make() as tracker:
        for timeout_s in (0.0, 0.05, 0.3):
            with _soon(f"read({timeout_s})", timeout_s):
                block = tracker.read(timeout_s)
            _require(len(block) == 0, "samples came without a start")
            _require_shapes(block)


def samples_have_rising_numbers_and_times(make: MakeTracker) -> None:
    """A stream has whole blocks, rising numbers and times, losses that are counted."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        samples = _read(tracker, 100)
        health = tracker.health
    _require_shapes(samples)
    _require(bool((np.diff(samples.sequence) > 0).all()), "numbers do not rise")
    _require(bool((np.diff(samples.device_time_s) > 0).all()), "times do not rise")
    finite = np.isfinite(samples.position_mm).all()
    _require(bool(finite), "a position is not finite")
    gaps = int(samples.sequence[-1] - samples.sequence[0]) + 1 - len(samples)
    _require(health.lost_samples >= gaps, "a gap in the numbers is not in the health")


def start_twice_is_one_stream(make: MakeTracker) -> None:
    """`start` at the rate that runs changes nothing."""
    with make() as tracker:
        tracker.start(RATE_HZ)
        before = _read(tracker, 20)
        tracker.start(RATE_HZ)
        after = _read(tracker, 20)
        tracker.stop()
    rising = after.sequence[0] > before.sequence[-1]
    _require(bool(rising), "a second start began the numbers anew")


def numbers_go_on_after_a_pause(make: MakeTracker) -> None:
    """Numbers of one connection rise over `stop` and `start`; that is no loss."""
    with make() as tracker:
        blocks: list[TrackerSamples] = []
        for _ in range(2):
            tracker.start(RATE_HZ)
            blocks.append(_read(tracker, 20))
            tracker.stop()
            blocks.append(tracker.read(0.05))
        sequence = TrackerSamples.joined(blocks).sequence
        lost = tracker.health.lost_samples
    _require(bool((np.diff(sequence) > 0).all()), "numbers do not rise over a pause")
    gaps = int(sequence[-1] - sequence[0]) + 1 - len(sequence)
    _require(lost == gaps, f"{lost} samples are counted lost, {gaps} are missing")


def impossible_rates_are_refused(make: MakeTracker) -> None:
    """`start` at a rate of nothing or of a gigahertz is Refused."""
    with make() as tracker:
        for rate_hz in (0.0, -1.0, 1e9):
            _expect(Refused, lambda rate_hz=rate_hz: tracker.start(rate_hz))


def a_closed_tracker_has_no_samples(make: MakeTracker) -> None:
    """`start` and `read` are ConnectionLost before `connect` and after `close`."""
    tracker = make()
    for _ in range(2):
        _expect(ConnectionLost, lambda: tracker.start(RATE_HZ))
        _expect(ConnectionLost, lambda: tracker.read(0.1))
        tracker.connect()
        tracker.close()


def axes_and_travel_are_known(make: MakeController) -> None:
    """After `connect` each axis has a name of its own and a travel with an extent."""
    with make() as controller:
        axes, travel = controller.axes, controller.travel
        position = controller.axis_positions()
    _require(bool(axes), "the controller has no axes")
    _require(len(set(axes)) == len(axes), f"names of axes are not unique: {axes}")
    _require(len(travel) == len(axes), "travels and axes differ in number")
    _require(len(position) == len(axes), "positions and axes differ in number")
    _require(all(low < high for low, high in travel), f"a travel is empty: {travel}")


def out_of_travel_is_refused(make: MakeController) -> None:
    """`move_to` and `load` beyond the travel, or to no number, are OutOfTravel."""
    with make() as controller:
        before = controller.status()
        for position in _outside(controller):
            path = _path(controller, [list(before.position), position])
            _expect(OutOfTravel, lambda p=position: controller.move_to(p, FEED_MM_MIN))
            _expect(OutOfTravel, lambda p=path: controller.load(p))
        after = controller.status()
    same = (before.state, before.position) == (after.state, after.position)
    _require(same, f"a refused position changed {before} into {after}")


def a_path_of_other_axes_is_refused(make: MakeController) -> None:
    """`load` of a path whose axes are not the machine's is Refused."""
    with make() as controller:
        here = list(controller.axis_positions())
        strange = tuple(f"{axis}9" for axis in controller.axes)
        path = Path(strange, np.array([here]), np.array([FEED_MM_MIN]), np.zeros(1))
        _expect(Refused, lambda: controller.load(path))


def hold_and_abort_are_idempotent_in_any_state(make: MakeController) -> None:
    """`hold` and `abort` before `connect`, twice, standing, after `close`."""
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
        status = controller.wait(MOTION_TIMEOUT_S)
    _require(status.state is MotionState.FINISHED, f"the move ended in {status}")
    off = np.abs(np.subtract(status.position, there)).max()
    _require(bool(off <= 1e-3), f"the move ended at {status.position}, not {there}")


def a_path_runs_to_its_last_row(make: MakeController) -> None:
    """`load`, `start`, `wait` end FINISHED in the last row."""
    with make() as controller:
        here = list(controller.axis_positions())
        path = _path(controller, [here, _near(controller), here])
        controller.load(path)
        state = controller.status().state
        _require(state is MotionState.READY, f"a loaded path is {state}, not ready")
        controller.start()
        status = controller.wait(MOTION_TIMEOUT_S)
    _require(status.state is MotionState.FINISHED, f"the path ended in {status}")
    off = np.abs(np.subtract(status.position, here)).max()
    _require(bool(off <= 1e-3), f"the path ended at {status.position}, not {here}")


def hold_and_resume_are_absolute(make: MakeController) -> None:
    """`hold` twice holds, `resume` twice goes on: neither is a toggle."""
    with make() as controller:
        controller.move_to(_near(controller), _slow())
        controller.hold()
        controller.hold()
        status = controller.wait(MOTION_TIMEOUT_S)
        _require(status.state is MotionState.HELD, f"hold ended in {status}")
        _require(bool(status.hold_reason), "a hold has no reason")
        controller.resume()
        controller.resume()
        status = controller.wait(MOTION_TIMEOUT_S)
    _require(status.state is MotionState.FINISHED, f"resume ended in {status}")


def resume_of_nothing_does_nothing(make: MakeController) -> None:
    """`resume` where nothing is held moves nothing."""
    with make() as controller:
        before = controller.status()
        controller.resume()
        after = controller.status()
    _require(before.position == after.position, "resume moved a machine that stood")


def abort_from_another_thread_ends_the_motion(make: MakeController) -> None:
    """`abort` during `wait` ends both; the path is forgotten."""
    with make() as controller:
        here = list(controller.axis_positions())
        path = _path(controller, [here, _near(controller)], _slow())
        controller.load(path)
        controller.start()
        with _thread(controller.abort):
            status = controller.wait(MOTION_TIMEOUT_S)
        _require(status.state is MotionState.ABORTED, f"abort ended in {status}")
        _expect(Refused, controller.start)


def wait_ends_in_time(make: MakeController) -> None:
    """`wait` for a motion that goes on is DeviceTimeout, within its time."""
    with make() as controller:
        controller.move_to(_near(controller), _slow())
        with _soon("wait(0.1)", 0.1):
            _expect(DeviceTimeout, lambda: controller.wait(0.1))
        controller.abort()
        controller.wait(MOTION_TIMEOUT_S)


def close_stops_the_motion(make: MakeController) -> None:
    """`close` during a motion leaves a machine that comes to a stand."""
    controller = make()
    controller.connect()
    controller.move_to(_near(controller), _slow())
    controller.close()
    with controller:
        status = controller.wait(MOTION_TIMEOUT_S)
    ended = status.state in (MotionState.ABORTED, MotionState.HELD)
    _require(ended, f"close in motion ended in {status}")


def a_closed_controller_moves_nothing(make: MakeController) -> None:
    """Motion is ConnectionLost before `connect` and after `close`."""
    controller = make()
    for _ in range(2):
        _expect(ConnectionLost, controller.start)
        _expect(ConnectionLost, controller.status)
        _expect(ConnectionLost, lambda: controller.move_to([0.0], FEED_MM_MIN))
        controller.connect()
        controller.close()


DEVICE_CHECKS: tuple[Callable[[MakeDevice], None], ...] = (
    construction_opens_nothing,
    connect_tells_who_answers,
    connect_twice_is_one_connection,
    close_is_idempotent_and_leaves_nothing,
    a_closed_device_connects_again,
)
TRACKER_CHECKS: tuple[Callable[[MakeTracker], None], ...] = (
    *DEVICE_CHECKS,
    stop_is_idempotent_in_any_state,
    stop_from_another_thread_ends_the_stream,
    silence_is_an_empty_block_in_time,
    samples_have_rising_numbers_and_times,
    start_twice_is_one_stream,
    numbers_go_on_after_a_pause,
    impossible_rates_are_refused,
    a_closed_tracker_has_no_samples,
)
MOTION_CHECKS: tuple[Callable[[MakeController], None], ...] = (
    *DEVICE_CHECKS,
    axes_and_travel_are_known,
    out_of_travel_is_refused,
    a_path_of_other_axes_is_refused,
    hold_and_abort_are_idempotent_in_any_state,
    a_move_ends_where_it_was_sent,
    a_path_runs_to_its_last_row,
    hold_and_resume_are_absolute,
    resume_of_nothing_does_nothing,
    abort_from_another_thread_ends_the_motion,
    wait_ends_in_time,
    close_stops_the_motion,
    a_closed_controller_moves_nothing,
)


def _require(kept: bool, otherwise: str) -> None:
    if not kept:
        raise NotConforming(otherwise)


def _expect(family: type[DeviceError], verb: Callable[[], object]) -> None:
    try:
        verb()
    except family:
        return
    except DeviceError as error:
        raise NotConforming(f"{error!r} came in place of {family.__name__}") from error
    raise NotConforming(f"{family.__name__} did not come")


@contextmanager
def _soon(doing: str, limit_s: float) -> Iterator[None]:
    begin_s = time.monotonic()
    yield
    took_s = time.monotonic() - begin_s
    _require(took_s <= limit_s + PATIENCE_S, f"{doing} took {took_s:.2f} s")


@contextmanager
def _thread(verb: Callable[[], None]) -> Iterator[None]:
    thread = threading.Thread(target=verb)
    thread.start()
    yield
    thread.join()


def _wait_until(condition: Callable[[], bool], otherwise: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        _require(time.monotonic() < deadline_s, otherwise)
        time.sleep(0.01)


def _holdings() -> set[str]:
    """Return the threads and open files of this process, by name and number."""
    holdings = {f"thread {thread.ident}" for thread in threading.enumerate()}
    if os.path.isdir("/proc/self/fd"):
        holdings |= {f"file {number}" for number in _open_files()}
    return holdings


def _open_files() -> list[str]:
    """Return the numbers of open files, without that of the listing itself."""
    return [n for n in os.listdir("/proc/self/fd") if os.path.exists(f"/dev/fd/{n}")]


def _read(tracker: Tracker, count: int) -> TrackerSamples:
    deadline_s = time.monotonic() + count / RATE_HZ + 5 * PATIENCE_S
    blocks: list[TrackerSamples] = []
    while sum(map(len, blocks)) < count:
        _require(time.monotonic() < deadline_s, f"{count} samples did not come")
        blocks.append(tracker.read(0.2))
    return TrackerSamples.joined(blocks)


def _require_shapes(block: TrackerSamples) -> None:
    n = len(block)
    shapes = [a.shape for a in (block.sequence, block.device_time_s, block.status)]
    _require(shapes == [(n,)] * 3, f"columns of unequal length: {shapes}")
    _require(block.position_mm.shape == (n, 3), "positions are not (n, 3)")
    types = [block.sequence.dtype, block.status.dtype]
    _require(types == [np.int64, np.int64], f"numbers and status are {types}")


def _near(controller: MotionController) -> list[float]:
    """Return a position `REACH` away, towards the middle of each travel."""
    near: list[float] = []
    here = controller.axis_positions()
    for at, (low, high) in zip(here, controller.travel, strict=True):
        step = min(REACH, (high - low) / 4)
        near.append(at + step if at < (low + high) / 2 else at - step)
    return near


def _slow() -> float:
    """Return a feed at which the way to `_near` takes some seconds."""
    return 10 * REACH


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
