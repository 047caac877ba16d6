"""Serial ports and TCP connections: bounded waits, and texts that say what to do."""

import os
import socket
import termios
import time
import tty

import pytest
import serial

from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.transport.serial_port import SerialPort
from truepath_drivers.transport.tcp_port import TcpPort


@pytest.fixture
def pty_port():
    master, slave = os.openpty()
    port = SerialPort(os.ttyname(slave), 921_600)
    yield master, slave, port
    port.close()
    for end in (master, slave):
        if end_is_open(end):
            os.close(end)


def end_is_open(end: int) -> bool:
    try:
        os.fstat(end)
    except OSError:
        return False
    return True


@pytest.fixture
def tcp_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = TcpPort("127.0.0.1", server.getsockname()[1])
        yield server, port
        port.close()


def test_a_serial_port_is_raw_in_both_directions(pty_port):
    master, _, port = pty_port
    every_byte = bytes(range(256))
    port.open()
    os.write(master, every_byte)
    assert _read(port, 256) == every_byte
    port.write(every_byte)
    assert os.read(master, 512) == every_byte


def test_a_serial_port_takes_its_baud_rate(pty_port):
    _, slave, port = pty_port
    port.open()
    assert termios.tcgetattr(slave)[4] == termios.B921600


def test_a_tcp_port_carries_bytes_without_delay(tcp_port):
    server, port = tcp_port
    port.open()
    peer, _ = server.accept()
    with peer:
        port.write(b"to the device")
        assert peer.recv(100) == b"to the device"
        peer.sendall(b"from it")
        assert _read(port, 7) == b"from it"
        nodelay = port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert nodelay


@pytest.mark.parametrize("fixture", ["pty_port", "tcp_port"])
def test_a_read_waits_no_longer_than_it_may(fixture, request):
    port = request.getfixturevalue(fixture)[-1]
    port.open()
    begin = time.monotonic()
    assert port.read(0.05) == b""
    assert 0.04 < time.monotonic() - begin < 0.5


@pytest.mark.parametrize("fixture", ["pty_port", "tcp_port"])
def test_close_twice_is_one_close_and_open_opens_anew(fixture, request):
    port = request.getfixturevalue(fixture)[-1]
    port.close()
    port.open()
    port.open()
    port.close()
    port.close()
    for use in (lambda: port.read(0.0), lambda: port.write(b"x")):
        with pytest.raises(ConnectionLost, match="not open; connect first"):
            use()


def test_a_serial_port_whose_other_end_goes_is_lost(pty_port):
    master, slave, port = pty_port
    port.open()
    os.write(master, b"last")
    os.close(slave)
    os.close(master)
    # Bytes that were on their way may come first.
    with pytest.raises(ConnectionLost, match=r"gone .* check cable and power"):
        _read(port, 100)
    with pytest.raises(ConnectionLost, match="gone"):
        port.write(b"x")


def test_a_tcp_peer_that_closes_is_lost(tcp_port):
    server, port = tcp_port
    port.open()
    server.accept()[0].close()
    with pytest.raises(ConnectionLost, match="closed by the device"):
        port.read(0.5)


@pytest.mark.fault_row(16)
def test_a_tcp_peer_that_resets_is_lost(tcp_port):
    server, port = tcp_port
    port.open()
    peer, _ = server.accept()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    peer.close()
    with pytest.raises(ConnectionLost, match="gone"):
        port.read(0.5)
    with pytest.raises(ConnectionLost, match="gone"):
        port.write(b"x")


@pytest.mark.parametrize("fixture", ["pty_port", "tcp_port"])
def test_a_peer_that_takes_no_bytes_is_a_timeout(fixture, request):
    port = request.getfixturevalue(fixture)[-1]
    port.open()
    begin = time.monotonic()
    with pytest.raises(DeviceTimeout, match="takes no bytes"):
        port.write(bytes(1 << 26))
    assert time.monotonic() - begin < 2.0


def test_a_serial_port_is_for_one_program(pty_port):
    port = pty_port[-1]
    port.open()
    other = SerialPort(port.name, 921_600)
    with pytest.raises(ConnectionLost, match="another program uses it"):
        other.open()
    port.close()
    other.open()
    other.close()


def test_a_path_that_is_no_tty_is_named(tmp_path):
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(ConnectionLost, match="cannot be opened at 921600 baud"):
        SerialPort(str(path), 921_600).open()


def test_a_port_without_permission_names_the_group(pty_port, monkeypatch):
    _, _, port = pty_port

    def refuse(*_, **__):
        raise serial.SerialException("could not open port")

    monkeypatch.setattr(serial, "Serial", refuse)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ConnectionLost, match="dialout"):
        port.open()


def test_a_cooked_terminal_is_made_raw(pty_port):
    master, slave, port = pty_port
    tty.setcbreak(slave)
    port.open()
    os.write(master, b"\r\x03\x11\n")
    assert _read(port, 4) == b"\r\x03\x11\n"


def _read(port, count):
    data = b""
    deadline = time.monotonic() + 2
    while len(data) < count and time.monotonic() < deadline:
        data += port.read(0.1)
    return data
