from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from truepath_simulators.cnc import modbus
from truepath_simulators.cnc.modbus import RtuFramer, TcpFramer, rtu_frame


class Drawer(modbus.Registers):
    """Registers 0x6B … with the values of the specification's examples."""

    def __init__(self):
        self.words = {0x6B: 0x022B, 0x6C: 0x0000, 0x6D: 0x0064, 1: 0, 2: 0}

    def read(self, address, count):
        try:
            return [self.words[a] for a in range(address, address + count)]
        except KeyError:
            raise modbus.ModbusError(2) from None

    def write(self, address, values):
        self.words |= dict(enumerate(values, address))


# Modbus application protocol V1.1b3, sections 6.3, 6.6 and 6.12.
@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("03 006B 0003", "03 06 022B 0000 0064"),
        ("06 0001 0003", "06 0001 0003"),
        ("10 0001 0002 04 000A 0102", "10 0001 0002"),
        ("03 0070 0001", "83 02"),
        ("03 006B 0000", "83 03"),
        ("03 006B 007E", "83 03"),
        ("03 00", "83 03"),
        ("10 0001 0002 04 000A", "90 03"),
        ("10 0001 0002 06 000A 0102", "90 03"),
        ("10 0001 0002 02 000A 0102", "90 03"),
        ("04 006B 0001", "84 01"),
        ("01 0000 0001", "81 01"),
        ("2B 0E 01 00", "AB 01"),
    ],
)
def test_requests_are_answered_as_the_specification_says(request_hex, reply_hex):
    drawer = Drawer()
    reply = modbus.answer(bytes.fromhex(request_hex), drawer)
    assert reply == bytes.fromhex(reply_hex)
    written = [0x000A, 0x0102] if reply_hex == "10 0001 0002" else [0, 0]
    assert request_hex[:2] == "06" or drawer.read(1, 2) == written


# Modbus over serial line V1.02: CRC low byte first; 02 07 has the CRC 41 12.
def test_the_crc_is_that_of_the_specification_and_its_example_is_understood():
    assert rtu_frame(2, b"\x07") == bytes.fromhex("02 07 41 12")
    assert modbus.crc16(bytes.fromhex("02 07 41 12")) == 0
    frame = bytes.fromhex("11 03 006B 0003 7687")
    assert RtuFramer().feed(frame) == [(0x11, bytes.fromhex("03 006B 0003"))]


READ = rtu_frame(1, bytes.fromhex("03 0000 0005"))
WRITE = rtu_frame(1, bytes.fromhex("10 0001 0002 04 000A 0102"))


@given(st.lists(st.sampled_from([READ, WRITE]), max_size=6), st.data())
@pytest.mark.fault_row(4)
def test_any_split_of_a_serial_line_gives_the_same_requests(frames, data):
    stream = b"".join(frames)
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8).map(sorted))
    framer = RtuFramer()
    parts = (stream[a:b] for a, b in pairwise([0, *cuts, len(stream)]))
    got = [request for part in parts for request in framer.feed(part)]
    assert got == [(1, frame[1:-2]) for frame in frames]


@given(st.binary(max_size=40))
def test_after_noise_and_a_pause_a_request_is_understood(noise):
    framer = RtuFramer()
    framer.feed(noise)
    framer.expire()
    assert framer.feed(READ) == [(1, READ[1:-2])]


def test_requests_on_tcp_keep_their_transaction_and_damage_is_not_answered():
    pdu = bytes.fromhex("03 0000 0005")
    stream = modbus.tcp_frame(7, 1, pdu) + modbus.tcp_frame(8, 1, pdu)
    framer = TcpFramer()
    assert framer.feed(stream[:9]) == []
    assert framer.feed(stream[9:]) == [(7, 1, pdu), (8, 1, pdu)]
    bad = bytearray(READ)
    bad[3] ^= 0x10
    assert RtuFramer().feed(bytes(bad)) == []
    assert TcpFramer().feed(b"GET / HTTP/1.1\r\n") is None
