"""Serial ports and TCP connections: bounded waits, and texts that say what to do."""

import os
import socket
import termios
import time
from contextlib import contextmanager
from unittest.mock import Mock

import pytest
import serial

from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.transport.serial_port import SerialPort
from truepath_drivers.transport.tcp_port import TcpPort
from wires import PtyWire, TcpWire


@contextmanager
def wired(wire, port):
    yield wire, port
    port.close()
    wire.unplug()


@pytest.fixture
def pty_port():
    wire = PtyWire(is_raw=False)
    with wired(wire, SerialPort(wire.options["port"], 921_600)) as ends:
        yield ends


@pytest.fixture
def tcp_port():
    wire = TcpWire()
    with wired(wire, TcpPort(**wire.options)) as ends:
        yield ends


@pytest.fixture(params=["pty_port", "tcp_port"])
def either_port(request):
    return request.getfixturevalue(request.param)


def test_every_byte_goes_through_both_ways_until_nobody_takes_one(either_port):
    """Through a cooked terminal too."""
    wire, port = either_port
    every_byte, heard = bytes(range(256)), b""
    port.open()
    port.write(every_byte)
    while len(heard) < 256:
        heard += wire.read(1.0)
    assert heard == every_byte
    wire.write(every_byte)
    assert _read(port, 256) == every_byte
    begin = time.monotonic()
    with pytest.raises(DeviceTimeout, match="takes no bytes"):
        port.write(bytes(1 << 26))
    assert time.monotonic() - begin < 2.0


def test_a_baud_rate_is_set_and_tcp_waits_for_no_more_bytes(pty_port, tcp_port):
    for _, port in (pty_port, tcp_port):
        port.open()
    assert termios.tcgetattr(pty_port[0].slave)[4] == termios.B921600
    assert tcp_port[1]._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_close_twice_is_one_close_and_open_opens_anew(either_port):
    port = either_port[1]
    port.close()
    port.open()
    port.open()
    port.close()
    port.close()
    for use in (lambda: port.read(0.0), lambda: port.write(b"x")):
        with pytest.raises(ConnectionLost, match="not open; connect first"):
            use()


def test_a_serial_port_whose_other_end_goes_is_lost(pty_port):
    wire, port = pty_port
    port.open()
    wire.write(b"last")
    wire.unplug()
    # Bytes that were on their way may come first.
    with pytest.raises(ConnectionLost, match=r"gone .* check cable and power"):
        _read(port, 100)
    with pytest.raises(ConnectionLost, match="gone"):
        port.write(b"x")


@pytest.mark.fault_row(16)
@pytest.mark.parametrize(("resets", "said"), [(False, "closed by the"), (True, "gone")])
def test_a_tcp_peer_that_closes_or_resets_is_lost(tcp_port, resets, said):
    wire, port = tcp_port
    port.open()
    wire.read(1.0)
    wire.drop(reset=resets)
    with pytest.raises(ConnectionLost, match=said):
        port.read(0.5)
    if resets:
        with pytest.raises(ConnectionLost, match="gone"):
            port.write(b"x")


def test_a_serial_port_is_for_one_program(pty_port):
    port = pty_port[1]
    port.open()
    other = SerialPort(port.name, 921_600)
    with pytest.raises(ConnectionLost, match="another program uses it"):
        other.open()
    port.close()
    other.open()
    other.close()


def test_a_path_without_a_tty_or_permission_is_named(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.touch()
    port = SerialPort(str(path), 921_600)
    with pytest.raises(ConnectionLost, match="cannot be opened at 921600 baud"):
        port.open()
    refused = Mock(side_effect=serial.SerialException("could not open port"))
    monkeypatch.setattr(serial, "Serial", refused)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ConnectionLost, match="dialout"):
        port.open()


def _read(port, count):
    data, deadline = b"", time.monotonic() + 2
    while len(data) < count and time.monotonic() < deadline:
        data += port.read(0.1)
    return data
