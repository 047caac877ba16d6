import itertools

import numpy as np
import pytest

from truepath_drivers.cnc.modbus import registers as regmap
from truepath_drivers.cnc.modbus.map_records import (
    decode,
    decode_text,
    encode,
    path_crc,
    path_words,
)
from truepath_drivers.cnc.modbus.registers import BY_NAME, Command, HoldReason, Result
from truepath_drivers.interfaces.records import MotionState, Path
from truepath_simulators.cnc.cnc_controller import MAX_FEED_MM_MIN, Controller
from truepath_simulators.cnc.cnc_registers import Clocks, CncRegisters
from truepath_simulators.cnc.modbus import ILLEGAL_VALUE, ModbusError
from truepath_simulators.motion.profile import Limits


class Master:
    """A CNC without a wire, and someone who reads and writes its registers."""

    def __init__(self, machine):
        self.now_s, self.number = 0.0, 0
        self.published = []
        self.controller = Controller(machine, Limits(), self._publish, 0.02)
        clocks = Clocks(lambda: self.now_s, lambda: self.now_s)
        self.registers = CncRegisters(self.controller, clocks, "SIM-1")

    def _publish(self, timeline):
        self.published.append((self.now_s, timeline))

    def value(self, name, k=0):
        register = BY_NAME[name]
        words = self.registers.read(register.address, register.words)
        block = regmap.Block(register.address, register.words)
        return decode(name, words, block)[k]

    def write(self, name, value):
        self.registers.write(BY_NAME[name].address, encode(name, value))

    @property
    def state(self):
        return regmap.STATES[self.value("state")]

    @property
    def hold_reason(self):
        return HoldReason(self.value("hold_reason"))

    @property
    def position(self):
        return np.array([self.value("position", k) for k in range(3)]) / 1e4

    def command(self, verb, first_row=0, row_count=0, crc=0, rows=None):
        self.number += 1
        if verb is Command.START:
            row_count, crc = self.value("path_rows"), self.value("path_crc")
        if verb in (Command.MOVE_TO, Command.PUT_ROWS) and rows is None:
            rows = np.zeros(regmap.ROWS_A_BLOCK * regmap.ROW_WORDS, np.uint16)
        words = [self.number, int(verb), first_row, row_count, crc >> 16, crc & 0xFFFF]
        if rows is not None:
            words += rows.ravel().tolist()
        self.registers.write(BY_NAME["command_sequence"].address, words)
        assert self.value("command_ack") == self.number
        return Result(self.value("command_result"))

    def load(self, position, feed=6000.0):
        words = row_words(position, feed)
        for first in range(0, len(words), regmap.ROWS_A_BLOCK):
            block = words[first : first + regmap.ROWS_A_BLOCK]
            result = self.command(Command.PUT_ROWS, first, len(block), rows=block)
            if result is not Result.DONE:
                return result
        return self.command(Command.COMMIT, row_count=len(words), crc=path_crc(words))

    def move_to(self, position, feed=6000.0):
        return self.command(Command.MOVE_TO, rows=row_words([position], feed))

    def wait(self, duration_s, *, beating=True):
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            self.now_s += 0.05
            if beating:
                self.write("heartbeat", (self.value("heartbeat") + 1) & 0xFFFF)
            self.controller.update(self.now_s)
            self.registers.watch()

    def wait_still(self):
        while self.state is MotionState.RUNNING:
            self.wait(0.1)
            assert self.now_s < 1000.0
        return self.state


def row_words(position, feed=6000.0):
    each = np.full(len(position), feed), np.full(len(position), 0.2)
    return path_words(Path(("X", "Y", "Z"), np.array(position), *each))


LINE = [[100.0, 100.0, 100.0], [400.0, 100.0, 100.0]]


@pytest.fixture
def master(machine):
    return Master(machine)


@pytest.fixture
def moving(master):
    assert master.load(LINE) is Result.DONE
    assert master.command(Command.START) is Result.DONE
    master.wait(3.0)
    assert (master.state, master.value("line")) == (MotionState.RUNNING, 1)
    feed = master.value("feed") / regmap.FEED_COUNTS
    assert feed == pytest.approx(6000.0, abs=0.01)
    return master


def test_a_path_is_driven_again_and_a_long_one_goes_over_in_blocks(master, rng):
    assert master.load(LINE) is Result.DONE
    assert (master.state, master.value("path_rows")) == (MotionState.READY, 2)
    assert master.value("path_crc") == path_crc(row_words(LINE))
    assert master.command(Command.START) is Result.DONE
    assert master.state is MotionState.RUNNING
    assert master.wait_still() is MotionState.FINISHED
    np.testing.assert_allclose(master.position, LINE[-1])
    assert master.value("line") == 1
    assert master.command(Command.START) is Result.DONE
    master.wait_still()
    corners = rng.uniform(0.0, 300.0, (4096, 3)).round(4).tolist()
    assert master.load(corners) is Result.DONE
    assert master.value("path_rows") == 4096
    assert master.command(Command.START) is Result.DONE
    assert master.published[-1][1].end_s > 4096


@pytest.mark.parametrize(
    ("verb", "ended"),
    [(Command.RESUME, MotionState.FINISHED), (Command.ABORT, MotionState.ABORTED)],
)
def test_an_order_while_braking_for_a_hold_is_not_lost(moving, verb, ended):
    moving.command(Command.HOLD)
    assert moving.command(verb) is Result.DONE
    moving.wait(0.5)
    assert moving.hold_reason is HoldReason.NONE
    assert moving.wait_still() is ended


def test_the_patience_of_the_watchdog_can_be_written_within_reason(moving):
    for asked_ms in (0, 99, 10_001):
        moving.write("watchdog", asked_ms)
        assert moving.value("watchdog") == 1000
    moving.write("watchdog", 300)
    moving.wait(0.6, beating=False)
    assert moving.hold_reason is HoldReason.WATCHDOG


@pytest.mark.parametrize(
    ("position", "feed", "result"),
    [
        ([500.1, 0.0, 0.0], 1000.0, Result.OUT_OF_TRAVEL),
        ([0.0, -0.1, 0.0], 1000.0, Result.OUT_OF_TRAVEL),
        ([0.0, 0.0, 0.0], 0.0, Result.BAD_ARGUMENT),
        ([0.0, 0.0, 0.0], MAX_FEED_MM_MIN + 1.0, Result.BAD_ARGUMENT),
    ],
)
def test_what_the_machine_cannot_do_is_refused(master, position, feed, result):
    assert master.move_to(position, feed) is result
    assert master.load([position], feed) is result
    assert master.state is MotionState.IDLE


def test_a_move_to_the_ends_of_the_travel_keeps_the_committed_path(master):
    master.load(LINE)
    assert master.move_to([500.0, 400.0, 300.0]) is Result.DONE
    assert master.wait_still() is MotionState.FINISHED
    np.testing.assert_allclose(master.position, [500.0, 400.0, 300.0])
    assert (master.value("path_rows"), master.value("line")) == (2, 0)
    assert master.command(Command.START) is Result.DONE


def test_orders_that_mean_nothing_or_were_heard_already_do_nothing(master):
    for verb in (Command.HOLD, Command.RESUME):  # nothing runs
        assert master.command(verb) is Result.DONE
        assert master.state is MotionState.IDLE
    assert master.command(99) is Result.UNKNOWN_COMMAND
    master.registers.write(BY_NAME["command_sequence"].address, [0, Command.ABORT])
    assert master.state is MotionState.IDLE
    assert master.move_to([100.0, 0.0, 0.0]) is Result.DONE
    published = len(master.published)
    master.number -= 1
    master.move_to([100.0, 0.0, 0.0])
    assert len(master.published) == published


def test_a_path_that_is_not_what_was_meant_is_refused(master):
    rows = row_words(LINE)
    master.command(Command.PUT_ROWS, 0, 2, rows=rows)
    wrong = path_crc(rows) ^ 1
    assert master.command(Command.COMMIT, row_count=2, crc=wrong) is Result.CRC_MISMATCH
    assert master.command(Command.COMMIT, row_count=0) is Result.BAD_ARGUMENT
    for first, count in ((0, 0), (0, 8), (4090, 7)):  # beyond the map
        assert master.command(Command.PUT_ROWS, first, count) is Result.BAD_ARGUMENT
    assert master.state is MotionState.IDLE
    master.load(LINE)
    master.command(Command.PUT_ROWS, 0, 1, rows=row_words(LINE)[:1])
    assert master.state is MotionState.IDLE
    assert master.command(Command.START) is Result.NO_PATH


def test_an_alarm_stops_is_told_and_stays(moving):
    moving.controller.alarm(1001, "Servo alarm", moving.now_s)
    assert moving.wait_still() is MotionState.ALARM
    assert moving.value("alarm_code") == 1001
    words = moving.registers.read(BY_NAME["alarm_text"].address, 32)
    assert decode_text("alarm_text", words, regmap.ALARM_TEXT) == "Servo alarm"
    assert moving.move_to([0.0, 0.0, 0.0]) is Result.IN_ALARM
    assert moving.command(Command.ABORT) is Result.DONE
    assert moving.state is MotionState.ALARM
    moving.registers.staying_cause = MotionState.ALARM
    assert moving.command(Command.RESET) is Result.NOT_READY
    moving.registers.staying_cause = None
    assert moving.command(Command.RESET) is Result.DONE
    assert (moving.state, moving.value("path_rows")) == (MotionState.IDLE, 0)


@pytest.mark.parametrize("begin", ["moving", "held", "at 0 %"])
def test_an_override_changes_the_feed_and_at_none_it_runs_and_stands(moving, begin):
    if begin == "at 0 %":
        moving.command(Command.ABORT)
        moving.wait_still()
        moving.controller.override(0.0, moving.now_s)
        moving.move_to(LINE[-1])
    else:
        for share in (0.5, 0.0):
            moving.controller.override(share, moving.now_s)
            moving.wait(1.0)
            feed = moving.value("feed") / regmap.FEED_COUNTS
            assert feed == pytest.approx(share * 6000.0, abs=0.01)
    if begin == "held":
        moving.command(Command.HOLD)
        assert moving.wait_still() is MotionState.HELD
        moving.command(Command.RESUME)
    here = moving.position
    moving.wait(60.0)
    assert moving.state is MotionState.RUNNING
    np.testing.assert_array_equal(moving.position, here)
    assert moving.value("feed") == 0
    moving.controller.override(1.0, moving.now_s)
    assert moving.wait_still() is MotionState.FINISHED
    np.testing.assert_allclose(moving.position, LINE[-1])


def test_no_other_motion_is_taken_and_no_change_reaches_into_what_was_seen(moving):
    """Whoever took the timeline before a change has seen nothing that was not so."""
    for verb in (Command.MOVE_TO, Command.PUT_ROWS, Command.COMMIT, Command.START):
        assert moving.command(verb) is Result.WRONG_STATE
    moving.command(Command.HOLD)
    moving.wait(0.5)
    moving.command(Command.RESUME)
    moving.wait_still()
    for (_, before), (at_s, after) in itertools.pairwise(moving.published):
        t = np.linspace(after.start_s[0], at_s, 200)
        np.testing.assert_allclose(before.positions(t), after.positions(t), atol=1e-9)


def test_registers_that_are_not_there_and_verbs_without_arguments_are_refused(master):
    for address, count in ((78, 1), (70, 10), (318, 1), (900, 1)):
        with pytest.raises(ModbusError, match="2"):
            master.registers.read(address, count)
    for name in ("magic", "state", "position", "path_crc"):
        with pytest.raises(ModbusError, match="2"):
            master.registers.write(BY_NAME[name].address, [1])
    address = BY_NAME["command_sequence"].address
    short = {Command.MOVE_TO: 21, Command.PUT_ROWS: 21, Command.COMMIT: 5}
    short |= {Command.START: 5, Command.RESUME: 1, Command.HOLD: 1}
    for verb, words in short.items():
        request = [master.number + 1, int(verb), 0, 1, *[0] * 40][:words]
        master.write("command", int(verb))
        with pytest.raises(ModbusError):
            master.registers.write(address, request)
        assert master.value("command_ack") == master.number


def test_a_number_alone_never_replays_a_verb_with_edited_arguments(master):
    assert master.move_to([20.0, 0.0, 0.0]) is Result.DONE
    assert master.wait_still() is MotionState.FINISHED
    here = master.value("position")
    rows = BY_NAME["rows"].address
    master.registers.write(rows + 1, [0])  # another goal in the arguments
    with pytest.raises(ModbusError) as refused:
        master.write("command_sequence", master.number + 1)
    assert (refused.value.code, master.state) == (ILLEGAL_VALUE, MotionState.FINISHED)
    assert master.value("position") == here
    assert master.value("command_ack") == master.number


def test_readiness_tells_reference_and_compensation(master):
    assert master.value("readiness") == regmap.IS_REFERENCED
    master.controller.is_compensating = True
    both = regmap.IS_REFERENCED | regmap.IS_COMPENSATING
    assert master.value("readiness") == both
    for lose in (
        lambda: master.controller.disable(MotionState.UNHOMED, master.now_s),
        lambda: setattr(master.controller, "is_referenced", False),
    ):
        lose()
        assert master.value("readiness") == regmap.IS_COMPENSATING
        assert master.command(Command.HOME) is Result.DONE
        assert (master.value("readiness"), master.state) == (both, MotionState.IDLE)
