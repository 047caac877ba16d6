"""The Modbus controller's driver against a CNC whose bytes are written by hand."""

import struct
import threading
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from paths_by_hand import path_of, two_turns
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.records import Identity, MotionState, Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.cnc import modbus
from wires import Peer, PtyWire, TcpWire

IDLE, READY, RUNNING, HELD, FINISHED, ABORTED, ALARM = range(7)
MOVE_TO, PUT_ROWS, COMMIT, START, HOLD, RESUME, ABORT, RESET = range(1, 9)


class CncModel(modbus.Registers):
    """Registers and state machine; a motion is over after `motion_s`."""

    def __init__(self):
        self.words = [0] * 400
        self.executed = []
        self.rows = {}
        self.motion_s = 0.05
        self.takes_commands = True
        self.answers_with = self.keeps_watchdog_ms = None
        self.loses_rows = False
        self._ends_s = self._beat_s = 0.0
        self.put(0, struct.pack(">IIHH6H6HH", 0x54504331, 0x01020304, 2, 3,
                                *b"XYZ", 0, 0, 0, *[0] * 6, 4096))  # fmt: skip
        for address, text in ((20, "Truepath"), (28, "loopback"), (36, "CNC-1")):
            self.put(address, text.encode().ljust(16, b"\0"))
        self.put(44, b"0.2".ljust(16, b"\0"))
        self.put(52, struct.pack(">6i", -100_000, 0, -3_000_000, 0, 0, 0))
        self.put(64, struct.pack(">6i", 5_000_000, 4_000_000, 0, 0, 0, 0))
        self.put(76, struct.pack(">I", 30_000_000))
        self.words[181] = 1000

    def put(self, address, data):
        count = len(data) // 2
        self.words[address : address + count] = struct.unpack(f">{count}H", data)

    def get(self, address, count):
        return struct.pack(f">{count}H", *self.words[address : address + count])

    def read(self, address, count):
        if address + count > len(self.words):
            raise modbus.ModbusError(modbus.ILLEGAL_ADDRESS)
        self.advance()
        return self.words[address : address + count]

    def write(self, address, values):
        self.advance()
        self.words[address : address + len(values)] = values
        self.written(address, len(values))

    state = property(
        lambda self: self.words[100],
        lambda self, state: self.words.__setitem__(100, state),
    )

    def raise_alarm(self, code, text):
        self.state, self.words[102] = ALARM, code
        self.put(130, text.encode().ljust(64, b"\0"))

    def advance(self):
        now_s = time.monotonic()
        if self.state != RUNNING:
            return
        if now_s > self._beat_s + self.words[181] * 1e-3:
            self.state, self.words[101] = HELD, 2
        elif now_s >= self._ends_s:
            self.state = FINISHED

    def written(self, first, count):
        if self.keeps_watchdog_ms is not None:
            self.words[181] = self.keeps_watchdog_ms
        if first <= 180 < first + count:
            self._beat_s = time.monotonic()
        fresh = self.words[200] != self.words[105]
        if first <= 200 < first + count and fresh and self.takes_commands:
            self.advance()
            result = self._run(self.words[201])
            self.words[106] = result if self.answers_with is None else self.answers_with
            self.words[105] = self.words[200]

    def _run(self, verb):
        self.executed.append(verb)
        standing = self.state in (IDLE, READY, FINISHED, ABORTED)
        if verb in (MOVE_TO, PUT_ROWS, COMMIT, START) and not standing:
            return 7 if self.state == ALARM else 1
        first, count = self.words[202:204]
        if verb == MOVE_TO:
            self.words[112:124] = self.words[206:218]
        elif verb == PUT_ROWS:
            for i in range(count):
                self.rows[first + i] = self.get(206 + 16 * i, 16)
        elif verb == COMMIT:
            return self._commit(count)
        elif verb == START and not self.words[104]:
            return 3
        elif verb == HOLD and self.state == RUNNING:
            self.state, self.words[101] = HELD, 3
        elif verb == ABORT:
            self.words[104], self.state = 0, ABORTED
        if verb in (MOVE_TO, START) or (verb == RESUME and self.state == HELD):
            self.state, self.words[101] = RUNNING, 0
            self._beat_s = time.monotonic()
            self._ends_s = self._beat_s + self.motion_s
        return 0

    def _commit(self, count):
        data = b"".join(self.rows.get(i, bytes(32)) for i in range(count))
        if zlib.crc32(data) != int.from_bytes(self.get(204, 2), "big"):
            return 4
        self.words[104] = count - self.loses_rows
        self.put(108, self.get(204, 2))
        self.state = READY
        return 0


class ModbusPeer(Peer):
    """Serves a model. Faults are attributes.

    exceptions : codes to answer the next requests with, 0 is a good reply
    mangle : gets each reply as it would go out and returns what does
    """

    def __init__(self, wire):
        super().__init__(wire)
        self.model = CncModel()
        self.unit = 1
        self.requests = []
        self.exceptions = []
        self.mangle = lambda reply: reply

    def answer(self, pdu):
        self.requests.append(pdu)
        if self.exceptions and (code := self.exceptions.pop(0)):
            return modbus.exception(pdu, code)
        return modbus.answer(pdu, self.model)


class TcpPeer(ModbusPeer):
    def __init__(self):
        super().__init__(TcpWire())
        self.drop, self.hangs_up = self.wire.drop, False

    def step(self, data):
        if data and self.hangs_up:
            self.drop()
            return
        for transaction, _, pdu in modbus.TcpFramer().feed(data):
            reply = modbus.tcp_frame(transaction, self.unit, self.answer(pdu))
            self.wire.write(self.mangle(reply))


class RtuPeer(ModbusPeer):
    def __init__(self):
        super().__init__(PtyWire())
        self.options = {"serial_port": self.options["port"], "baudrate": 115_200}
        self._framer = modbus.RtuFramer()

    def step(self, data):
        for unit, pdu in self._framer.feed(data):
            if unit == self.unit:
                reply = modbus.rtu_frame(unit, self.answer(pdu))
                self.wire.write(self.mangle(reply))


@pytest.fixture(params=[TcpPeer, RtuPeer], ids=["tcp", "rtu"])
def peer(request):
    with request.param() as peer:
        yield peer


@pytest.fixture
def tcp_peer():
    with TcpPeer() as peer:
        yield peer


@pytest.fixture
def controller(peer):
    with ModbusController(**peer.options) as controller:
        yield controller


@pytest.fixture
def tcp_controller(tcp_peer):
    with ModbusController(**tcp_peer.options) as controller:
        yield controller


def zigzag(rows: int) -> Path:
    along = np.linspace(0, 100, rows)
    rows_mm = np.stack([along, along % 7, -along], axis=1)
    return path_of(*rows_mm, feed=3000.0, dwell_s=0.25)


def popped(items: list) -> bool:
    return bool(items and items.pop())


@pytest.mark.fault_row(17)
def test_connect_reads_who_and_what_and_sets_a_watchdog_unless_another_is_kept(peer):
    controller = ModbusController(**peer.options, watchdog_s=0.5)
    assert (controller.axes, controller.travel) == ((), ())
    with pytest.raises(errors.ConnectionLost, match="connect first"):
        controller.send_heartbeat()
    with controller:
        names = "Truepath", "loopback", "CNC-1", "0.2"
        assert controller.connect() == Identity(*names, has_watchdog=True)
        assert controller.axes == ("X", "Y", "Z")
        assert controller.travel == ((-10.0, 500.0), (0.0, 400.0), (-300.0, 0.0))
        status = controller.status()
        assert (status.state, status.position) == (MotionState.IDLE, (0.0, 0.0, 0.0))
        assert peer.model.words[181] == 500
        controller.close()
        peer.model.keeps_watchdog_ms = 0
        assert not controller.connect().has_watchdog


def test_a_move_is_one_command_and_ends_where_it_was_sent(peer, controller):
    controller.move_to([12.34565, 0.0, -0.0001], 1500)
    row = struct.pack(">6i2I", 123_456, 0, -1, 0, 0, 0, 1_500_000, 0)
    head = struct.pack(">BHHB6H", 16, 200, 22, 44, 1, MOVE_TO, 0, 1, 0, 0)
    assert head + row in peer.requests
    status = controller.wait(2.0)
    assert status.state is MotionState.FINISHED
    assert status.position == pytest.approx((12.3456, 0.0, -0.0001), abs=1e-9)
    controller.move_to([500.0, 400.0, -300.0], 1000)  # the ends of the travel
    assert peer.model.executed == [MOVE_TO, MOVE_TO]


@pytest.mark.parametrize("rows", [1, 7, 8, 50])
def test_a_path_of_any_order_of_axes_is_loaded_and_runs(peer, controller, rows):
    path = zigzag(rows)
    turned = {"axes": ("Z", "X", "Y"), "position": path.position[:, [2, 0, 1]]}
    controller.load(replace(path, **turned))
    assert controller.status().state is MotionState.READY
    assert peer.model.words[104] == rows
    for i in range(rows):
        x, y, z = np.rint(path.position[i] * 1e4).astype(int)
        expected = struct.pack(">6i2I", x, y, z, 0, 0, 0, 3_000_000, 250)
        assert peer.model.rows[i] == expected
    controller.start()
    assert controller.wait(2.0).state is MotionState.FINISHED
    *blocks, commit, start = peer.model.executed
    assert blocks == [PUT_ROWS] * -(-rows // 7)
    assert (commit, start) == (COMMIT, START)


def test_what_no_machine_drives_is_refused_before_the_first_byte(peer, controller):
    sent = len(peer.requests)
    for position, text in (
        ([500.001, 0, 0], r"X = 500\.0010 is outside -10\.0000 to 500\.0000"),
        ([0, -0.001, 0], r"Y = -0\.0010 is outside"),
        ([0, 0, float("nan")], "Z = nan is outside"),
        ([0, float("inf"), 0], "Y = inf is outside"),
    ):
        with pytest.raises(errors.OutOfTravel, match=text):
            controller.move_to(position, 1000)
        path = path_of((0, 0, 0), (1, 1, -1), position)
        with pytest.raises(errors.OutOfTravel, match="row 3: " + text):
            controller.load(path)
    for path, text in (
        (path_of((0, 0, 0), feed=0.0), "row 1: a feed of 0 mm/min"),
        (path_of((0, 0, 0), feed=30_001.0), "up to 30000 are"),
        (path_of((0, 0, 0), feed=float("nan")), "feed of nan"),
        (path_of((0, 0, 0), dwell_s=-1.0), "dwell of -1 s"),
        (path_of((0, 0, 0), dwell_s=float("inf")), "dwell of inf"),
        (path_of((0, 0), axes=("X", "Y")), "the machine X Y Z"),
        (path_of(), "0 rows, 1 to 4096 fit"),
        (zigzag(4097), "4097 rows, 1 to 4096 fit"),
    ):
        with pytest.raises(errors.Refused, match=text):
            controller.load(path)
    with pytest.raises(errors.Refused, match="positions have 2 values"):
        controller.move_to([1.0, 2.0], 1000)
    assert len(peer.requests) == sent


def test_an_alarm_is_a_fault_with_its_text_or_number(peer, controller):
    peer.model.raise_alarm(27, "X servo overload")
    status = controller.status()
    assert (status.state, status.alarm) == (MotionState.ALARM, "X servo overload")
    with pytest.raises(errors.MotionFault, match="X servo overload"):
        controller.wait(1.0)
    with pytest.raises(errors.MotionFault, match="refuses MOVE_TO: X servo overload"):
        controller.move_to([1, 1, -1], 1000)
    controller.hold()
    controller.abort()
    peer.model.raise_alarm(27, "")
    assert controller.status().alarm == "alarm 27"


def test_results_of_the_device_are_told_in_words(tcp_peer, tcp_controller):
    for result, family, text in (
        (1, errors.Refused, "refuses START in state idle: not in this"),
        (2, errors.OutOfTravel, "beyond the travel"),
        (3, errors.Refused, "no path is loaded"),
        (4, errors.Refused, "arrived damaged"),
        (5, errors.Refused, "an argument"),
        (6, errors.Refused, "does not know this command"),
        (8, errors.Refused, "drives on, door closed"),
        (77, errors.Refused, "result 77"),
    ):
        tcp_peer.model.answers_with = result
        with pytest.raises(family, match=text) as refusal:
            tcp_controller.start()
        assert family is not errors.Refused or refusal.value.code == result


@pytest.mark.fault_row(17)
def test_rows_that_are_damaged_or_lost_on_the_way_are_not_driven(peer, controller):
    sent = peer.model.written

    def damaged(first, count):
        if peer.model.words[201] == PUT_ROWS:
            peer.model.words[207] ^= 1
        sent(first, count)

    peer.model.written = damaged
    with pytest.raises(errors.Refused, match="arrived damaged"):
        controller.load(zigzag(3))
    peer.model.written, peer.model.loses_rows = sent, True
    with pytest.raises(errors.MotionFault, match="holds 2 rows with CRC"):
        controller.load(zigzag(3))


@pytest.mark.fault_row(17)
def test_a_command_that_is_never_taken_is_a_fault(tcp_peer, measured):
    with ModbusController(command_timeout_s=0.1, **tcp_peer.options) as controller:
        tcp_peer.model.takes_commands = False
        begun_s = time.monotonic()
        with pytest.raises(errors.MotionFault, match=r"START was not taken in 0\.1 s"):
            controller.start()
        measured(f"told after {time.monotonic() - begun_s:.2f} s")
        in_vain = tcp_peer.model.words[200]
        tcp_peer.model.takes_commands = True
        controller.abort()
        assert tcp_peer.model.words[105] == in_vain + 1  # it is not used again


@pytest.mark.fault_row(14)
def test_a_lost_reply_runs_the_command_once(peer, controller):
    lose = [True]

    def mangle(reply):
        is_write = reply[-8:-4] == b"\0\xc8\0\2" or b"\x10\0\xc8" in reply
        return b"" if is_write and popped(lose) else reply

    peer.mangle = mangle
    peer.model.words[104] = 1
    controller.start()
    assert (lose, peer.model.executed) == ([], [START])


@pytest.mark.fault_row(14)
def test_a_lost_request_is_sent_again_after_reading_the_state(tcp_peer, tcp_controller):
    model = tcp_peer.model
    model.words[104] = 1
    run = model.written
    to_lose, replies_to_lose = [1, 2], []

    def forgets(first, count):
        if first == 200 and to_lose:
            replies_to_lose.append(to_lose.pop())
            model.words[200] = model.words[105]
        else:
            run(first, count)

    model.written = forgets
    tcp_peer.mangle = lambda reply: b"" if popped(replies_to_lose) else reply
    tcp_controller.start()
    assert model.executed == [START]


def test_numbers_go_on_and_skip_zero_and_those_of_other_masters(peer):
    words = peer.model.words
    words[105] = words[200] = 0xFFFF
    with ModbusController(**peer.options) as controller:
        for number in (1, 2):
            controller.hold()
            assert words[105] == number
        words[105] = words[200] = 3
        controller.abort()
    assert peer.model.executed == [HOLD, HOLD, ABORT]


def test_a_hold_is_sent_even_where_the_state_cannot_be_read(tcp_peer, tcp_controller):
    tcp_peer.mangle = lambda reply: reply if reply[7] == 16 else b""
    with pytest.raises(errors.DeviceTimeout):
        tcp_controller.hold()
    assert tcp_peer.model.executed == [HOLD]
    with pytest.raises(errors.DeviceTimeout):
        tcp_controller.start()
    assert tcp_peer.model.executed == [HOLD]


MANGLED = {
    "nothing": lambda reply: b"",
    "half": lambda reply: reply[: len(reply) // 2],
    "noise": lambda reply: np.random.default_rng(2).bytes(40),
    "cut": lambda reply: reply[:-1],
}


@pytest.mark.parametrize("mangled", MANGLED)
@pytest.mark.fault_row(14)
def test_bad_replies_are_a_timeout_within_half_a_second(
    peer, controller, mangled, measured
):
    peer.mangle = MANGLED[mangled]
    took_s = []
    for _ in range(3):  # on a busy computer one of them may take longer
        begin = time.monotonic()
        with pytest.raises(errors.DeviceTimeout, match=r"no valid reply in 0\.2 s"):
            controller.status()
        took_s.append(time.monotonic() - begin)
        if took_s[-1] < 0.5:
            break
    assert min(took_s) < 0.5
    measured(f"{mangled}: told after {min(took_s):.2f} s")
    peer.mangle = lambda reply: reply
    assert controller.status().state is MotionState.IDLE


@pytest.mark.fault_row(14)
def test_a_damaged_or_short_reply_is_never_taken(tcp_peer, tcp_controller):
    with RtuPeer() as rtu, ModbusController(**rtu.options) as controller:
        rtu.mangle = lambda reply: bytes([*reply[:-3], reply[-3] ^ 4, *reply[-2:]])
        with pytest.raises(errors.DeviceTimeout):
            controller.status()
        rtu.mangle = lambda reply: reply
        assert controller.status().position == (0.0, 0.0, 0.0)

    def shortened(reply):
        fewer = bytes([3, 2, 0, 6])
        return reply[:4] + struct.pack(">HB", len(fewer) + 1, 1) + fewer

    tcp_peer.mangle = shortened
    with pytest.raises(errors.DeviceTimeout, match="1 registers came, not 24"):
        tcp_controller.status()


@pytest.mark.fault_row(15)
def test_a_reply_to_an_older_transaction_is_not_taken(
    tcp_peer, tcp_controller, measured
):
    tcp_peer.mangle = lambda reply: b"\x7f\xff" + reply[2:]
    with pytest.raises(errors.DeviceTimeout):
        tcp_controller.status()
    stale = []

    def late(reply):
        stale.append(reply)
        return b"".join(stale[-2:])

    tcp_peer.mangle = late
    for _ in range(3):
        assert tcp_controller.status().state is MotionState.IDLE
    measured(f"{len(stale) - 1} late replies before the right one, none taken")


@pytest.mark.fault_row(44)
def test_a_reply_that_comes_late_to_the_repeated_request_as_well_is_not_taken(
    tcp_peer, tcp_controller
):
    """A status is younger than the two requests that it may take."""
    delays_s = iter((0.3, 0.15))

    def late(reply):
        time.sleep(next(delays_s, 0.0))
        return reply

    tcp_peer.mangle = late
    with pytest.raises(errors.DeviceTimeout, match=r"later than 0\.2 s"):
        tcp_controller.status()
    assert tcp_controller.status().state is MotionState.IDLE


EXCEPTIONS = {
    1: (errors.Refused, "does not know this function"),
    2: (errors.Refused, "does not have these registers"),
    3: (errors.Refused, "does not take this value"),
    **dict.fromkeys((4, 7, 8), (errors.MotionFault, "the device has failed")),
    **dict.fromkeys((10, 11), (errors.ConnectionLost, "the gateway does not reach")),
}


@pytest.mark.parametrize("code", EXCEPTIONS)
@pytest.mark.fault_row(13)
def test_exceptions_of_modbus_have_their_families(peer, controller, code):
    family, text = EXCEPTIONS[code]
    for verb in (controller.status, controller.send_heartbeat):
        peer.exceptions = [code]
        with pytest.raises(family, match=text + rf".*\(exception {code}\)"):
            verb()
    assert controller.status().state is MotionState.IDLE


@pytest.mark.fault_row(13)
def test_a_busy_device_is_asked_again_and_one_that_stays_so_is_a_timeout(
    peer, controller, measured
):
    for code in (5, 6):
        peer.exceptions = [code, code]
        assert controller.status().state is MotionState.IDLE
        peer.exceptions = [code, 0, code]
        controller.hold()
    assert peer.model.executed == [HOLD, HOLD]
    controller.close()
    with ModbusController(command_timeout_s=0.1, **peer.options) as hurried:
        peer.exceptions = [6] * 1000
        begun_s = time.monotonic()
        with pytest.raises(errors.DeviceTimeout, match="busy"):
            hurried.status()
        measured(f"busy for good: told after {time.monotonic() - begun_s:.2f} s")
        peer.exceptions = []


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ({0: 0, 1: 0}, "this is not the register map"),
        ({2: 0x0304, 3: 0x0102, 0: 0x4331, 1: 0x5450}, "low word first"),
        ({2: 0x0201, 3: 0x0403, 0: 0x5054, 1: 0x3143}, "low byte first"),
        ({2: 0x0403, 3: 0x0201, 0: 0x3143, 1: 0x5054}, "words and bytes swapped"),
        ({4: 1}, "register map 1, this driver knows 2"),
        ({5: 0}, "0 axes"),
        ({5: 7}, "7 axes"),
    ],
)
@pytest.mark.fault_row(18)
def test_a_wrong_device_or_a_wrong_order_is_refused(peer, words, text, measured):
    for address, word in words.items():
        peer.model.words[address] = word
    with pytest.raises(errors.WrongDevice, match=text):
        ModbusController(**peer.options).connect()
    measured(f"“{text}”")


@pytest.mark.fault_row(7)
def test_the_wrong_device_by_its_serial_number_or_another_map_is_refused(peer):
    with pytest.raises(errors.WrongDevice, match="controller CNC-1 answers, CNC-2"):
        ModbusController(serial_number="CNC-2", **peer.options).connect()
    with ModbusController(serial_number="CNC-1", **peer.options) as controller:
        assert controller.axes
    remedy = "check unit number and register map"
    for code in (1, 2, 3):
        peer.exceptions = [code]
        with pytest.raises(errors.WrongDevice, match=remedy):
            ModbusController(**peer.options).connect()


@pytest.mark.fault_row(15)
def test_another_unit_does_not_answer(peer):
    peer.unit = 2
    with pytest.raises(errors.DeviceTimeout, match="check power, unit number"):
        ModbusController(unit=9, **peer.options).connect()


@pytest.mark.fault_row(16)
def test_one_close_costs_nothing(tcp_peer, tcp_controller):
    tcp_peer.model.words[104] = 1
    verbs = tcp_controller.send_heartbeat, tcp_controller.status, tcp_controller.hold
    for verb in (*verbs * 3, tcp_controller.start):
        tcp_peer.drop()
        verb()
    assert tcp_peer.model.executed == [HOLD, HOLD, HOLD, START]


@pytest.mark.fault_row(14)
def test_a_command_whose_link_breaks_under_way_runs_once(tcp_peer, tcp_controller):
    model = tcp_peer.model
    model.words[104] = 1
    run, breaks = model.written, [True]

    def written(first, count):
        run(first, count)
        if first == 200 and popped(breaks):
            tcp_peer.hangs_up = True

    model.written = written
    tcp_peer.mangle = lambda reply: reply if not tcp_peer.hangs_up else b""
    opening = threading.Timer(0.3, setattr, (tcp_peer, "hangs_up", False))
    opening.start()
    tcp_controller.start()
    opening.join()
    assert model.executed == [START]


def test_another_controller_after_a_broken_link_is_refused(tcp_peer, tcp_controller):
    tcp_peer.model.put(36, b"CNC-2".ljust(16, b"\0"))
    tcp_peer.drop()
    with pytest.raises(errors.WrongDevice, match="CNC-2"):
        tcp_controller.status()
    with pytest.raises(errors.DeviceError):
        tcp_controller.start()
    assert tcp_peer.model.executed == []


@pytest.mark.parametrize("is_busy", [False, True])
@pytest.mark.fault_row(16)
def test_a_hold_into_a_black_hole_says_so_within_half_a_second(
    tcp_peer, tcp_controller, is_busy, measured
):
    tcp_peer.mangle = lambda reply: b""
    with ThreadPoolExecutor() as pool:
        if is_busy:
            pool.submit(tcp_controller.status)
            time.sleep(0.02)
        begin_s = time.monotonic()
        with pytest.raises(errors.DeviceTimeout):
            tcp_controller.hold()
        took_s = time.monotonic() - begin_s
    assert took_s < 0.5
    measured(f"a hold without an answer: told after {took_s:.2f} s")


def test_close_lets_a_held_machine_stand_and_does_without_an_answer(peer, caplog):
    peer.model.motion_s = 10.0
    with ModbusController(**peer.options) as controller:
        controller.move_to([1, 1, -1], 1000)
        controller.hold()
    assert peer.model.executed == [MOVE_TO, HOLD]
    with ModbusController(**peer.options):
        peer.mangle = lambda reply: b""
    assert "closed without an answer" in caplog.text


def test_one_way_has_to_be_given_and_one_that_leads_nowhere_is_told(free_port):
    nowhere = {"host": "127.0.0.1", "port": free_port}, {"serial_port": "/dev/none"}
    remedy = "check address, cable and power"
    for options in nowhere:
        with pytest.raises(errors.ConnectionLost, match=remedy):
            ModbusController(**options).connect()
    for options in ({}, {"host": "a", "serial_port": "/dev/b"}):
        with pytest.raises(ValueError, match="either host"):
            ModbusController(**options)


def test_an_abort_overtakes_the_upload_of_4096_rows(tcp_peer, tcp_controller, until):
    tcp_controller.load(zigzag(4096))
    assert tcp_peer.model.words[104] == 4096
    tcp_peer.model.executed.clear()
    cause = "aborted while the path was being loaded"
    with ThreadPoolExecutor() as pool:
        loading = pool.submit(tcp_controller.load, zigzag(4096))
        until(lambda: len(tcp_peer.model.executed) > 5)
        tcp_controller.abort()
        with pytest.raises(errors.Refused, match=cause):
            loading.result()
    assert tcp_peer.model.executed.count(PUT_ROWS) < 4096 / 7
    assert ABORT in tcp_peer.model.executed[-2:]


def test_verbs_from_many_threads_do_not_mix(tcp_peer, tcp_controller):
    asks = tcp_controller.status, tcp_controller.send_heartbeat, tcp_controller.hold
    verbs = [*asks, lambda: tcp_controller.load(zigzag(3))]
    with ThreadPoolExecutor() as pool:
        asked = [pool.submit(lambda verb=v: [verb() for _ in range(30)]) for v in verbs]
    assert [done.exception() for done in asked] == [None] * 4
    assert tcp_peer.model.executed.count(HOLD) == 30
    assert tcp_peer.model.executed.count(COMMIT) == 30


@pytest.fixture(scope="module")
def bench():
    with Bench(speed=4.0) as bench:
        yield bench


@pytest.fixture
def bench_controller(bench):
    with ModbusController(**bench.motion_options) as controller:
        yield controller


@pytest.mark.parametrize(
    ("fault", "state", "remedy"),
    [
        ("estop", MotionState.ESTOP, "release it"),
        ("drives-off", MotionState.NOT_READY, "switch the machine on"),
        ("unhomed", MotionState.UNHOMED, "home it"),
        ("door+6s", MotionState.DOOR, "close it"),
    ],
)
def test_a_machine_that_cannot_be_driven_says_why_until_it_can(
    bench, bench_controller, until, fault, state, remedy
):
    controller = bench_controller
    assert controller.status().referenced is True
    assert controller.status().compensation is False
    bench.inject(f"cnc:{fault}")
    until(lambda: controller.status().state is state)
    with pytest.raises(errors.MotionFault, match=remedy):
        controller.move_to((1.0, 1.0, 1.0), 3000.0)
    with pytest.raises(errors.MotionFault, match=remedy):
        controller.wait(1.0)
    if state is MotionState.UNHOMED:
        controller.home(5.0)
    elif state is not MotionState.DOOR:
        controller.reset()
    until(lambda: controller.status().state is MotionState.IDLE)
    controller.move_to((1.0, 1.0, 1.0), 3000.0)
    assert controller.wait(5.0).state is MotionState.FINISHED


def test_arcs_that_leave_the_travel_or_their_row_never_reach_the_wire(bench_controller):
    assert bench_controller.connect().drives_arcs
    low, high = bench_controller.travel[1]
    path = two_turns(60.0, 60.0, 50.0)
    shift = np.array([0.0, low - 15.0, 0.0])
    arcs = [arc and replace(arc, centre_mm=(60.0, 45.0 + low)) for arc in path.arc]
    moved = replace(path, position=path.position + shift, arc=tuple(arcs))
    assert high > 100.0
    with pytest.raises(errors.OutOfTravel, match="row 2: on its arc Y comes to"):
        bench_controller.load(moved)
    wrong = replace(path.arc[1], turn_deg=700.0)
    with pytest.raises(errors.Refused, match="from where its arc leads to"):
        bench_controller.load(replace(path, arc=(None, wrong, path.arc[2])))


@pytest.mark.fault_row(20)
def test_an_override_is_lowered_never_raised_and_one_that_stays_above_refused(
    bench, bench_controller, tcp_peer, until
):
    assert bench_controller.status().override == 1.0
    bench.inject("cnc:override+6s*0")
    until(lambda: bench_controller.status().override == 0.0)
    until(lambda: bench_controller.status().override == 1.0)
    with ModbusController(**tcp_peer.options, command_timeout_s=0.3) as controller:
        tcp_peer.model.words[107] = 0
        assert controller.status().override is None
        tcp_peer.model.words[107] = 500
        assert controller.status().override == 0.5
        for exceptions in ([], [0, 2]):  # it keeps it, or has it not
            tcp_peer.model.words[107], tcp_peer.exceptions = 1200, exceptions
            with pytest.raises(errors.Refused, match="at the machine only"):
                controller.limit_override(1.0)
            tcp_peer.model.words[107] = 800
            controller.limit_override(1.0)
    bench.inject("cnc:override*1.2")
    until(lambda: bench_controller.status().override == 1.2)
    for largest, left in ((1.0, 1.0), (0.5, 0.5), (1.0, 0.5)):
        bench_controller.limit_override(largest)
        assert bench_controller.status().override == left
