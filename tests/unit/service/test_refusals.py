"""What stands before every route, and what is refused by name and changes nothing."""

import re

import pytest
from starlette.testclient import TestClient

from api_builders import FOREIGN
from truepath.service.api.application import create_application

BOX = {"name": "probe", "min_mm": [150, 100, 0], "max_mm": [260, 220, 400]}
OTF = {"kind": "measure-otf"}
ANALYSE = {"kind": "analyse", "run_id": "a"}
PLANNING = {"planning": {"mode": "otf", "minutes": 5}}
ADAPTIVE = {"kind": "measure-adaptive", "target_um": 2.0, **PLANNING}
REANALYSE = {"kind": "reanalyse"}
TREND = {"kind": "trend", "run_ids": ["a", "b"]}
EXTRA = {"kind": "measure-extra", "discovery_id": "a"}
SHORT = {"mode": "otf", "minutes": 0.5, "seed": 3}


def measure_at(*places, **more):
    rows = [{"x_mm": x, "y_mm": x, "z_mm": x} for x in places]
    rows[-1] |= more
    return rows


SLOW = measure_at(10, 400, feed_mm_min=5e-324)
NAMED = [
    ("jobs", {"kind": "analyse"}, "", "needs a run_id"),
    ("jobs", {**ANALYSE, "run_ids": ["b"]}, "", "stands beside run_ids"),
    ("jobs", {"kind": "analyse", "run_ids": ["a", "a"]}, "", "names a Run twice"),
    ("jobs", {"kind": "analyse", "run_id": "../etc"}, "run_id", "holds"),
    ("jobs", {**OTF, "points": [{}]}, "", "points is not for"),
    ("jobs", {**OTF, "hurry": 1}, "hurry", "Extra inputs"),
    ("jobs", {**OTF, "path": [{"x_mm": "a"}, {}]}, "path.0.x_mm", "valid number"),
    ("jobs", {**OTF, "plan_rows": 9}, "", "plan_rows needs a plan_id"),
    ("plans:validate", {"path": SLOW}, "path.1.feed_mm_min", ""),
    *(
        (address, order, where, "to 1" if feed < 1 else "than")
        for feed in (5e-324, 0.99, 100_000.0)
        for address, order, where in (
            ("plans", {"feeds_mm_min": [6000, feed]}, "feeds_mm_min.1"),
            ("plans", {"max_feed_mm_min": feed}, "max_feed_mm_min"),
            ("jobs", {**OTF, "feed_mm_min": feed}, "feed_mm_min"),
        )
    ),
]
SENSELESS = [
    *(
        ("jobs", {"kind": "verify", "result_id": "0190a4a1"}, change)
        for change in (
            {"tolerance_um": "5"},
            {"seed": True},
            {"keep_out": [{"min_mm": [0, 0, 9], "max_mm": [9, 9, 9]}]},
            {"keep_out_replaces": True},
            {"what": ["circles", "circles"]},
            {"run_id": "0" * 8},
            {"result_id": None},
            {"compensation_id": ".."},
        )
    ),
    ("jobs", OTF, {"target_um": 0}),
    ("jobs", OTF, {"monte_carlo": {}}),
    ("jobs", {**OTF, "path": measure_at(10, 400, 90)}, {"plan_id": "019a3f5e"}),
    ("jobs", ANALYSE, {"target_um": 1.0}),
    ("jobs", ADAPTIVE, {"planning": {"target_um": 1.0}}),
    ("jobs", ADAPTIVE, {"planning": {"corner_path": True}}),
    ("jobs", ADAPTIVE, {"path": [{"x_mm": 1}, {"x_mm": 2}]}),
    ("jobs", ADAPTIVE, {"kind": "measure-otf"}),
    ("jobs", REANALYSE, {}),
    ("jobs", REANALYSE, {"run_ids": ["a"], "machine": "default"}),
    ("jobs", REANALYSE, {"run_id": "a"}),
    ("jobs", TREND, {"run_ids": ["a"]}),
    ("jobs", TREND, {"run_ids": ["a", "a"]}),
    ("jobs", TREND, {"target_um": 1.0}),
    ("jobs", TREND, {"horizon_h": 0}),
    ("jobs", {"kind": "discover"}, {}),
    ("jobs", {"kind": "discover", "run_id": "a"}, {"target_um": 1.0}),
    ("jobs", EXTRA, {"discovery_id": None}),
    ("jobs", EXTRA, {"path": measure_at(10, 400)}),
    ("plans", SHORT, {"minutes": 1e9}),
    ("plans", SHORT, {"corner_path": True}),
    ("plans", SHORT, {"workspace": {"blocks_sight": [BOX]}}),
    ("plans", SHORT, {"workspace": {"keep_out": [{**BOX, "max_mm": BOX["min_mm"]}]}}),
    ("plans:validate", {}, {}),
    ("jobs/any/certificates", {}, {"identity": {"operator": "A\nB"}}),
    ("jobs/any/certificates", {}, {"compensation_id": "../../x"}),
    ("jobs/any/compensations", {"format": "linuxcnc"}, {"spacing_mm": 0}),
]


def test_orders_that_make_no_sense_are_refused_with_their_fault(client, is_problem):
    for address, body, where, text in NAMED:
        answer = client.post(f"/api/v1/{address}", json=body)
        error = is_problem(answer, 422, "validation")["errors"][0]
        assert ".".join(error["location"]) == f"body.{where}".rstrip("."), body
        assert text in error["message"], body
        assert set(error) == {"location", "message", "type"}
    for address, order, change in SENSELESS:
        answer = client.post(f"/api/v1/{address}", json={**order, **change})
        said = str(is_problem(answer, 422, "validation"))
        assert any(name in said for name in change) or not change, (order, change, said)
    assert client.get("/api/v1/jobs").json()["items"] == []


@pytest.mark.database
def test_a_query_that_is_not_as_documented_is_named(client, is_problem):
    odd = "limit=0", "after=%0a", "since=yesterday", "until=2026-01-31T08:00:00"
    for query in odd:
        problem = is_problem(client.get(f"/api/v1/jobs?{query}"), 422, "validation")
        name = query.partition("=")[0]
        assert problem["errors"][0]["location"][:2] == ["query", name]
    for name, at in (  # outside the years of UTC
        ("until", "9999-12-31T23:59:59-14:00"),
        ("since", "0001-01-01T00:00:00+14:00"),
    ):
        for path in ("jobs", "runs"):
            answer = client.get(f"/api/v1/{path}", params={name: at})
            is_problem(answer, 422, "validation")
        body = {"kind": "reanalyse", "since": at}
        is_problem(client.post("/api/v1/jobs", json=body), 422, "validation")
    for after in ("czpub25l", "bm9wZQ==", "Zm9vOjE=", "====", "_"):  # somebody else's
        is_problem(client.get(f"/api/v1/jobs?after={after}"), 422, "bad-input")


def test_rows_of_no_use_are_refused_by_check_and_order(client, is_problem):
    for kind, key, places, said in (
        ("otf", "path", [10, 200], "the path has the target stand at 2 places"),
        ("otf", "path", [10, 200, 90], "the path lies on one straight line"),
        ("standstill", "points", [10], "stand at 1 place; .* add rows"),
        ("standstill", "points", [10, 90, 200], "points lies on one straight"),
    ):
        rows = {key: measure_at(*places)}
        answer = client.post("/api/v1/plans:validate", json=rows)
        checked = is_problem(answer, 422, "plan")
        assert re.search(said, checked["detail"])
        order = {"kind": f"measure-{kind}", **rows}
        ordered = is_problem(client.post("/api/v1/jobs", json=order), 422, "plan")
        assert ordered["detail"] == checked["detail"]
    assert client.get("/api/v1/jobs").json()["items"] == []


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
    for headers in (*FOREIGN, {"origin": "http://127.0.0.1:9999"}):
        for verb in ("", f"{job}/arm", f"{job}/arm/", f"{job}/arm/api/v1/arm"):
            answer = client.post(verb or "/api/v1/jobs", headers=headers)
            is_problem(answer, 403, "cross-site")
        assert client.get("/api/v1/system", headers=headers).status_code == 200
    assert make_cell.cell.heard == ["connect"]
    own = "http://127.0.0.1:8411"
    by_page = {"sec-fetch-site": "same-origin", "origin": own}
    for headers in ({}, by_page, {"sec-fetch-site": "none"}, {"origin": own}):
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
        await send({"type": "http.response.start", "status": 200, "headers": []})
        raise RuntimeError("half way")

    app.mount("/broken", broken)
    with TestClient(app, base_url="http://localhost") as client:
        answer = client.get("/broken")
    assert (answer.status_code, answer.content) == (200, b"")
