"""Corpus of hostile requests, over every route that the interface describes."""

from __future__ import annotations

import json
import random

import pytest

from truepath.app.api.application import describe_interface

SEED = 36
PATHS = json.loads(describe_interface())["paths"]
STREAMS = ("/events", "/stop")
ROUTES = sorted(
    (method, path)
    for path, methods in PATHS.items()
    for method in methods
    if not path.endswith(STREAMS)
)
BODIES = sorted(
    (method, path)
    for method, path in ROUTES
    if "application/json"
    in PATHS[path][method].get("requestBody", {}).get("content", ())
)
NAMES = (
    "%00",
    "a%00b",
    "%ED%A0%80",
    "%FF%FE",
    "%F0%9F%98%80",
    "x" * 4000,
    "%0D%0ASet-Cookie:a=b",
    "..%5C..%5Cetc",
    "%2e%2e%2f",
    "'%20OR%201=1--",
    "9" * 400,
    "%25s%25n",
)
TEXTS = (
    b'"\\ud800"',
    b'"\\u0000"',
    b'"\\udc00\\ud800"',
    b"NaN",
    b"Infinity",
    b"-Infinity",
    b"1e999",
    b"9" * 400,
    b"-" + b"9" * 4000,
    b"9" * 5000,
    b"[" * 100_000,
    b'{"a":' * 990 + b"1" + b"}" * 990,
    b"null",
    b"[[]]",
    b'"' + b"x" * 100_000 + b'"',
    b"\xff\xfe[\x00",
    b'"\xed\xa0\x80"',
    b"0.1e-400",
    b'{"\\ud800": 1}',
)
KINDS = (
    "application/json",
    "application/json; charset=utf-16",
    "application/x-www-form-urlencoded",
    "multipart/form-data",
    "text/plain",
    "application/octet-stream; \xff",
    "",
)


def assert_sound(answer):
    assert answer.status_code < 500, (answer.request.url, answer.text[:300])
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
        problem = json.loads(answer.content.decode())
        assert problem["code"]
        assert problem["detail"]
        assert problem["action"]


def fill(path, name):
    for key in ("job_id", "run_id", "model_id", "machine_id"):
        path = path.replace(f"{{{key}}}", name)
    return path


def list_properties(path, method):
    """Return the names of the keys of a request's body, by its description."""
    document = json.loads(describe_interface())
    schema = document["paths"][path][method]["requestBody"]["content"]
    reference = schema["application/json"]["schema"]["$ref"].rpartition("/")[2]
    return sorted(document["components"]["schemas"][reference]["properties"])


@pytest.fixture
def sound(client):
    yield
    assert client.get("/api/v1/jobs").status_code == 200
    client.post("/api/v1/stop")


@pytest.mark.fault_row(35)
@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_hostile_names_and_queries_are_problems(client, sound, method, path):
    for name in NAMES:
        headers = {"if-match": '"1"', "idempotency-key": "a"}
        query = f"?limit={name}&after={name}&state={name}&then={name}&dialect={name}"
        query += f"&format={name}&model_id={name}"
        assert_sound(client.request(method, fill(path, name), headers=headers))
        assert_sound(client.request(method, fill(path, "a") + query, headers=headers))


@pytest.mark.fault_row(35)
@pytest.mark.parametrize(("method", "path"), BODIES)
def test_hostile_bodies_are_problems(client, sound, method, path):
    draw = random.Random(SEED)
    sent = [(KINDS[0], text) for text in TEXTS]
    sent += [(kind, draw.choice(TEXTS)) for kind in KINDS[1:]]
    for name in list_properties(path, method):
        for text in draw.sample(TEXTS, 4):
            inner = b'{"kind": "measure-otf", "%s": %s}' % (name.encode(), text)
            outer = b'{"%s": [{"x_mm": %s}, %s]}' % (name.encode(), text, text)
            sent += [(KINDS[0], inner), (KINDS[0], outer)]
    for kind, body in sent:
        headers = {"content-type": kind.encode("latin-1")}
        answer = client.request(method, fill(path, "a"), content=body, headers=headers)
        assert_sound(answer)
