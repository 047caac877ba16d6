"""A stop comes through from anywhere; what is told or changed comes from this site."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from dataclasses import replace

import pytest
from scripted_cell import wait_until
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.service.api.application import create_application
from truepath.service.page import pages
from truepath.users.access import Access, AccessRules
from truepath.users.roles import Role

API = "/api/v1"
ELSEWHERE = {"origin": "http://evil.example", "sec-fetch-site": "cross-site"}
MEGABYTE = b"x" * (1 << 20)


def socket_of(client, path):
    """The address of a WebSocket of the service that a client asks."""
    return str(client.base_url).replace("http", "ws", 1).rstrip("/") + API + path


def send_bytes(count):
    yield from (MEGABYTE for _ in range(count))


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
        {"behind": "/"},
        {"before": "/"},
        {"before": "/cell-7", "behind": "//"},
    ],
    ids=str,
)
def test_a_stop_is_taken_whoever_sends_it_and_however(client, armed, until, odd):
    place = str(client.base_url).rstrip("/") + odd.get("before", "")
    sent = {key: odd[key] for key in ("headers", "content", "files") if key in odd}
    for verb in (f"/jobs/{armed['id']}/abort", "/machines/default/stop", "/stop"):
        path = f"{place}{API}{verb}{odd.get('behind', '')}"
        answer = client.post(path, follow_redirects=False, **sent)
        assert answer.status_code == 202, answer.text
    until(armed, "aborted")


@pytest.mark.fault_row(47)
def test_a_check_goes_the_way_of_a_stop_and_stops_nothing(client, armed, service):
    for path in ("/stop:check", "/machines/default/stop:check/"):
        answer = client.post(
            API + path, headers={"host": "a", **ELSEWHERE}, content="x"
        )
        assert answer.status_code == 200, answer.text
        assert [one["machine"] for one in answer.json()["machines"]] == ["default"]
    assert client.get(f"{API}/jobs/{armed['id']}").json()["state"] == "running"
    service.access.close()
    told = [row.entry.what for row in service.access.audit_log.read()]
    assert not [what for what in told if "check" in what]


@pytest.mark.fault_row(46)
@pytest.mark.fault_row(47)
@pytest.mark.parametrize("headers", [{}, ELSEWHERE, {"Host": "evil.example"}])
@pytest.mark.parametrize("word", ["stop", "", "checks", b"\x00"])
def test_every_message_of_the_open_channel_is_a_stop(live, service, headers, word):
    running = service.store.create(Job(JobKind.ANALYSE))[0]
    with connect(socket_of(live, "/stop"), additional_headers=headers) as channel:
        channel.send("check")
        assert json.loads(channel.recv(timeout=10)) == {
            "jobs": [],
            "machines": [{"machine": "default", "stopped": "unknown"}],
        }
        assert service.store.get(running.id).state == "queued"
        channel.send(word)
        stopped = json.loads(channel.recv(timeout=10))
    assert [one["machine"] for one in stopped["machines"]] == ["default"]
    service.access.close()
    told = [row.entry.what for row in service.access.audit_log.read()]
    assert told == [f"POST {API}/stop"]


def test_a_channel_too_many_takes_the_place_of_the_oldest(live, monkeypatch):
    monkeypatch.setattr("truepath.service.api.routes.stopping.MOST_CHANNELS", 1)
    with connect(socket_of(live, "/stop")) as old:
        old.send("check")
        old.recv(timeout=10)
        with connect(socket_of(live, "/stop/")) as new:
            new.send("check")
            assert "machines" in new.recv(timeout=10)
            with pytest.raises(ConnectionClosed, match="1013"):
                old.recv(timeout=10)


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
    ],
)
def test_a_page_of_another_site_is_told_of_nothing_that_happens(
    live, service, is_problem, headers
):
    job = service.store.create(Job(JobKind.ANALYSE))[0]
    for path in ("/events", f"/jobs/{job.id}/events"):
        with live.stream("GET", API + path, headers=headers) as answer:
            assert answer.status_code == 403
            answer.read()
            is_problem(answer, 403, "cross-site")
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(socket_of(live, "/events"), additional_headers=headers),
    ):
        pass


def test_every_stream_is_guarded():
    document = create_application().openapi()
    streams = {
        path
        for path, operations in document["paths"].items()
        for answer in operations.get("get", {}).get("responses", {}).values()
        if "text/event-stream" in answer.get("content", {})
    }
    assert streams == {f"{API}/events", f"{API}/jobs/{{job_id}}/events"}


def test_events_come_over_a_web_socket_as_in_a_stream(live, service):
    def read(query):
        with connect(socket_of(live, f"/events{query}")) as socket:
            while True:
                event = json.loads(socket.recv(timeout=10))
                yield event
                if event["event"] == "tick":
                    return

    job = service.store.create(Job(JobKind.ANALYSE))[0]
    now, tick = read("")
    assert (now["event"], now["data"]["id"], now["id"]) == ("job", job.id, "1")
    service.store.change(job.id, lambda known: replace(known, state=State.RUNNING))
    missed, _ = read(f"?last_event_id={tick['data']['last_event_id']}")
    assert (missed["id"], missed["data"]["state"]) == ("2", "running")
    for refused in ("?topics=nonsense", "?topics=job:nobody"):
        with pytest.raises(InvalidStatus, match="422"):
            next(read(refused))


@pytest.fixture
def with_users(service, live, monkeypatch):
    """A viewer who has logged in; returns the headers that tell so."""
    access = Access(service.database, AccessRules(log_in_required=True))
    monkeypatch.setattr(
        "truepath.users.accounts.hash_password", lambda password: password
    )
    access.accounts.add("ada", Role.ADMINISTRATOR, "a long sentence is easy")
    access.accounts.add("vera", Role.VIEWER, "a long sentence is easy")
    monkeypatch.setattr(service.access, "rules", access.rules)
    yield {"Authorization": f"Bearer {access.tokens.open_session('vera')}"}
    access.close()


def test_the_stream_of_a_removed_user_ends_within_a_second(live, service, with_users):
    with live.stream("GET", f"{API}/events", headers=with_users) as answer:
        lines = answer.iter_lines()
        for _ in range(2):  # the session was asked for just now
            next(line for line in lines if line == "event: tick")
        service.access.accounts.remove("vera")
        begun_s = time.monotonic()
        for _ in lines:
            pass
        assert time.monotonic() - begun_s < 0.9


@pytest.mark.parametrize("path", ["/events", "/machines/current/live"])
def test_a_socket_of_a_removed_user_ends_within_a_second(
    live, service, with_users, path
):
    with connect(socket_of(live, path), additional_headers=with_users) as socket:
        time.sleep(0.2)
        service.access.accounts.remove("vera")
        begun_s = time.monotonic()
        with suppress(ConnectionClosed):
            while time.monotonic() - begun_s < 5:
                socket.recv(timeout=5)
    assert time.monotonic() - begun_s < 0.9


PROXY = "192.0.2.7"


def behind(service, *, peer=PROXY, **setup):
    """A client of the service as it is asked by a proxy."""
    app = create_application(
        service, pages=pages.router, trusted_proxies=(PROXY,), **setup
    )
    app.mount(pages.STATIC_PATH, pages.static_files(), name="static")
    return TestClient(app, base_url="http://127.0.0.1:8411", client=(peer, 5000))


@pytest.mark.fault_row(47)
@pytest.mark.parametrize("is_cut_off", [True, False])
@pytest.mark.parametrize("root", ["/truepath", "/api", "/docs/a.b"])
def test_every_address_is_below_the_path_at_which_a_proxy_shows_the_service(
    service, order, root, is_cut_off
):
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
        listed = client.get(f"{before}{API}/jobs?limit=1").headers.get("link", "")
        assert f"<{root}{API}/" in f"<{root}{API}/{listed}"
        wait_until(lambda: client.post(f"{before}{API}/stop").status_code == 202)
        with client.websocket_connect(f"{before}{API}/stop") as channel:
            channel.send_text("check")
            assert "machines" in channel.receive_json()


@pytest.mark.fault_row(47)
@pytest.mark.parametrize(
    ("peer", "named", "shown"),
    [
        (PROXY, "/cell-7", "/cell-7/"),
        (PROXY, "/cell-7/", "/cell-7/"),
        (PROXY, "//evil.example", ""),
        (PROXY, '/"><script>', ""),
        (PROXY, "https://evil.example", ""),
        ("192.0.2.8", "/cell-7", ""),
    ],
)
def test_a_prefix_counts_if_a_trusted_proxy_names_one(service, peer, named, shown):
    with behind(service, peer=peer) as client:
        page = client.get("/", headers={"x-forwarded-prefix": named}).text
        assert f'action="{shown}api/v1/stop"' in page


def test_who_is_not_logged_in_can_stop_by_the_channel_and_hear_nothing(
    service, monkeypatch
):
    access = Access(service.database, AccessRules(log_in_required=True))
    app = create_application(replace(service, access=access))
    with TestClient(app, base_url="http://localhost") as client:
        with client.websocket_connect(f"{API}/stop") as channel:
            channel.send_text("stop")
            assert channel.receive_json()["jobs"] == []
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect(f"{API}/events"),
        ):
            pass
    access.close()
