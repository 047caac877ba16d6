"""What stands before every route."""

from starlette.testclient import TestClient

from truepath.service.api.application import create_application


def test_the_service_answers_to_its_names_and_methods_alone(client, is_problem):
    own = "localhost", "localhost:8411", "127.0.0.1", "[::1]:8411", "10.0.0.9"
    for host in (*own, "shop-floor", "SHOP-FLOOR:80", "localhost."):
        assert client.get("/healthz", headers={"host": host}).status_code == 200
    for host in ("evil.example", "evil.example:8411", "", "[::1", "a b"):
        is_problem(client.get("/healthz", headers={"host": host}), 421, "host")
    for method in ("PUT", "PATCH", "DELETE", "TRACE", "BREW"):
        answer = client.request(method, "/api/v1/system")
        is_problem(answer, 405, "method")
        assert answer.headers["allow"] == "GET"
    is_problem(client.get("/nowhere/at/all"), 404, "not-found")


def test_a_page_of_another_site_changes_nothing(client, ready, is_problem, make_cell):
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


def test_every_answer_keeps_browsers_in_bounds_and_its_identifier(client):
    for path in ("/healthz", "/docs", "/nowhere", "/api/v1/jobs"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-resource-policy"] == "same-origin"
        assert headers["cache-control"] == "no-store"
    answer = client.get("/healthz", headers={"x-request-id": "hmi-7.42"})
    assert answer.headers["x-request-id"] == "hmi-7.42"
    for odd in ("a" * 65, "a b", 'x"y', ""):
        answer = client.get("/healthz", headers={"x-request-id": odd})
        assert answer.headers["x-request-id"] != odd
        assert len(answer.headers["x-request-id"]) == 16


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
