"""Whatever is sent: no failure of ours, always a problem or an answer."""

from __future__ import annotations

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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
KEYS = ["x_mm", "y_mm", "z_mm", "a_deg", "dwell_s", "target", "feed_mm_min", "w"]
rows = st.lists(st.dictionaries(st.sampled_from(KEYS), values, max_size=7), max_size=4)
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
def reader(run_reader):
    """It reads in a process of its own."""
    return run_reader


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
