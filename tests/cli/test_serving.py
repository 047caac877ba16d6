"""`serve`: settings that cannot work are one line; `--measure` is the main job."""

import json
import logging
import os
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from truepath.cli.calibration import (
    calibrate,
    follow_to_the_end,
    measure_on_the_fly,
)
from truepath.cli.command import run
from truepath.client import Client
from truepath.errors import MeasurementFailed

TRUEPATH = Path(sys.executable).with_name("truepath")
TABLES_STAND_S = 120.0


@pytest.fixture(autouse=True)
def no_settings_of_this_computer(monkeypatch, tmp_path):
    for name in list(os.environ):
        if name.startswith("TRUEPATH_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture(autouse=True)
def logging_as_before():
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers, root.level = handlers, level


@pytest.fixture
def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


BAD_SETTINGS = {
    "no such file": (
        ["--config", "nowhere.toml"],
        None,
        "nowhere.toml: no such settings",
    ),
    "not TOML": (["--config", "file"], "port = ", "settings (file): "),
    "unknown setting": (["--config", "file"], "prot = 1", "setting prot: "),
    "port beyond": (["--config", "file"], "port = 99999", "setting port: "),
    "open to all": (["--config", "file"], 'host = "0.0.0.0"', "--allow-plain-http"),
    "no machine": (
        ["--config", "file"],
        'machine_file = "none.json"',
        "none.json: cannot be read",
    ),
    "measure on iron": (["--measure"], None, "it needs --simulated"),
    "hidden in iron": (["--hide", "backlash"], None, "it needs --simulated"),
    "hidden unknown": (
        ["--simulated", "--hide", "poltergeist"],
        None,
        "no effect 'poltergeist'",
    ),
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_one_line(name, tmp_path, monkeypatch, capsys):
    arguments, content, said = BAD_SETTINGS[name]
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path("file").write_text(content)
    assert run(["serve", "--data-dir", "data", *arguments]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line.startswith("truepath: ")
    assert said in line


def test_a_port_in_use_is_one_line(free_port, tmp_path, capsys):
    with socket.create_server(("127.0.0.1", free_port)):
        arguments = ["--port", str(free_port), "--data-dir", str(tmp_path / "data")]
        assert run(["serve", *arguments]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert f"cannot listen on 127.0.0.1 port {free_port}" in line


class Lines:
    """Lines of a stream as they come, waited for with a deadline."""

    def __init__(self, stream):
        self.seen = []
        self._queue = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._reader.start()

    def _read(self, stream):
        for line in stream:
            self._queue.put(line)

    def wait_for(self, pattern, timeout_s):
        while True:
            line = self._queue.get(timeout=timeout_s)
            self.seen.append(line)
            if found := re.search(pattern, line):
                return found


@pytest.mark.long
@pytest.mark.timeout(180)
def test_make_run_calibrates_at_once_and_says_where_to_look(tmp_path):
    """The command of `make run`, its device clocks three times faster."""
    service = subprocess.Popen(
        [TRUEPATH, "serve", "--simulated", "--measure", "--port", "0"],
        env=os.environ
        | {"TRUEPATH_DATA_DIR": str(tmp_path), "TRUEPATH_SIMULATED_SPEED": "3"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with service:
        said, progress = Lines(service.stdout), Lines(service.stderr)
        try:
            address = said.wait_for(r"page +(http://127\.0\.0\.1:\d+)/", 30.0)[1]
            progress.wait_for(re.escape(f"watch it at {address}/"), 30.0)
            stands = f"error tables with uncertainties stand at {address}/"
            progress.wait_for(re.escape(stands), TABLES_STAND_S)
            with Client(address) as client:
                (job,) = client.list_jobs()
        finally:
            service.send_signal(signal.SIGTERM)
    assert service.returncode == 0
    assert job["state"] == "succeeded"
    assert job["health"]["samples"] > 40_000
    assert job["health"]["lost_samples"] == 0
    shown = [line for line in progress.seen if " lost" in line]
    assert len(shown) > 8
    assert all(", 0 lost" in line for line in shown)


@contextmanager
def scripted(answers):
    """A service that answers each request of the script: path to (status, bodies)."""
    asked = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            length = int(self.headers.get("Content-Length") or 0)
            body = json.loads(self.rfile.read(length) or b"{}")
            asked.append((self.command, self.path, body, self.headers.get("If-Match")))
            status, bodies = answers[self.path]
            content = bodies.pop(0) if len(bodies) > 1 else bodies[0]
            data = json.dumps(content).encode()
            self.send_response(status)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_POST = do_GET  # noqa: N815

        def log_message(self, *words):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        with Client(f"http://127.0.0.1:{server.server_port}") as client:
            yield client, asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def job(state, **more):
    return {
        "id": "7",
        "state": state,
        "version": 3,
        "stage": "measuring",
        "progress": {"done": 1, "total": 4},
        "health": {"samples": 10, "lost_samples": 0},
        "verdict": None,
        "error": None,
        **more,
    }


PATHS = {
    "/api/v1/machines/current:connect": (200, [{}]),
    "/api/v1/machines": (200, [{"items": [{"id": "mill-1"}, {"id": "mill-2"}]}]),
    "/api/v1/jobs": (202, [job("queued")]),
    "/api/v1/jobs/7/arming": (200, [{"token": "once"}]),
    "/api/v1/jobs/7/arm": (202, [job("running")]),
}


def test_the_first_machine_is_measured_by_arming_the_version_that_was_ready():
    states = [job("preparing"), job("ready", version=5)]
    with scripted({**PATHS, "/api/v1/jobs/7": (200, states)}) as (client, asked):
        assert measure_on_the_fly(client) == "7"
    order = {"kind": "measure-otf", "machine": "mill-1"}
    assert asked[2] == ("POST", "/api/v1/jobs", order, None)
    assert asked[-1] == ("POST", "/api/v1/jobs/7/arm", {"token": "once"}, '"5"')


def test_a_job_that_fails_before_it_is_ready_is_never_armed():
    problem = {"title": "Device", "detail": "the CNC is off", "action": "switch it on"}
    states = [job("failed", error=problem)]
    with (
        scripted({**PATHS, "/api/v1/jobs/7": (200, states)}) as (client, asked),
        pytest.raises(MeasurementFailed, match="failed: the CNC is off; switch it on"),
    ):
        measure_on_the_fly(client)
    assert not [path for _, path, _, _ in asked if path.endswith("/arm")]


def test_progress_is_told_until_the_end():
    told = []
    states = [
        job("running"),
        job("running", progress={"done": 0, "total": 0}),
        job("succeeded"),
    ]
    with scripted({"/api/v1/jobs/7": (200, states)}) as (client, _):
        follow_to_the_end(client, "7", lambda *words: told.append(words))
    assert told[0] == (0.25, "measuring", "10 samples, 0 lost")
    assert told[1][0] == 0.0
    assert len(told) == 3


def test_a_job_that_ends_badly_says_why():
    with (
        scripted({"/api/v1/jobs/7": (200, [job("faulted")])}) as (client, _),
        pytest.raises(MeasurementFailed, match="7 is faulted: no reason was given"),
    ):
        follow_to_the_end(client, "7", lambda *words: None)


def test_a_refusal_is_told_in_the_words_of_its_problem(capsys):
    refusal = {"detail": "the machine is in use", "action": "wait for it"}
    answers = {"/api/v1/machines/current:connect": (409, [refusal])}
    with scripted(answers) as (client, _):
        calibrate(client.address)
    said = capsys.readouterr().err
    assert said == "the main job ended early: the machine is in use; wait for it\n"
