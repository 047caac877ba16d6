"""What systemd hears of the real service: ready, alive while its loop runs, ending."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from itertools import pairwise

import httpx2
import pytest
from service_process import wait_for

from truepath.service.api.service_manager import ServiceManager

PROGRAM = """
import time
from truepath.main import serve
from truepath.settings import load_settings
from truepath.service.page import pages

@pages.router.get("/freeze")
async def freeze():
    time.sleep(4.0)

if __name__ == "__main__":
    serve(load_settings())
"""
WATCHDOG_S = 1.5


class Notices:
    """A notify socket: what came, and when."""

    def __init__(self, place):
        self.link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.link.bind(place)
        self.received = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        while message := self.link.recv(4096):
            self.received.append((time.monotonic(), message.decode()))

    def count(self, text):
        return sum(text in message for _, message in self.received)

    def close(self):
        self.link.shutdown(socket.SHUT_RD)
        self._thread.join(5)
        self.link.close()


@pytest.fixture
def notices(tmp_path):
    found = Notices(str(tmp_path / "notify"))
    yield found
    found.close()


@contextmanager
def watched_service(tmp_path):
    program = tmp_path / "service.py"
    program.write_text(PROGRAM)
    environment = {
        "TRUEPATH_DATA_DIR": str(tmp_path / "data"),
        "TRUEPATH_PORT": "0",
        "TRUEPATH_CONFIG": "",
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)),
    }
    running = subprocess.Popen(
        [sys.executable, program],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    )
    try:
        lines = [running.stdout.readline() for _ in range(4)]
        (page,) = [x.split()[1] for x in lines if x.split()[:1] == ["page"]]
        yield running, page
    finally:
        running.kill()
        running.stdout.close()
        running.wait(20)


def test_a_frozen_event_loop_gives_no_sign_of_life_and_one_that_runs_does(
    tmp_path, notices
):
    with watched_service(tmp_path) as (running, page):
        wait_for(lambda: notices.count("READY=1"), "READY")
        wait_for(lambda: notices.count("WATCHDOG=1") >= 2, "signs of life")
        assert "READY=1" in notices.received[0][1]
        httpx2.get(f"{page}freeze", timeout=60.0)
        wait_for(lambda: _longest_pause_s(notices) > 3.5, "the pause")
        before = notices.count("WATCHDOG=1")
        wait_for(lambda: notices.count("WATCHDOG=1") > before, "signs of life")
        running.send_signal(signal.SIGTERM)
        wait_for(lambda: notices.count("STOPPING=1") == 1, "STOPPING")
        assert running.wait(30) in (0, -signal.SIGTERM)


def _longest_pause_s(notices):
    at = [at for at, message in list(notices.received) if "WATCHDOG" in message]
    return max((b - a for a, b in pairwise(at)), default=0.0)


def test_a_watchdog_of_another_process_is_not_ours(monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert ServiceManager.of_environment()._watchdog_s is None
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert ServiceManager.of_environment()._watchdog_s == 1.0


def test_a_socket_that_has_gone_does_not_end_the_service(tmp_path):
    ServiceManager(str(tmp_path / "gone"), None).end()


def test_an_abstract_socket_is_reached():
    name = f"truepath-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(f"\0{name}")
        ServiceManager(f"@{name}", None).end()
        assert link.recv(100) == b"STOPPING=1"
