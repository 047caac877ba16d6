"""Children in real processes. Their bodies live in a module that they can import."""

import io
import json
import logging
import os
import sys

import pytest
import structlog

from truepath.child_process import ChildProcess
from truepath.errors import BadInput
from truepath.service_log import LogFile, configure_log

BODIES = """
import logging, os, time
import structlog
from truepath.child_process import ChildProcess

def log_lines(link):
    logging.getLogger("driver").info("connected to %s", "COM3")
    structlog.get_logger("job").info("further part", rows=3)
    try:
        raise ValueError("a defect")
    except ValueError:
        logging.getLogger("driver").exception("it failed")

def have_a_child(link):
    child = ChildProcess("grandchild", log_lines)
    child.start()
    child.join()
    child.close()

def log_many(count, link):
    for number in range(count):
        logging.getLogger("driver").info("line %d", number)

def tell_threads(link):
    link.send(os.environ["OPENBLAS_NUM_THREADS"])

def sleep(link):
    link.send(os.getpid())
    time.sleep(60)
"""


@pytest.fixture(scope="module")
def bodies(import_code):
    return import_code("child_bodies", BODIES)


@pytest.fixture
def root_log():
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    yield
    for handler in root.handlers:
        handler.close()
    structlog.reset_defaults()
    root.handlers = handlers
    root.setLevel(level)


@pytest.fixture
def service_log(monkeypatch, root_log):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    configure_log("info", "json")
    return lambda: [json.loads(line) for line in stream.getvalue().splitlines()]


def test_requests_of_our_own_client_are_not_a_line_each(service_log):
    logging.getLogger("httpx2").info("HTTP Request: GET /api/v1/jobs")
    logging.getLogger("httpx2").warning("connection lost")
    assert [line["event"] for line in service_log()] == ["connection lost"]


def run_to_its_end(body, name="cell"):
    child = ChildProcess(name, body)
    child.start()
    child.join()
    child.close()


def test_lines_of_a_child_and_its_child_are_in_the_log_by_name(bodies, service_log):
    run_to_its_end(bodies.log_lines)
    connected, part, failed = service_log()
    assert (connected["event"], connected["level"]) == ("connected to COM3", "info")
    assert (part["event"], part["rows"]) == ("further part", 3)
    assert "ValueError: a defect" in failed["exception"]
    assert {line["process"] for line in (connected, part, failed)} == {"cell"}
    run_to_its_end(bodies.have_a_child)
    assert [line["process"] for line in service_log()[3:]] == ["grandchild"] * 3


@pytest.mark.parametrize(
    ("limits", "threads"),
    [
        ({}, "1"),
        ({"OPENBLAS_NUM_THREADS": "8"}, "8"),
        ({"OMP_NUM_THREADS": "4,2"}, "4"),
        ({"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "2"}, "2"),
    ],
)
def test_a_child_computes_on_one_thread_or_as_set(bodies, monkeypatch, limits, threads):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    for name, number in limits.items():
        monkeypatch.setenv(name, number)
    child = ChildProcess("worker", bodies.tell_threads)
    child.start()
    assert child.link.recv() == threads
    child.close()
    assert {name: os.environ.get(name) for name in limits} == limits


def test_closing_ends_a_child_whatever_it_does(bodies):
    child = ChildProcess("worker", bodies.sleep)
    assert not child.alive
    child.start()
    assert child.link.recv() == child.process_id
    child.close()
    child.close()
    assert not child.alive
    assert child.exit_code == -9
    ChildProcess("never started", bodies.sleep).close()


def test_no_line_is_lost_as_processes_fill_file_after_file(bodies, tmp_path, root_log):
    file = LogFile(tmp_path / "logs" / "service.log", max_bytes=20_000, count=50)
    configure_log("info", "json", file)
    children = [ChildProcess(f"writer{n}", bodies.log_many, 200) for n in range(3)]
    for child in children:
        child.start()
    for number in range(200):
        logging.getLogger("parent").info("line %d", number)
    for child in children:
        child.join()
        child.close()
    files = file.list_files()
    assert len(files) > 3, "it was to be set aside several times"
    assert all(one.stat().st_size <= file.max_bytes for one in files)
    lines = [json.loads(x) for one in files for x in one.read_text().splitlines()]
    by_writer = {}
    for line in lines:
        if line["event"].startswith("line "):
            by_writer.setdefault(line.get("process"), []).append(line["event"])
    assert set(by_writer) == {None, "writer0", "writer1", "writer2"}
    for found in by_writer.values():
        assert sorted(found) == sorted(f"line {n}" for n in range(200))


def test_few_log_files_are_kept_and_one_without_a_place_is_named(tmp_path, root_log):
    file = LogFile(tmp_path / "service.log", max_bytes=500, count=2)
    configure_log("info", "json", file)
    for number in range(50):
        logging.getLogger("parent").info("line %d", number)
    names = {one.name for one in tmp_path.iterdir()}
    assert names == {"service.log", "service.log.1", "service.log.2"}
    assert "line 49" in file.list_files()[0].read_text()
    (tmp_path / "file").write_text("")
    file = LogFile(tmp_path / "file" / "service.log", max_bytes=500, count=2)
    with pytest.raises(BadInput, match=r"setting log_file: .*service\.log"):
        configure_log("info", "json", file)
