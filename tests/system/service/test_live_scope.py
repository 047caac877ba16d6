"""Every sample over a real WebSocket: frames, slow clients, and who may look."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from scripted_cell import wait_until
from truepath.machines.sample_feed import CHUNK, CHUNKS, SampleFeed
from truepath.measurement.messages import BlockRecorded
from truepath.service.api.application import create_application
from truepath.service.api.live_scope import open_scopes
from truepath.users.roles import Role
from truepath_drivers.interfaces.records import TrackerSamples

HOST = {"host": "127.0.0.1:8411"}
PATH = "/api/v1/machines/{}/live"


def make_samples(first, count):
    number = np.arange(first, first + count)
    position_mm = number[:, None] * np.array([1.0, 0.5, -2.0])
    status = np.where(number % 10 == 9, 300, 0)
    return TrackerSamples(number, number / 500.0, position_mm, status)


@pytest.fixture
def address(live):
    """Where the scope of the machine is."""
    host = str(live.base_url).removeprefix("http://").rstrip("/")
    return f"ws://{host}" + PATH.format("current")


def decode(frame):
    """Read a frame as the document describes it, without code of the service."""
    magic, version, count, dropped = struct.unpack_from("<4sHHI", frame)
    assert (magic, version, len(frame)) == (b"TPLV", 1, 12 + 33 * count)
    rows = [struct.unpack_from("<4dB", frame, 12 + 33 * k) for k in range(count)]
    return rows, dropped


def test_every_recorded_sample_comes_in_small_frames(address, service, make_cell):
    with connect(address) as socket:
        feed = service.machines.first.cell.samples
        wait_until(lambda: feed._queues, "the subscription")
        make_cell.cell.say(BlockRecorded(make_samples(0, 50)))
        frames = [decode(socket.recv(timeout=20)) for _ in range(3)]
    assert [len(rows) for rows, _ in frames] == [20, 20, 10]
    assert {dropped for _, dropped in frames} == {0}
    rows = [row for rows, _ in frames for row in rows]
    assert rows[7] == (7 / 500.0, 7.0, 3.5, -14.0, 0)
    assert [row[4] for row in rows] == [255 if n % 10 == 9 else 0 for n in range(50)]
    wait_until(lambda: not feed._queues, "the end of the subscription")


@pytest.mark.fault_row(32)
def test_who_is_slow_loses_the_oldest_and_is_told_how_many():
    feed = SampleFeed()
    slow, quick = feed.subscribe(lambda: None), feed.subscribe(lambda: None)
    taken = []
    for block in range(CHUNKS + 7):
        feed.publish(make_samples(block * CHUNK, CHUNK))
        taken.append(quick.take())
    assert [chunk.sequence[0] // CHUNK for chunk, _ in taken] == [*range(CHUNKS + 7)]
    chunk, dropped = slow.take()
    assert (chunk.sequence[0], dropped) == (7 * CHUNK, 7 * CHUNK)
    assert quick.take() == (None, 0)


def test_neither_a_page_of_another_site_nor_an_unknown_machine_has_a_scope(
    address, service
):
    for place, headers in (
        (address, {"Origin": "http://evil.example"}),
        (address, {"Sec-Fetch-Site": "cross-site"}),
        (address.replace("current", "nobody"), {}),
    ):
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(place, additional_headers=headers),
        ):
            pass
    assert not service.machines.first.cell.samples._queues


def test_the_scope_ends_with_the_service(address, service):
    with connect(address) as socket:
        service.end_streams()
        with pytest.raises(Exception, match="1001"):
            socket.recv(timeout=20)


@pytest.mark.parametrize("path", [PATH.format("current"), PATH.format("default")])
def test_a_socket_needs_a_session(service, access, path):
    access.accounts.add("viewer", Role.VIEWER, "a long sentence is easy")
    token = access.tokens.open_session("viewer")
    app = create_application(replace(service, access=access))
    with TestClient(app) as client:
        for known in ({}, {"Authorization": "Bearer wrong"}):
            with (
                pytest.raises(WebSocketDisconnect),
                client.websocket_connect(path, headers=HOST | known),
            ):
                pass
        let_in = HOST | {"Authorization": f"Bearer {token}"}
        with client.websocket_connect(path, headers=let_in):
            access.tokens.end(token)
            wait_until(lambda: not open_scopes, "the end of the view")
