"""Nobody takes the place of a stop by holding connections."""

import resource
import socket
import ssl
import time
from contextlib import ExitStack, suppress

import pytest

from real_services import process
from service_process import begin_moving, follow
from service_with_devices import connect
from serving import serving
from truepath.service.api import connections
from truepath.users.tls import create_certificate

STOP = b"POST /api/v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\n\r\n"
EVENTS = b"GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
UNFINISHED = {
    "nothing": b"",
    "head": b"GET /api/v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Never",
    "body": b"POST /api/v1/jobs HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    b"Content-Type: application/json\r\nContent-Length: 900\r\n\r\n{",
    "unread": b"GET /docs/assets/swagger-ui-bundle.js HTTP/1.1\r\n"
    b"Host: 127.0.0.1\r\n\r\n",
}


def hold(stack, place, begun):
    held = stack.enter_context(socket.socket())
    held.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    held.settimeout(5.0)
    held.connect(place)
    if begun:
        held.sendall(begun)
    return held


def stop(place):
    begun = time.monotonic()
    with socket.create_connection(place, timeout=8.0) as link:
        link.sendall(STOP)
        assert b" 202 " in link.recv(200)
    return time.monotonic() - begun


@pytest.mark.fault_row(45)
@pytest.mark.timeout(180)
def test_a_stop_succeeds_however_many_connections_are_unfinished(tmp_path):
    with process(tmp_path, 128, TRUEPATH_SIMULATED="0") as (_, client):
        place = client.base_url.host, client.base_url.port
        for kind, begun in UNFINISHED.items():
            with ExitStack() as stack:
                for _ in range(180):
                    hold(stack, place, begun)
                assert [stop(place) for _ in range(3)], kind


@pytest.mark.long
@pytest.mark.fault_row(45)
@pytest.mark.timeout(300)
def test_a_machine_is_stopped_among_1400_connections(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))
    with process(tmp_path, 1024) as (_, client), ExitStack() as stack:
        place = client.base_url.host, client.base_url.port
        connect(client)
        job_id = begin_moving(client)
        for _ in range(1400):
            hold(stack, place, UNFINISHED["head"])
        assert stop(place) < 2.0
        follow(client, job_id, "aborted")


@pytest.fixture
def hasty(monkeypatch):
    """Deadlines that a test can wait for, and places for 16 connections."""
    monkeypatch.setattr(connections, "HEAD_S", 0.6)
    monkeypatch.setattr(connections, "BODY_S", 0.6)
    monkeypatch.setattr(connections, "SLOWEST_BYTES_PER_S", 100)
    monkeypatch.setattr(connections, "find_most_connections", lambda _: 16)


def is_ended(link, data, within_s):
    """Send bytes one by one; tell whether the other end had enough in time."""
    end = time.monotonic() + within_s
    link.settimeout(0.05)
    for byte in data:
        if time.monotonic() > end:
            break
        try:
            link.send(bytes([byte]))
            if link.recv(1) == b"":
                return True
        except TimeoutError:
            pass
        except OSError:
            return True
    return False


def test_a_client_has_a_deadline_but_while_its_body_keeps_coming(service, hasty):
    with serving(service) as place:
        with socket.create_connection(place) as link:
            assert is_ended(link, UNFINISHED["head"] + b"x" * 10_000, 8.0)
        with socket.create_connection(place, timeout=8.0) as link:
            link.sendall(UNFINISHED["body"])
            assert link.recv(1) == b""
        with socket.create_connection(place, timeout=8.0) as link:
            link.sendall(UNFINISHED["body"][:-1])
            for _ in range(9):
                link.sendall(b" " * 100)
                time.sleep(0.25)
            assert b" 422 " in link.recv(200)
        with socket.create_connection(place, timeout=8.0) as link:  # a head without end
            link.sendall(b"GET /healthz HTTP/1.1\r\n")
            with pytest.raises((BrokenPipeError, ConnectionResetError)):
                link.sendall((b"X-More: " + b"x" * 4000 + b"\r\n") * 5000)


def test_a_handshake_of_tls_keeps_nobody_out(service, hasty, tmp_path):
    files = create_certificate(["127.0.0.1"], tmp_path, 2)
    with serving(service, tls=files) as place, ExitStack() as stack:
        held = [hold(stack, place, b"") for _ in range(40)]
        trust = ssl.create_default_context(cafile=files.cert)
        with (
            socket.create_connection(place, timeout=8.0) as link,
            trust.wrap_socket(link, server_hostname="127.0.0.1") as safe,
        ):
            safe.sendall(STOP)
            assert b" 202 " in safe.recv(200)
        assert {one.recv(1) for one in held} == {b""}


def test_one_address_leaves_half_of_the_places_to_others(service, hasty, monkeypatch):
    monkeypatch.setattr(connections, "HEAD_S", 60.0)
    with serving(service) as place, ExitStack() as stack:
        for _ in range(40):
            way = ("127.0.0.2", 0)
            stack.enter_context(socket.create_connection(place, source_address=way))
        other = hold(stack, place, b"GET /healthz HTTP/1.1\r\n")
        for _ in range(40):
            stack.enter_context(socket.create_connection(place, source_address=way))
        other.sendall(b"Host: 127.0.0.1\r\n\r\n")
        assert b" 200 " in other.recv(200)


def test_a_stream_outlives_those_who_do_not_get_on(service, hasty):
    with serving(service) as place, ExitStack() as stack:
        stream = hold(stack, place, EVENTS)
        assert b" 200 " in stream.recv(4000)
        for _ in range(60):
            hold(stack, place, UNFINISHED["head"])
        assert stop(place) < 8.0
        time.sleep(1.0)
        stream.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                assert stream.recv(10_000), "closed"
