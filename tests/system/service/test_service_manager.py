"""Where the service listens, and what systemd hears of it: ready, alive, ending."""

import os
import signal
import socket
import threading
import time
from itertools import pairwise
from urllib.parse import urlsplit

import pytest

from real_services import process
from service_process import wait_for
from truepath.service.api.server import ServiceManager, bind_socket, format_address

WATCHDOG_S = 1.5


@pytest.fixture
def notices(tmp_path):
    received = []

    def read():
        while message := link.recv(4096):
            received.append((time.monotonic(), message.decode()))

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(tmp_path / "notify"))
        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        yield received
        link.shutdown(socket.SHUT_RD)
        thread.join(5)


def count(notices, text):
    return sum(text in message for _, message in notices)


def test_a_frozen_event_loop_gives_no_sign_of_life(tmp_path, notices):
    watched = {
        "TRUEPATH_SIMULATED": "0",
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)),
    }
    with process(tmp_path, **watched) as (running, client):
        wait_for(lambda: count(notices, "WATCHDOG=1") >= 2, "signs of life")
        assert "READY=1" in notices[0][1]
        client.get("/freeze")
        wait_for(lambda: _longest_pause_s(notices) > 3.5, "the pause")
        before = count(notices, "WATCHDOG=1")
        wait_for(lambda: count(notices, "WATCHDOG=1") > before, "signs of life")
        running.send_signal(signal.SIGTERM)
        wait_for(lambda: count(notices, "STOPPING=1") == 1, "STOPPING")
        assert running.wait(30) in (0, -signal.SIGTERM)


def _longest_pause_s(notices):
    at = [at for at, message in list(notices) if "WATCHDOG" in message]
    return max((b - a for a, b in pairwise(at)), default=0.0)


def test_a_watchdog_of_another_process_is_not_ours(monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert ServiceManager.of_environment()._watchdog_s is None
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert ServiceManager.of_environment()._watchdog_s == 1.0


def test_an_abstract_socket_is_reached_and_one_that_has_gone_is_no_end(tmp_path):
    ServiceManager(str(tmp_path / "gone"), None).end()
    name = f"truepath-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(f"\0{name}")
        ServiceManager(f"@{name}", None).end()
        assert link.recv(100) == b"STOPPING=1"


def test_the_address_is_one_that_this_computer_can_open():
    for host, shown in (
        ("127.0.0.1", "http://127.0.0.1:"),
        ("0.0.0.0", "http://127.0.0.1:"),
        ("::1", "http://[::1]:"),
        ("::", "http://[::1]:"),
    ):
        with bind_socket(host, 0) as listener:
            port = listener.getsockname()[1]
            assert format_address(listener) == f"{shown}{port}"
            place = urlsplit(format_address(listener))
            socket.create_connection((place.hostname, place.port), timeout=5.0).close()
