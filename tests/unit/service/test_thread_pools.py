"""What stops a machine, while every thread of other requests is taken."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import anyio
import pytest
import uvicorn
from anyio.to_thread import current_default_thread_limiter
from starlette.testclient import TestClient

from scripted_cell import wait_until
from truepath.service.api.application import create_application
from truepath.service.api.server import Server
from truepath.users.roles import Role

PATIENCE_S = 5.0


async def take_every_thread():
    """Take the threads that routes share; return who has them."""
    limiter = current_default_thread_limiter()
    takers = [object() for _ in range(int(limiter.available_tokens))]
    for taker in takers:
        limiter.acquire_on_behalf_of_nowait(taker)
    return takers


async def give_back(takers):
    for taker in takers:
        current_default_thread_limiter().release_on_behalf_of(taker)


def post_within(client, address):
    """Send a request that nothing else may hold up; return its answer."""
    answers = []
    sender = threading.Thread(target=lambda: answers.append(client.post(address)))
    sender.start()
    sender.join(PATIENCE_S)
    assert answers, f"{address} waits for the threads of other requests"
    return answers[0]


@pytest.fixture
def client(service, access):
    """Overrides the client: an operator, where everybody logs in."""
    access.accounts.add("ben", Role.OPERATOR, "a long sentence is easy")
    app = create_application(replace(service, access=access))
    own = {"Authorization": f"Bearer {access.tokens.open_session('ben')}"}
    with TestClient(app, base_url="https://127.0.0.1:8411", headers=own) as client:
        yield client


@pytest.mark.parametrize("verb", ["pause", "abort"])
def test_pause_and_abort_reach_the_machine_with_every_other_thread_taken(
    client, armed, make_cell, verb
):
    takers = client.portal.call(take_every_thread)
    try:
        answer = post_within(client, f"/api/v1/jobs/{armed['id']}/{verb}")
    finally:
        client.portal.call(give_back, takers)
    assert answer.status_code == 202
    wait_until(lambda: verb in make_cell.cell.heard, f"the cell hears {verb}")


def test_the_feed_is_held_at_the_end_with_every_other_thread_taken(monkeypatch):
    held = threading.Event()
    service = SimpleNamespace(
        dispatcher=SimpleNamespace(close=held.set),
        end_streams=lambda: None,
        max_streams=1,
    )

    async def end_at_once(*_):
        assert held.is_set()

    monkeypatch.setattr(uvicorn.Server, "shutdown", end_at_once)
    server = Server(lambda: None, service, "http://127.0.0.1:8411", None)

    async def end():
        await take_every_thread()
        with anyio.fail_after(PATIENCE_S):
            await server.shutdown()

    anyio.run(end)
