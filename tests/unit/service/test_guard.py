"""What stands before every route, and from whom a request comes."""

from dataclasses import replace

import pytest
from starlette.testclient import TestClient

from truepath.service.api.application import create_application
from truepath.users.roles import Role


def test_the_service_answers_to_its_names_and_to_none_that_somebody_points_here(
    client, is_problem
):
    own = "localhost", "localhost:8411", "127.0.0.1", "[::1]:8411", "10.0.0.9"
    for host in (*own, "shop-floor", "SHOP-FLOOR:80", "localhost."):
        assert client.get("/healthz", headers={"host": host}).status_code == 200
    for host in ("evil.example", "evil.example:8411", "", "[::1", "a b"):
        is_problem(client.get("/healthz", headers={"host": host}), 421, "host")


def test_a_page_of_another_site_can_change_nothing_and_the_own_page_can(
    client, ready, is_problem, make_cell
):
    job = f"/api/v1/jobs/{ready['id']}"
    for headers in (
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
    ):
        for verb in ("", f"{job}/arm", f"{job}/arm/", f"{job}/arm/api/v1/arm"):
            answer = client.post(verb or "/api/v1/jobs", headers=headers)
            is_problem(answer, 403, "cross-site")
        assert client.get("/api/v1/system", headers=headers).status_code == 200
    assert make_cell.cell.heard == ["connect"]
    own = "http://127.0.0.1:8411"
    for headers in (
        {},
        {"sec-fetch-site": "same-origin", "origin": own},
        {"sec-fetch-site": "none"},
        {"origin": own},
    ):
        answer = client.post("/api/v1/machines/current:connect", headers=headers)
        assert answer.status_code == 200


def test_every_answer_has_the_headers_that_keep_browsers_in_bounds(client):
    for path in ("/healthz", "/docs", "/nowhere", "/api/v1/jobs"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["cache-control"] == "no-store"


def test_a_request_keeps_the_identifier_it_came_with_unless_it_is_odd(client):
    answer = client.get("/healthz", headers={"x-request-id": "hmi-7.42"})
    assert answer.headers["x-request-id"] == "hmi-7.42"
    for odd in ("a" * 65, "a b", 'x"y', ""):
        answer = client.get("/healthz", headers={"x-request-id": odd})
        assert answer.headers["x-request-id"] != odd
        assert len(answer.headers["x-request-id"]) == 16


def test_other_methods_and_addresses_are_problems(client, is_problem):
    for method in ("PUT", "PATCH", "DELETE", "TRACE", "BREW"):
        answer = client.request(method, "/api/v1/system")
        is_problem(answer, 405, "method")
        assert answer.headers["allow"] == "GET"
    is_problem(client.get("/nowhere/at/all"), 404, "not-found")


def test_a_failure_after_the_answer_has_begun_breaks_it_off(service):
    app = create_application(service)

    async def broken(scope, receive, send):
        start = {"type": "http.response.start", "status": 200, "headers": []}
        await send(start)
        raise RuntimeError("half way")

    app.mount("/broken", broken)
    with TestClient(app, base_url="http://localhost") as client:
        answer = client.get("/broken")
    assert answer.status_code == 200
    assert answer.content == b""


PASSWORD = "a long sentence is easy"
SESSION = "/api/v1/session"


@pytest.fixture
def access(access):
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    return access


def log_in(client, password, **headers):
    body = {"name": "anna", "password": password}
    return client.post(SESSION, json=body, headers=headers).status_code


def read_sources(access):
    access.close()  # writes what waits
    return [row.entry.source for row in access.audit_log.read()]


@pytest.mark.parametrize(
    ("peer", "forwarded", "source"),
    [
        ("192.0.2.9", "198.51.100.1", "192.0.2.9"),
        ("127.0.0.1", "198.51.100.1", "198.51.100.1 via 127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, 198.51.100.1", "198.51.100.1 via 127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, 198.51.100.1:99, 10.1.2.3", "198.51.100.1"),
        ("127.0.0.1", "1.1.1.1, nonsense", "127.0.0.1"),
        ("127.0.0.1", "1.1.1.1, nonsense, 10.1.2.3", "10.1.2.3 via 127.0.0.1"),
        ("127.0.0.1", "[2001:db8::0:1]:443", "2001:db8::1 via 127.0.0.1"),
        ("::ffff:10.0.0.7", "::ffff:198.51.100.1", "198.51.100.1 via ::ffff:10.0.0.7"),
        ("127.0.0.1", "", "127.0.0.1"),
    ],
)
def test_the_last_stranger_that_trusted_proxies_name_is_the_source(
    service, access, peer, forwarded, source
):
    app = create_application(
        replace(service, access=access), trusted_proxies=["127.0.0.1", "10.0.0.0/8"]
    )
    with TestClient(app, base_url="http://127.0.0.1", client=(peer, 5)) as client:
        log_in(client, "wrong", **{"X-Forwarded-For": forwarded})
    (shown,) = read_sources(access)
    assert shown.startswith(source)
    assert ("via" in shown) == (shown.split(" ")[0] != peer)


def test_a_house_of_ipv6_addresses_is_one_source_that_waits_at_length(service, access):
    app = create_application(replace(service, access=access))
    body, answers = {"name": "anna", "password": "wrong"}, []
    for n in range(1, 7):
        client = (f"2001:db8::{n}", 5)
        with TestClient(app, base_url="http://127.0.0.1", client=client) as one:
            answers.append(one.post(SESSION, json=body))
    assert [answer.status_code for answer in answers] == [401] * 5 + [429]
    assert int(answers[-1].headers["Retry-After"]) >= 1
    assert answers[-1].json()["code"] == "too-many-tries"
