"""A CNC behind Modbus TCP and RTU, written from the page of the map, words by hand."""

import struct
import time
import zlib

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
        """Let time pass: the motion ends, or the watchdog bites."""
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
