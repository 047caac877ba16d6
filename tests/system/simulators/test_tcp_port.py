"""The link of a simulated device serves one host after the other."""

import socket
import time
from contextlib import closing

import pytest

from truepath_simulators.links.links import TcpPort


@pytest.fixture
def port():
    with closing(TcpPort("127.0.0.1", 0)) as port:
        yield port


def connect(port):
    return socket.create_connection((port.address["host"], port.address["port"]), 5.0)


def receive(port, wanted):
    deadline = time.monotonic() + 5.0
    while (data := port.receive()) != wanted:
        assert time.monotonic() < deadline, data
    return data


class SpeaksMeanwhile:
    """A listener at which one host is taken while another one says a word."""

    def __init__(self, listener, other, *, leaves):
        self._listener, self._other, self._leaves = listener, other, leaves

    def accept(self):
        fresh = self._listener.accept()
        self._other.sendall(b"STOP")
        if self._leaves:
            self._other.close()
        return fresh

    def close(self):
        self._listener.close()


def test_a_host_that_leaves_with_a_last_word_makes_room_for_the_next(port):
    first = connect(port)
    assert receive(port, None) is None
    with connect(port) as second:
        second.sendall(b"START")
        port._listener = SpeaksMeanwhile(port._listener, first, leaves=True)
        assert receive(port, None) is None
        assert receive(port, b"START") == b"START"


def test_while_a_host_is_there_others_are_turned_away_and_its_words_are_kept(port):
    with connect(port) as first, connect(port) as second:
        assert receive(port, None) is None
        port._listener = SpeaksMeanwhile(port._listener, first, leaves=False)
        assert port.receive() == b"STOP"
        assert second.recv(1) == b""
        first.sendall(b"ON")
        assert receive(port, b"ON") == b"ON"
