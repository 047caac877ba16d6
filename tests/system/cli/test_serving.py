"""`serve`: settings that cannot work are one line; `--measure` is the main job."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from answers_in_turn import Script, answer
from truepath.cli import calibration
from truepath.client import Client
from truepath.errors import MeasurementFailed

TRUEPATH = Path(sys.executable).with_name("truepath")


@pytest.fixture(autouse=True)
def no_settings_of_this_computer(monkeypatch, tmp_path):
    for name in list(os.environ):
        if name.startswith("TRUEPATH_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.mark.parametrize(
    ("words", "text", "said"),
    [
        (["--config", "nowhere.toml"], None, "nowhere.toml: no such settings"),
        (["--config", "file"], "port = ", "settings (file): "),
        (["--config", "file"], "prot = 1", "setting prot: "),
        (["--config", "file"], "port = 99999", "setting port: "),
        (["--config", "file"], 'host = "0.0.0.0"', "--allow-plain-http"),
        (["--config", "file"], 'machine_file = "no.json"', "no.json: cannot be read"),
        (["--measure"], None, "it needs --simulated"),
        (["--hide", "backlash"], None, "it needs --simulated"),
        (["--simulated", "--hide", "poltergeist"], None, "no effect 'poltergeist'"),
    ],
)
def test_bad_settings_are_one_line(words, text, said, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if text is not None:
        Path("file").write_text(text)
    assert said in command.refuse("serve", "--data-dir", "data", *words)


def test_a_port_in_use_is_one_line(command, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        order = ["serve", "--port", port, "--data-dir", tmp_path / "data"]
        said = command.refuse(*order)
    assert f"cannot listen on 127.0.0.1 port {port}" in said


def read_until(pattern, stream, seen=None):
    for line in stream:
        if seen is not None:
            seen.append(line)
        if found := re.search(pattern, line):
            return found
    raise AssertionError(f"{pattern} was never said")


@pytest.mark.long
@pytest.mark.timeout(180)
def test_make_run_calibrates_at_once_and_says_where_to_look(tmp_path):
    """The command of `make run`, its device clocks three times faster."""
    words = [TRUEPATH, "serve", "--simulated", "--measure", "--port", "0"]
    own = {"TRUEPATH_DATA_DIR": str(tmp_path), "TRUEPATH_SIMULATED_SPEED": "3"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    service = subprocess.Popen(words, env=os.environ | own, **pipes)
    progress, said = service.stderr, []
    with service:
        try:
            page = r"page +(http://127\.0\.0\.1:\d+)/"
            address = read_until(page, service.stdout)[1]
            read_until(re.escape(f"watch it at {address}/"), progress)
            stands = f"error tables with uncertainties stand at {address}/"
            read_until(re.escape(stands), progress, said)
            with Client(address) as client:
                (job,) = client.list_jobs()
        finally:
            service.send_signal(signal.SIGTERM)
    assert (service.returncode, job["state"]) == (0, "succeeded")
    assert job["health"]["samples"] > 40_000
    assert job["health"]["lost_samples"] == 0
    shown = [line for line in said if " lost" in line]
    assert len(shown) > 8
    assert all(", 0 lost" in line for line in shown)


def job(state, **more):
    known = {"id": "7", "state": state, "version": 3, "stage": "measuring"}
    known |= {"progress": {"done": 1, "total": 4}, "verdict": None, "error": None}
    return {**known, "health": {"samples": 10, "lost_samples": 0}, **more}


def in_turn(*told):
    return Script(*[answer(200, one) for one in told])


def measured(*states):
    """The answers to an order of the first machine, whose job has these states."""
    machines = {"items": [{"id": "mill-1"}, {"id": "mill-2"}]}
    armed = {"token": "once"}, job("armed")
    return in_turn({}, machines, job("queued"), *states, *armed)


def test_the_first_machine_is_measured_by_arming_the_version_that_was_ready():
    script = measured(job("preparing"), job("ready", version=5))
    with script.open() as client:
        assert calibration.measure_on_the_fly(client) == "7"
    *_, order, _, _, _, arm = script.requests
    assert (order.method, order.url.path) == ("POST", "/api/v1/jobs")
    assert json.loads(order.content) == {"kind": "measure-otf", "machine": "mill-1"}
    assert (arm.method, arm.url.path) == ("POST", "/api/v1/jobs/7/arm")
    assert (arm.content, arm.headers["If-Match"]) == (b'{"token":"once"}', '"5"')


def test_a_job_that_fails_before_it_is_ready_is_never_armed():
    problem = {"title": "Device", "detail": "the CNC is off", "action": "switch it on"}
    script = measured(job("failed", error=problem))
    said = "failed: the CNC is off; switch it on"
    with script.open() as client, pytest.raises(MeasurementFailed, match=said):
        calibration.measure_on_the_fly(client)
    assert len(script.requests) == 4, "nothing after its state"


def test_progress_is_told_until_the_end():
    nothing, told = {"done": 0, "total": 0}, Mock()
    states = job("running"), job("running", progress=nothing), job("succeeded")
    with in_turn(*states).open() as client:
        calibration.follow_to_the_end(client, "7", told)
    first, second, _ = (call.args for call in told.call_args_list)
    assert first == (0.25, "measuring", "10 samples, 0 lost")
    assert second[0] == 0.0


def test_a_job_that_ends_badly_says_why():
    said, faulted = "7 is faulted: no reason was given", in_turn(job("faulted"))
    with faulted.open() as client, pytest.raises(MeasurementFailed, match=said):
        calibration.follow_to_the_end(client, "7", lambda *words: None)


def test_a_refusal_is_told_in_the_words_of_its_problem(monkeypatch, capsys):
    refused = {"detail": "the machine is in use", "action": "wait for it"}
    monkeypatch.setattr(calibration, "Client", Script(answer(409, refused)).open)
    calibration.calibrate("http://mill")
    said = capsys.readouterr().err
    assert said == "the main job ended early: the machine is in use; wait for it\n"
