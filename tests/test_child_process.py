"""Children in real processes. Their bodies live in a module that they can import."""

from __future__ import annotations

import io
import json
import logging
import os
import sys

import pytest
import structlog

from truepath.app.child_process import ChildProcess
from truepath.app.service_log import configure_log

BODIES = """
import logging, os, time
import structlog
from truepath.app.child_process import ChildProcess

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
def service_log(monkeypatch):
    """The service's log at level info, as JSON lines; put back afterwards."""
    root = logging.getLogger()
    handlers, level = root.handlers, root.level
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    configure_log("info", "json")
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    structlog.reset_defaults()
    root.handlers = handlers
    root.setLevel(level)


def run_to_its_end(body, name="cell"):
    child = ChildProcess(name, body)
    child.start()
    child.join()
    child.close()


def test_the_info_lines_of_a_child_are_in_the_log_with_its_name(bodies, service_log):
    run_to_its_end(bodies.log_lines)
    connected, part, failed = service_log()
    assert (connected["event"], connected["level"]) == ("connected to COM3", "info")
    assert (part["event"], part["rows"]) == ("further part", 3)
    assert "ValueError: a defect" in failed["exception"]
    assert {line["process"] for line in (connected, part, failed)} == {"cell"}


def test_the_lines_of_a_childs_child_are_in_the_log_too(bodies, service_log):
    run_to_its_end(bodies.have_a_child)
    assert {line["process"] for line in service_log()} == {"grandchild"}
    assert len(service_log()) == 3


@pytest.mark.parametrize(
    ("limits", "threads"),
    [
        ({}, "1"),
        ({"OPENBLAS_NUM_THREADS": "8"}, "8"),
        ({"OMP_NUM_THREADS": "4,2"}, "4"),
        ({"OMP_NUM_THREADS": "4", "OPENBLAS_NUM_THREADS": "2"}, "2"),
    ],
)
def test_a_child_computes_on_one_thread_or_on_as_many_as_the_user_has_set(
    bodies, monkeypatch, limits, threads
):
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
    child.start()
    assert child.link.recv() == child.process_id
    child.close()
    child.close()
    assert not child.alive
    assert child.exit_code == -9


def test_a_child_that_was_never_started_is_closed_without_a_word():
    child = ChildProcess("worker", print)
    assert not child.alive
    child.close()
