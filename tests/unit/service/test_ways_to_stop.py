"""A stop comes through from anywhere, while all else waits, and whoever sends it."""

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
from truepath.service.page import pages
from truepath.users.roles import Role

API = "/api/v1"
ELSEWHERE = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}
MEGABYTE = b"x" * (1 << 20)
PROXY = "192.0.2.7"


@pytest.mark.fault_row(47)
@pytest.mark.parametrize(
    "odd",
    [
        {"headers": ELSEWHERE},
        {"headers": {"origin": "null"}},
        {"headers": {"host": "evil.example"}},
        {"headers": {"host": "truepath_upstream", **ELSEWHERE}},
        {"headers": {"host": ""}},
        {"content": MEGABYTE + b"x", "headers": {"content-type": "text/plain"}},
        {"content": b"{", "headers": {"content-type": "application/json; x=="}},
        {"content": [MEGABYTE, MEGABYTE]},
        {"files": {"bundle": ("a.zip", b"PK")}},
        {"data": {"why": "no script runs"}},
        {"behind": "/"},
        {"before": "/"},
        {"before": "/cell-7", "behind": "//"},
    ],
    ids=str,
)
def test_a_stop_is_taken_whoever_sends_it_and_however(client, armed, until, odd):
    place = str(client.base_url).rstrip("/") + odd.get("before", "")
    sent = {k: v for k, v in odd.items() if k not in ("before", "behind")}
    for verb in (f"/jobs/{armed['id']}/abort", "/machines/default/stop", "/stop"):
        path = f"{place}{API}{verb}{odd.get('behind', '')}"
        answer = client.post(path, follow_redirects=False, **sent)
        assert answer.status_code == 202, answer.text
    until(armed, "aborted")


@pytest.mark.fault_row(47)
def test_a_check_goes_the_way_of_a_stop_and_stops_nothing(client, armed, service):
    for path in ("/stop:check", "/machines/default/stop:check/"):
        odd = {"headers": {"host": "a", **ELSEWHERE}, "content": "x"}
        answer = client.post(API + path, **odd)
        assert answer.status_code == 200, answer.text
        assert [one["machine"] for one in answer.json()["machines"]] == ["default"]
    assert client.get(f"{API}/jobs/{armed['id']}").json()["state"] == "running"
    service.access.close()
    told = [row.entry.what for row in service.access.audit_log.read()]
    assert not [what for what in told if "check" in what]


def behind(service, *, peer=PROXY, **setup):
    setup |= {"pages": pages.router, "trusted_proxies": (PROXY,)}
    app = create_application(service, **setup)
    app.mount(pages.STATIC_PATH, pages.static_files(), name="static")
    return TestClient(app, base_url="http://127.0.0.1:8411", client=(peer, 5000))


@pytest.mark.fault_row(47)
@pytest.mark.parametrize("is_cut_off", [True, False])
@pytest.mark.parametrize("root", ["/truepath", "/api", "/docs/a.b"])
def test_every_address_is_below_the_path_of_a_proxy(service, order, root, is_cut_off):
    before = "" if is_cut_off else root
    with behind(service, root_path=root) as client:
        page = client.get(f"{before}/").text
        assert f'action="{root}{API}/stop"' in page
        assert f'src="{root}/static/' in page
        assert client.get(f"{before}/static/icons.svg").status_code == 200
        made = client.post(f"{before}{API}/jobs", json=order)
        assert made.status_code == 202
        address = made.headers["location"]
        assert address == f"{root}{API}/jobs/{made.json()['id']}"
        job = client.get(before + address.removeprefix(root)).json()
        assert job["links"]["self"] == address
        wait_until(lambda: client.post(f"{before}{API}/stop").status_code == 202)
        with client.websocket_connect(f"{before}{API}/stop") as channel:
            channel.send_text("check")
            assert "machines" in channel.receive_json()


@pytest.mark.fault_row(47)
@pytest.mark.parametrize(
    ("peer", "named", "shown"),
    [
        *((PROXY, named, "/cell-7/") for named in ("/cell-7", "/cell-7/")),
        *((PROXY, named, "") for named in ("//a.b", '/"><script>', "https://a.b")),
        ("192.0.2.8", "/cell-7", ""),
    ],
)
def test_a_prefix_counts_if_a_trusted_proxy_names_one(service, peer, named, shown):
    with behind(service, peer=peer) as client:
        page = client.get("/", headers={"x-forwarded-prefix": named}).text
        assert f'action="{shown}api/v1/stop"' in page


def test_who_is_not_logged_in_can_stop_by_the_channel(service, access):
    app = create_application(replace(service, access=access))
    with (
        TestClient(app, base_url="http://localhost") as client,
        client.websocket_connect(f"{API}/stop") as channel,
    ):
        channel.send_text("stop")
        assert channel.receive_json()["jobs"] == []


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


@pytest.fixture
def operator(service, access):
    access.accounts.add("ben", Role.OPERATOR, "a long sentence is easy")
    own = {"Authorization": f"Bearer {access.tokens.open_session('ben')}"}
    app = create_application(replace(service, access=access))
    with TestClient(app, base_url="https://127.0.0.1:8411", headers=own) as client:
        yield client


@pytest.mark.parametrize("verb", ["/jobs/{id}/pause", "/jobs/{id}/abort", "/stop"])
def test_a_stop_arrives_with_every_thread_taken(operator, armed, make_cell, verb):
    takers, answers = operator.portal.call(take_every_thread), []
    address = API + verb.format(id=armed["id"])
    sender = threading.Thread(target=lambda: answers.append(operator.post(address)))
    sender.start()
    sender.join(PATIENCE_S)
    try:
        assert answers, f"{address} waits for the threads of other requests"
    finally:
        operator.portal.call(give_back, takers)
    assert answers[0].status_code == 202
    heard = "pause" if verb.endswith("pause") else "abort"
    wait_until(lambda: heard in make_cell.cell.heard, f"the cell hears {heard}")


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
