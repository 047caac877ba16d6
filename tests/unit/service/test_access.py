"""Every route and every role; sessions, keys, users and audit log over HTTP."""

from concurrent.futures import Future
from dataclasses import replace
from itertools import product

import pytest
from fastapi.routing import iter_route_contexts
from pydantic import TypeAdapter
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import Route
from starlette.testclient import TestClient

from job_builders import arm_at_once
from scripted_cell import wait_until
from truepath.catalogue.errors import StorageUnavailable
from truepath.machines.cell_status import NOT_READ
from truepath.measurement.messages import ControllerRead
from truepath.service.api import route_roles as roles
from truepath.service.api.access_control import COOKIE, AccessControl
from truepath.service.api.application import create_application
from truepath.service.api.models.job_request import JobRequest
from truepath.service.api.route_roles import LEAST_ROLES, find_route
from truepath.service.page import pages
from truepath.users.access import RateLimit
from truepath.users.roles import PERSONAL_ROLES, Role, includes
from truepath_drivers.interfaces.records import MotionState, MotionStatus

pytestmark = pytest.mark.database
PASSWORD = "a long sentence is easy"
API = "/api/v1"


@pytest.fixture
def tokens(access):
    """The token of each role: of a user named as it is, and of a program."""
    for role in PERSONAL_ROLES:
        access.accounts.add(role, role, PASSWORD)
    found = {role: access.tokens.open_session(role) for role in PERSONAL_ROLES}
    found[Role.SERVICE] = access.tokens.create_key("plant", Role.SERVICE)
    return found


@pytest.fixture
def client(service, access):
    app = create_application(replace(service, access=access))
    with TestClient(app, base_url="https://127.0.0.1:8411") as client:
        yield client


@pytest.fixture
def reached(access):
    """A client of the access control alone: what it lets through is reached."""

    def answer(_):
        return PlainTextResponse("reached")

    methods = ["GET", "POST", "PATCH", "PUT", "DELETE"]
    inner = Starlette(routes=[Route("/{path:path}", answer, methods=methods)])
    app = AccessControl(inner, access)
    with TestClient(app, base_url="https://127.0.0.1:8411") as client:
        yield client


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


def test_every_route_declares_its_least_role_and_what_does_not_is_closed():
    app, routes = create_application(pages=pages.router), set()
    app.mount(pages.STATIC_PATH, pages.static_files(), name="static")
    for route in iter_route_contexts(app.routes):
        methods = set(route.methods or {"GET"}) - {"HEAD"}
        is_mount = not route.methods and not route.path.startswith("/api/")
        path = f"{route.path}/{{path:path}}" if is_mount else route.path
        routes |= {f"{method} {path}" for method in methods}
    assert routes - set(LEAST_ROLES) == set(), "declare them in route_roles.py"
    assert set(LEAST_ROLES) - routes == set(), "no such route any more"
    assert len(routes) > 50
    assert LEAST_ROLES[roles.STOP] is roles.ANYBODY
    certificates = f"{API}/jobs/{{job_id}}/certificates"
    assert LEAST_ROLES[f"POST {certificates}"] is Role.METROLOGIST
    assert LEAST_ROLES[f"GET {certificates}"] is Role.VIEWER
    assert roles.find_least_role("GET", find_route("GET", "/api/v1/new")) is Role.VIEWER
    unknown = find_route("POST", "/api/v1/new")
    assert roles.find_least_role("POST", unknown) is Role.ADMINISTRATOR
    for route in LEAST_ROLES:
        assert find_route(*address_of(route)) == route
    assert find_route("HEAD", "/api/v1/jobs") == "GET /api/v1/jobs"


def address_of(route):
    method, path = route.split(" ")
    return method, path.replace("{path:path}", "x").replace("{", "").replace("}", "")


def test_routes_take_their_role_and_those_above(reached, tokens, monkeypatch, access):
    done = Future()
    done.set_result(None)
    monkeypatch.setattr(access.audit_writer, "record", lambda _, **__: done)
    for (route, least), role in product(LEAST_ROLES.items(), (None, *Role)):
        headers = bearer(tokens[role]) if role else {}
        answer = reached.request(*address_of(route), headers=headers)
        assert answer.status_code == expect_status(route, least, role), (route, role)


def expect_status(route, least, role):
    if least is roles.ANYBODY:
        return 200
    if role is None:
        return 401
    moves_alone = role is Role.SERVICE and route in roles.MOVES
    return 200 if includes(role, least) and not moves_alone else 403


def test_strangers_hear_how_to_log_in_low_roles_which_they_need(client, tokens):
    answer = client.get(f"{API}/jobs")
    assert (answer.status_code, answer.headers["WWW-Authenticate"]) == (401, "Bearer")
    assert answer.json()["code"] == "not-logged-in"
    assert "/api/v1/session" in answer.json()["action"]
    for path in ("/events", "/jobs/x/events"):  # no stream opens
        for headers in ({}, bearer("wrong")):
            assert client.get(API + path, headers=headers).status_code == 401
    refused = client.post(f"{API}/jobs", headers=bearer(tokens[Role.VIEWER]))
    assert refused.status_code == 403
    assert "needs the role operator; viewer is viewer" in refused.json()["detail"]


def test_a_program_logs_in_for_a_token_a_browser_for_a_cookie(client, access):
    access.accounts.add("anna", Role.OPERATOR, PASSWORD)
    body = {"name": "anna", "password": PASSWORD}
    opened = client.post(f"{API}/session", json=body)
    assert opened.status_code == 200
    assert "set-cookie" not in opened.headers
    headers = bearer(opened.json()["token"])
    shown = client.get(f"{API}/session", headers=headers).json()
    anna = {"name": "anna", "role": "operator", "is_person": True}
    assert shown == {"log_in_required": True, **anna}
    assert client.get(f"{API}/jobs", headers=headers).status_code == 200
    assert client.delete(f"{API}/session", headers=headers).status_code == 204
    assert client.get(f"{API}/jobs", headers=headers).status_code == 401
    assert client.get(f"{API}/session", headers=headers).json()["name"] is None
    opened = client.post(f"{API}/session", json={**body, "cookie": True})
    assert opened.json()["token"] is None
    assert "max-age=" in opened.headers["Strict-Transport-Security"], "over TLS"
    cookie = opened.headers["set-cookie"].lower()
    assert cookie.startswith(f"{COOKIE}=tp_")
    for word in ("secure", "httponly", "samesite=strict", "path=/"):
        assert word in cookie
    assert client.get(f"{API}/session").json()["name"] == "anna"
    assert client.get(f"{API}/jobs").status_code == 200


@pytest.fixture
def away(access, monkeypatch):
    """Let nobody's session be read from now on."""

    def fail(*_):
        raise StorageUnavailable("the catalogue is away")

    return lambda: monkeypatch.setattr(access.tokens, "find", fail)


@pytest.mark.parametrize("logs_in", [False, True])
def test_whoever_comes_may_stop_and_is_told_which_jobs_once_logged_in(
    client, service, tokens, armed_by_hand, away, logs_in
):
    """A stranger may whatever the catalogue says."""
    sent = bearer(tokens[Role.VIEWER] if logs_in else "wrong")
    if not logs_in:
        away()
        assert client.get(f"{API}/jobs", headers=bearer("any")).status_code == 503
    stopped = client.post(f"{API}/stop", headers=sent)
    assert stopped.status_code == 202
    wait_until(lambda: service.store.get(armed_by_hand).state == "aborted")
    assert [job["id"] for job in stopped.json()["jobs"]] == [armed_by_hand] * logs_in
    assert stopped.json()["machines"]


@pytest.fixture
def armed_by_hand(service, make_cell, order):
    requested = TypeAdapter(JobRequest).validate_python(order).to_requested_job()
    job, _ = service.dispatcher.create(requested)
    wait_until(lambda: service.store.get(job.id).state == "ready")
    arm_at_once(service.dispatcher, job.id, service.store.get(job.id).version)
    assert make_cell.cell.begun.wait(5)
    return job.id


def test_any_user_may_abort(client, tokens, armed_by_hand, away, monkeypatch):
    path = f"{API}/jobs/{armed_by_hand}/abort"
    assert client.post(path).status_code == 401
    away()
    assert client.post(path, headers=bearer("any")).status_code == 202
    monkeypatch.undo()
    assert client.post(path, headers=bearer(tokens[Role.VIEWER])).status_code == 202


@pytest.mark.fault_row(33)
def test_the_first_controller_keeps_control_until_another_takes_it(
    client, access, tokens, armed_by_hand, make_cell, is_problem
):
    access.accounts.add("berta", Role.OPERATOR, PASSWORD)
    anna = bearer(tokens[Role.OPERATOR])
    berta = bearer(access.tokens.open_session("berta"))
    path = f"{API}/jobs/{armed_by_hand}"

    def resume(who):
        version = client.get(path, headers=anna).headers["etag"]
        return client.post(f"{path}/resume", headers={**who, "If-Match": version})

    def find_control():
        return client.get(f"{API}/machines/default", headers=anna).json()["in_control"]

    shown = client.get(path, headers=anna).json()
    assert (shown["owner"], find_control()) == (None, None)  # of where nobody logs in
    assert client.post(f"{path}/take-control", headers=anna).status_code == 202
    assert find_control() == "operator"
    assert client.post(f"{path}/pause", headers=berta).status_code == 202
    wait_until(lambda: client.get(path, headers=anna).json()["state"] == "paused")
    refused = is_problem(resume(berta), 409, "not-in-control")
    assert refused["controller"] == "operator"
    assert "operator" in refused["detail"]
    assert "resume" not in make_cell.cell.heard
    assert client.post(f"{path}/take-control", headers=berta).status_code == 202
    assert find_control() == "berta"
    is_problem(resume(anna), 409, "not-in-control")
    assert resume(berta).status_code == 202
    assert client.post(f"{path}/abort", headers=anna).status_code == 202
    administrator = bearer(tokens[Role.ADMINISTRATOR])
    kept = client.get(f"{API}/audit", headers=administrator).json()["items"]
    took = next(row for row in kept if row["what"].endswith("/take-control"))
    assert (took["who"], took["old"]) == ("berta", {"controller": "operator"})


def test_a_stop_says_what_the_controller_says_later(client, armed_by_hand, make_cell):
    def stop():
        return client.post(f"{API}/stop").json()["machines"]

    name = stop()[0]["machine"]
    assert stop() == [{"machine": name, "stopped": "unknown", "says": NOT_READ}]
    cell = make_cell.cell
    for state, level, words in (
        ("running", "false", "it moves"),
        ("held", "false", "it stands by a feed hold alone (held)"),
        ("idle", "true", "it has stopped (idle)"),
    ):
        cell.say(ControllerRead(MotionStatus(MotionState(state), (0.0, 0.0, 0.0), 0)))
        wait_until(lambda level=level: stop()[0]["stopped"] == level, level)
        wait_until(lambda words=words: stop()[0]["says"].startswith(words), words)


def test_a_program_arms_only_where_that_is_set(reached, tokens, access):
    for allowed, verb in product((False, True), ("arm", "resume")):
        access.rules = replace(access.rules, arming_by_key=allowed)
        path = f"{API}/jobs/x/{verb}"
        answer = reached.post(path, headers=bearer(tokens[Role.SERVICE]))
        assert answer.status_code == (200 if allowed else 403)
        assert allowed or answer.json()["code"] == "person-needed"


def test_administrators_manage_users_and_keys(client, tokens):
    headers = bearer(tokens[Role.ADMINISTRATOR])

    def ask(method, path, body=None, status=200):
        answer = client.request(method, API + path, json=body, headers=headers)
        assert answer.status_code == status, answer.text
        return answer.json() if answer.content else None

    user = {"name": "ben", "role": "viewer", "password": PASSWORD}
    assert ask("POST", "/users", user, 201)["role"] == "viewer"
    assert ask("POST", "/users", user, 409)["code"] == "user-conflict"
    assert ask("POST", "/users", {**user, "role": "service"}, 422)
    changed = ask("PATCH", "/users/ben", {"role": "operator", "password": PASSWORD})
    assert ("ben", "operator") in [(u["name"], u["role"]) for u in changed["items"]]
    assert len(ask("GET", "/users")["items"]) == 5
    assert ask("DELETE", "/users/ben", status=204) is None
    assert ask("DELETE", "/users/ben", status=404)["code"] == "not-found"
    made = ask("POST", "/keys", {"name": "robot", "days": 1}, 201)
    whose = client.get(f"{API}/session", headers=bearer(made["token"])).json()
    robot = {"name": "robot", "role": "service", "is_person": False}
    assert robot.items() <= whose.items()
    assert [key["name"] for key in ask("GET", "/keys")["items"]] == ["plant", "robot"]
    ask("DELETE", "/keys/robot", status=204)
    assert client.get(f"{API}/jobs", headers=bearer(made["token"])).status_code == 401


def test_jobs_have_owners_the_audit_log_what_was_done(client, tokens, access, order):
    headers = bearer(tokens[Role.OPERATOR])
    made = client.post(f"{API}/jobs", json=order, headers=headers)
    shown = client.get(made.headers["Location"], headers=headers)
    assert made.json()["owner"] == shown.json()["owner"] == "operator"
    headers = bearer(tokens[Role.ADMINISTRATOR])
    client.post(f"{API}/session", json={"name": "anna", "password": "wrong!"})
    client.post(f"{API}/plans", headers=bearer(tokens[Role.VIEWER]))
    client.patch(f"{API}/users/viewer", json={"role": "operator"}, headers=headers)
    client.get(f"{API}/jobs", headers=headers)
    client.post(f"{API}/stop")
    access.close()  # the row of a stop is written behind it
    rows = client.get(f"{API}/audit", headers=headers).json()["items"]
    shown = [(row["who"], row["what"], row["outcome"]) for row in reversed(rows)]
    assert shown == [
        ("operator", "POST /api/v1/jobs", "202"),
        ("", "POST /api/v1/session", "401"),
        ("viewer", "POST /api/v1/plans", "403"),
        ("administrator", "PATCH /api/v1/users/viewer", "200"),
        ("", "POST /api/v1/stop", "202"),
    ]
    assert (rows[1]["old"], rows[1]["source"]) == ({"role": "viewer"}, "testclient")
    assert (rows[1]["new"], rows[3]["new"]) == ({"role": "operator"}, {"name": "anna"})
    assert "wrong!" not in str(rows)
    assert access.audit_log.verify() == []
    page = client.get(f"{API}/audit?limit=2", headers=headers).json()
    more = client.get(f"{API}/audit?before={page['next']}", headers=headers).json()
    assert [row["seq"] for row in page["items"] + more["items"]] == [5, 4, 3, 2, 1]


def test_stops_have_no_rate_and_await_no_audit(reached, access, tokens, monkeypatch):
    """The log cannot be written."""
    monkeypatch.setattr("truepath.service.api.access_control.AUDIT_PATIENCE_S", 0.05)
    monkeypatch.setattr(access.audit_writer, "record", lambda _, **__: Future())
    monkeypatch.setattr(access, "_changes", RateLimit(2, 0.001))
    headers = bearer(tokens[Role.OPERATOR])
    stops = ("/stop", [200, 200]), ("/jobs/x/abort", [200])
    for path, answers in (("/plans", [200, 200, 429, 429]), *stops):
        for status in answers:
            assert reached.post(API + path, headers=headers).status_code == status


def test_where_nobody_logs_in_whoever_comes_may_everything(service, order):
    with TestClient(create_application(service), base_url="http://127.0.0.1") as client:
        made = client.post(f"{API}/jobs", json=order)
        assert (made.status_code, made.json()["owner"]) == (202, None)
        assert client.get(f"{API}/session").json()["log_in_required"] is False
        rows = client.get(f"{API}/audit").json()["items"]
        assert [row["what"] for row in rows] == ["POST /api/v1/jobs"]
        assert rows[0]["new"]["made"] == made.headers["Location"]
