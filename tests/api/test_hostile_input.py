"""Whatever is sent: no failure of ours, always a problem or an answer."""

from __future__ import annotations

import json
import re
from urllib.parse import quote

import pytest
from described_answers import read_document
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

DESCRIBED = read_document()["paths"]
PATHS = sorted(DESCRIBED)
GET_PATHS = sorted(
    path
    for path, methods in DESCRIBED.items()
    if "get" in methods and not path.endswith("/events")
)
relaxed = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
texts = st.text(max_size=40)
values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda children: (
        st.lists(children, max_size=4) | st.dictionaries(texts, children, max_size=4)
    ),
    max_leaves=10,
)
rows = st.lists(
    st.dictionaries(
        st.sampled_from(
            ["x_mm", "y_mm", "z_mm", "a_deg", "dwell_s", "target", "feed_mm_min", "w"]
        ),
        values,
        max_size=7,
    ),
    max_size=4,
)
bodies = st.fixed_dictionaries(
    {},
    optional={
        "kind": st.sampled_from(["measure-otf", "measure-standstill", "analyse"])
        | values,
        "run_id": values,
        "path": rows | values,
        "points": rows | values,
        "feed_mm_min": values,
        "perpendicular_only": values,
    },
)
header_values = st.text(
    st.characters(min_codepoint=0x21, max_codepoint=0x7E), max_size=40
)


def is_sound(answer):
    assert answer.status_code < 500, answer.text
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"]


@pytest.fixture
def idle(client, service):
    """A client of a service on which nothing is begun, whatever is asked."""
    yield client
    client.post("/api/v1/stop")


@relaxed
@given(body=bodies)
@pytest.mark.fault_row(35)
def test_any_json_as_a_job(idle, body):
    text = json.dumps(body)  # with NaN and Infinity, as careless clients write them
    answer = idle.post(
        "/api/v1/jobs", content=text, headers={"content-type": "application/json"}
    )
    is_sound(answer)


@relaxed
@given(
    body=st.binary(max_size=200), kind=st.sampled_from(["application/json", "x", ""])
)
@pytest.mark.fault_row(35)
def test_any_bytes_as_a_job(idle, body, kind):
    answer = idle.post("/api/v1/jobs", content=body, headers={"content-type": kind})
    is_sound(answer)


@relaxed
@given(
    path=st.sampled_from(GET_PATHS),
    name=st.text(max_size=50).filter(lambda s: s not in (".", "..")),
    query=st.dictionaries(
        st.sampled_from(["limit", "after", "state", "odd"]), texts, max_size=3
    ),
)
def test_any_name_and_query(idle, path, name, query):
    filled = path.replace("{job_id}", quote(name, safe=""))
    filled = filled.replace("{run_id}", quote(name, safe=""))
    is_sound(idle.get(filled, params=query))


@relaxed
@given(
    verb=st.sampled_from(["arm", "pause", "resume", "abort"]),
    tag=header_values,
    key=header_values,
)
@pytest.mark.fault_row(35)
def test_any_headers(idle, verb, tag, key):
    headers = {"if-match": tag, "idempotency-key": key, "last-event-id": tag}
    is_sound(idle.post(f"/api/v1/jobs/nobody/{verb}", headers=headers))
    is_sound(idle.post("/api/v1/jobs", json={"kind": "x"}, headers=headers))


@relaxed
@given(content=st.binary(max_size=400), name=st.text(max_size=40))
@pytest.mark.fault_row(36)
def test_any_bytes_as_a_bundle(idle, content, name):
    is_sound(idle.post("/api/v1/runs", files={"bundle": (name, content)}))


@relaxed
@given(cut=st.integers(min_value=0, max_value=2000), flip=st.integers(0, 2000))
@pytest.mark.fault_row(36)
def test_any_damage_to_a_bundle(idle, bundle, cut, flip):
    content = bytearray(bundle())
    content[flip % len(content)] ^= 0x41
    is_sound(idle.post("/api/v1/runs", files={"bundle": ("b.zip", bytes(content))}))
    part = bundle()[: cut % len(content)]
    is_sound(idle.post("/api/v1/runs", files={"bundle": ("b.zip", part)}))


@pytest.mark.parametrize("method", ["PUT", "PATCH", "DELETE", "TRACE", "BREW"])
def test_any_method(client, method):
    for path in PATHS:
        answer = client.request(method, path.replace("{job_id}", "a"))
        is_sound(answer)
        if method.lower() not in list_methods(path):
            assert answer.status_code in (404, 405), path


def list_methods(path):
    """Return the methods of all routes that an address may be taken for."""
    return {
        method
        for described, methods in DESCRIBED.items()
        for method in methods
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", described), path)
    }


@pytest.mark.parametrize("path", ["jobs", "runs"])
@pytest.mark.parametrize(
    "query",
    [
        {"until": "9999-12-31T23:59:59-14:00"},
        {"since": "0001-01-01T00:00:00+14:00"},
    ],
)
def test_a_time_outside_the_years_of_utc_is_refused(client, is_problem, path, query):
    answer = client.get(f"/api/v1/{path}", params=query)
    is_problem(answer, 422, "validation")
    (at,) = query.values()
    body = {"kind": "reanalyse", "since": at}
    is_problem(client.post("/api/v1/jobs", json=body), 422, "validation")
