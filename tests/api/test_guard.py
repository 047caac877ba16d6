"""What stands before every route."""

from __future__ import annotations

import pytest
from starlette.testclient import TestClient

from truepath.service.api.application import create_application


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "localhost:8411",
        "127.0.0.1",
        "[::1]:8411",
        "10.0.0.9",
        "shop-floor",
        "SHOP-FLOOR:80",
        "localhost.",
    ],
)
def test_the_service_answers_to_its_names(client, host):
    assert client.get("/healthz", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8411", "", "[::1", "a b"]
)
def test_a_name_that_somebody_points_here_is_not_answered(client, is_problem, host):
    answer = client.get("/healthz", headers={"host": host})
    is_problem(answer, 421, "host")


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
    ],
)
def test_a_page_of_another_site_can_change_nothing(
    client, ready, is_problem, headers, make_cell
):
    job = f"/api/v1/jobs/{ready['id']}"
    for path in ("/api/v1/jobs", f"{job}/arm", f"{job}/arm/", f"{job}/arm/api/v1/arm"):
        is_problem(client.post(path, headers=headers), 403, "cross-site")
    assert make_cell.cell.heard == ["connect"]


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"sec-fetch-site": "same-origin", "origin": "http://127.0.0.1:8411"},
        {"sec-fetch-site": "none"},
        {"origin": "http://127.0.0.1:8411"},
    ],
)
def test_the_services_own_page_and_programs_can(client, headers):
    assert client.post("/api/v1/stop", headers=headers).status_code == 202


def test_reading_is_not_a_change(client):
    headers = {"sec-fetch-site": "cross-site"}
    assert client.get("/api/v1/system", headers=headers).status_code == 200


@pytest.mark.parametrize("path", ["/healthz", "/docs", "/nowhere", "/api/v1/jobs"])
def test_every_answer_has_the_headers_that_keep_browsers_in_bounds(client, path):
    headers = client.get(path).headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert headers["cache-control"] == "no-store"


def test_a_request_keeps_the_identifier_it_came_with(client):
    answer = client.get("/healthz", headers={"x-request-id": "hmi-7.42"})
    assert answer.headers["x-request-id"] == "hmi-7.42"


@pytest.mark.parametrize("odd", ["a" * 65, "a b", 'x"y', ""])
def test_an_odd_identifier_is_replaced(client, odd):
    answer = client.get("/healthz", headers={"x-request-id": odd})
    assert answer.headers["x-request-id"] != odd
    assert len(answer.headers["x-request-id"]) == 16


def test_other_methods_are_problems_that_name_the_right_ones(client, is_problem):
    answer = client.delete("/api/v1/system")
    is_problem(answer, 405, "method")
    assert answer.headers["allow"] == "GET"


def test_an_unknown_address_is_a_problem(client, is_problem):
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
