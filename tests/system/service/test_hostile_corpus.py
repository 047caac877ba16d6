"""Corpus of hostile requests, over every route that the interface describes."""

import io
import json
import os
import random
import re
import signal
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from described_answers import read_document, resolve
from scripted_cell import wait_until

SEED = 36
RUNS = "/api/v1/runs"
PATHS = read_document()["paths"]
STREAMS, NO_BODY = ("/events", "/stop"), {"content": ()}
ROUTES = sorted(
    (method, path)
    for path, methods in PATHS.items()
    for method in methods
    if not path.endswith(STREAMS)
)
BODIES = [
    (method, path)
    for method, path in ROUTES
    if "application/json" in PATHS[path][method].get("requestBody", NO_BODY)["content"]
]
ODD = "%00 a%00b %ED%A0%80 %FF%FE %F0%9F%98%80 %0D%0ASet-Cookie:a=b ..%5C..%5Cetc"
NAMES = (*ODD.split(), "%2e%2e%2f", "'%20OR%201=1--", "%25s%25n", "x" * 4000, "9" * 400)
TEXTS = (
    *(b'"\\ud800"', b'"\\u0000"', b'"\\udc00\\ud800"'),
    *b"NaN Infinity -Infinity 1e999 0.1e-400 null [[]]".split(),
    b"9" * 400,
    b"-" + b"9" * 4000,
    b"9" * 5000,
    b"[" * 100_000,
    b'{"a":' * 990 + b"1" + b"}" * 990,
    b'"' + b"x" * 100_000 + b'"',
    b"\xff\xfe[\x00",
    b'"\xed\xa0\x80"',
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
WORDS = st.text(max_size=40)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | WORDS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(WORDS, inner, max_size=4)
    ),
    max_leaves=10,
)
OF_ROWS = st.sampled_from(["x_mm", "z_mm", "a_deg", "dwell_s", "target", "w"])
ROWS = st.lists(st.dictionaries(OF_ROWS, VALUES, max_size=7), max_size=4)
KINDS_OF_JOBS = st.sampled_from(["measure-otf", "measure-standstill", "analyse"])
KEYS = ("run_id", "feed_mm_min", "perpendicular_only")
BODY = st.fixed_dictionaries(
    {"kind": KINDS_OF_JOBS | VALUES},
    optional=dict.fromkeys(KEYS, VALUES) | dict.fromkeys(("path", "points"), ROWS),
)
ONE_SERVICE = HealthCheck.function_scoped_fixture
HEADER = st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7E), max_size=40)


def assert_sound(answer):
    assert answer.status_code < 500, (answer.request.url, answer.text[:300])
    if answer.status_code >= 400:
        assert answer.headers["content-type"] == "application/problem+json"
        problem = json.loads(answer.content.decode())
        assert problem["code"]
        assert problem["detail"]
        assert problem["action"]


def fill(path, name):
    return re.sub(r"\{\w+\}", lambda _: name, path)


def list_queries(path, method):
    parameters = PATHS[path][method].get("parameters", ())
    return [one["name"] for one in parameters if one["in"] == "query"]


@pytest.fixture
def reader(run_reader):
    """It reads in a process of its own."""
    return run_reader


@pytest.fixture
def sound(client):
    yield
    assert client.get("/api/v1/jobs").status_code == 200
    client.post("/api/v1/stop")


@pytest.mark.database
@pytest.mark.fault_row(35)
@pytest.mark.parametrize("name", NAMES, ids=lambda name: name[:12])
def test_hostile_names_and_queries_are_problems(client, sound, name):
    headers = {"if-match": '"1"', "idempotency-key": "a"}
    for method, path in ROUTES:
        if fill(path, name) != path:
            assert_sound(client.request(method, fill(path, name), headers=headers))
        if asked := list_queries(path, method):
            query = "&".join(f"{key}={name}" for key in asked)
            address = f"{fill(path, 'a')}?{query}"
            assert_sound(client.request(method, address, headers=headers))


@pytest.mark.database
@pytest.mark.fault_row(35)
@pytest.mark.parametrize(("method", "path"), BODIES)
def test_hostile_bodies_are_problems(client, sound, method, path, measured):
    draw = random.Random(SEED)
    sent = [(KINDS[0], text) for text in TEXTS]
    sent += [(kind, draw.choice(TEXTS)) for kind in KINDS[1:]]
    schema = PATHS[path][method]["requestBody"]["content"]["application/json"]["schema"]
    for name in sorted(resolve(schema)["properties"]):
        for text in draw.sample(TEXTS, 4):
            inner = b'{"kind": "measure-otf", "%s": %s}' % (name.encode(), text)
            outer = b'{"%s": [{"x_mm": %s}, %s]}' % (name.encode(), text, text)
            sent += [(KINDS[0], inner), (KINDS[0], outer)]
    for kind, body in sent:
        headers = {"content-type": kind.encode("latin-1")}
        answer = client.request(method, fill(path, "a"), content=body, headers=headers)
        assert_sound(answer)
    measured(f"{method} {path}: {len(sent)} bodies, no 5xx")


@settings(max_examples=60, deadline=None, suppress_health_check=[ONE_SERVICE])
@given(body=BODY, tag=HEADER, key=HEADER)
@pytest.mark.fault_row(35)
def test_any_order_with_any_headers_is_sound(client, sound, body, tag, key):
    headers = {"if-match": tag, "idempotency-key": key, "last-event-id": tag}
    text = json.dumps(body)  # with NaN and Infinity, as careless clients write them
    kind = {"content-type": "application/json"}
    assert_sound(client.post("/api/v1/jobs", content=text, headers=headers | kind))
    assert_sound(client.post("/api/v1/jobs/nobody/arm", headers=headers))


def encode_stream():
    columns = dict.fromkeys(("t_s", "x_mm", "y_mm", "z_mm"), np.arange(100) / 500)
    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink, write_page_checksum=True)
    return sink.getvalue()


def pack_again(bundle, method=zipfile.ZIP_DEFLATED, **added):
    old, sink = zipfile.ZipFile(io.BytesIO(bundle)), io.BytesIO()
    with old, zipfile.ZipFile(sink, "w", method) as new:
        for name in old.namelist():
            if name not in added:
                new.writestr(name, old.read(name))
        for name, data in added.items():
            new.writestr(zipfile.ZipInfo(name), data, method)
    return sink.getvalue()


def damage(data, draw):
    damaged = bytearray(data)
    for _ in range(draw.choice((1, 1, 3))):
        at = draw.randrange(len(damaged))
        match draw.randrange(3):
            case 0:
                damaged[at] = draw.randrange(256)
            case 1:
                del damaged[at : at + draw.choice((1, 4, 50))]
            case _:
                damaged[at:at] = draw.choice((b"\0", b"\xff", b"\r", b'"', b"9" * 400))
    return bytes(damaged)


@pytest.mark.fault_row(36)
@pytest.mark.parametrize("kind", ["archive", "end of archive", "parquet", "lzma"])
def test_damaged_bundles_are_problems(client, sound, bundle, kind):
    draw = random.Random(SEED)
    whole = bundle()
    if kind == "lzma":
        whole = pack_again(whole, zipfile.ZIP_LZMA)
    for _ in range(40):
        match kind:
            case "parquet":
                added = {"tracker.parquet": damage(encode_stream(), draw)}
                sent = pack_again(bundle(tracker_csv=None), **added)
            case "end of archive":
                sent = whole[:-300] + damage(whole[-300:], draw)
            case _:
                sent = damage(whole, draw)
        answer = send(client, sent)
        assert_sound(answer)
        if answer.status_code == 422:
            assert answer.json()["file"]


@pytest.mark.fault_row(36)
@pytest.mark.parametrize(
    "name", ["", "./", "a/\ud7ff/../", "../machine.json", "C:\\a.json", "x" * 60_000]
)
def test_odd_names_in_archives_are_sound(client, sound, bundle, name):
    assert_sound(send(client, pack_again(bundle(), **{name: b"{}"})))


@pytest.mark.fault_row(36)
def test_a_page_of_parquet_that_has_changed_is_refused(client, is_problem, bundle):
    stream = bytearray(encode_stream())
    stream[200] ^= 1
    sent = pack_again(bundle(tracker_csv=None), **{"tracker.parquet": bytes(stream)})
    assert is_problem(send(client, sent), 422, "bundle")["file"] == "tracker.parquet"


def send(client, content):
    return client.post(RUNS, files={"bundle": ("b.zip", content)})


@pytest.mark.fault_row(36)
def test_uploads_being_read_hinder_nobody(live, service, bundle, run_reader, measured):
    assert send(live, bundle()).status_code == 201  # the reader is up
    uploads, folder = 45, service.runs._folder  # more than there are request threads
    process_id = run_reader._process._process.process_id
    with ThreadPoolExecutor(uploads) as pool:
        os.kill(process_id, signal.SIGSTOP)
        try:
            sent = [pool.submit(send, live, bundle()) for _ in range(uploads)]
            wait_until(lambda: len(list(folder.glob("*.upload"))) >= 4)
            begun = time.monotonic()
            for _ in range(20):
                assert live.get(RUNS).status_code == 200
            took_s = time.monotonic() - begun
            assert took_s < 5
            measured(f"20 requests beside {uploads} uploads that stand: {took_s:.2f} s")
            assert not any(one.done() for one in sent)
        finally:
            os.kill(process_id, signal.SIGCONT)
        assert {one.result().status_code for one in sent} == {201}
