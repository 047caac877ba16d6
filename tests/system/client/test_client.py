"""The Python client: each method by answers that a test writes, guides by a service."""

import asyncio
import inspect
import json
import os
import re
import shutil
import ssl
import subprocess
import sys
from contextlib import aclosing, closing
from pathlib import Path
from typing import get_type_hints

import httpx2
import pytest
from playwright.sync_api import sync_playwright

from answers_in_turn import Script, answer
from described_answers import read_document
from service_process import process
from truepath import client as api
from truepath.client import AsyncClient, Client, Problem, Refused, Unreachable, bodies
from truepath.client.problems import BadInput, ServiceProblem, make_problem

ROOT = Path(__file__).parents[3]
LOST = httpx2.ReadError("gone")


def job(state, version=3, **more):
    return {"id": "7", "state": state, "version": version, "error": None, **more}


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(api.requests, "REPEATS_S", (0.0, 0.0, 0.0))


def stream(*events):
    text = "".join(
        f"event: {kind}\ndata: {json.dumps(data)}\n" + (f"id: {i}\n\n" if i else "\n")
        for kind, data, i in events
    )
    headers = {"Content-Type": "text/event-stream"}
    return httpx2.Response(200, text=text, headers=headers)


def test_the_client_imports_neither_the_service_nor_numpy():
    program = (
        "import sys, truepath.client\n"
        "heavy = ('numpy', 'scipy', 'fastapi', 'pydantic', 'truepath.')\n"
        "loaded = [name for name in sys.modules if name.startswith(heavy)]\n"
        "print([name for name in loaded if not name.startswith('truepath.client')])"
    )
    run = [sys.executable, "-c", program]
    said = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"


def test_a_lost_reply_makes_no_second_job_and_every_job_has_a_key_of_its_own():
    script = Script(LOST, LOST, *[answer(202, job("queued"))] * 2)
    with script.open() as client:
        assert client.create_job(kind="measure-otf")["id"] == "7"
        client.create_job(kind="analyse")
    first, *again, other = (r.headers["Idempotency-Key"] for r in script.requests)
    assert again == [first, first]
    assert other != first


@pytest.mark.parametrize(("verb", "given"), [("arm", ["once"]), ("resume", [])])
def test_what_moves_the_machine_is_never_sent_twice(verb, given):
    script = Script(LOST)
    with script.open() as client, pytest.raises(Unreachable, match="does not answer"):
        getattr(client, verb)(job("ready", version=5), *given)
    (request,) = script.requests
    assert request.headers["If-Match"] == '"5"'


def test_arming_asks_for_a_token_unless_one_is_given():
    arming = answer(200, {"token": "once"})
    script = Script(arming, *[answer(202, job("running"))] * 2)
    with script.open() as client:
        client.arm(job("ready"))
        client.arm(job("ready"), "shown")
    asked = [(r.url.path.rsplit("/")[-1], r.content) for r in script.requests]
    tokens = [b"", b'{"token":"once"}', b'{"token":"shown"}']
    assert asked == list(zip(("arming", "arm", "arm"), tokens, strict=True))


def test_an_abort_is_sent_again_until_nobody_is_found_at_the_address():
    script = Script(LOST, answer(202, job("aborting")), *[LOST] * 4)
    with script.open() as client:
        assert client.abort("7")["state"] == "aborting"
        with pytest.raises(Unreachable):
            client.get_job("7")
    assert len(script.requests) == 6


@pytest.mark.parametrize(
    ("status", "code", "family", "more"),
    [
        (409, "busy", api.Busy, {"current_job": "/api/v1/jobs/8"}),
        (409, "illegal-transition", Refused, {}),
        (412, "stale-version", api.StaleVersion, {"current_version": 9}),
        (401, "not-logged-in", api.NotLoggedIn, {}),
        (422, "bundle", BadInput, {"errors": [{"type": "a"}]}),
        (502, "device", api.DeviceProblem, {}),
        (500, "internal-error", ServiceProblem, {}),
        (418, "odd", Refused, {}),
    ],
)
def test_a_refusal_is_an_exception_with_what_belongs_to_it(status, code, family, more):
    content = {"code": code, "detail": "no", "action": "go on", "request_id": "r1"}
    content |= {"file": "path.csv", "row": 3, "column": "x_mm"} | more
    script = Script(answer(status, content, **{"Retry-After": "3"}))
    with script.open() as client, pytest.raises(family, match="no; go on") as raised:
        client.get_job("7")
    problem = raised.value
    assert (problem.status, problem.code, problem.request_id) == (status, code, "r1")
    assert problem.retry_after_s == 3.0
    assert {name: getattr(problem, name) for name in more} == more
    if family is BadInput:
        assert problem.place == ("path.csv", 3, "x_mm")
    assert str(make_problem(503, "no problem at all")) == "status 503"


def test_waiting_ends_in_the_state_or_says_why_not():
    off = {"error": {"detail": "the CNC is off"}}
    told = job("preparing"), job("ready"), job("failed", **off), job("preparing")
    with Script(*[answer(200, one) for one in told]).open() as client:
        assert client.wait_for("7", "ready", period_s=0.0)["state"] == "ready"
        with pytest.raises(api.JobEnded, match="failed: the CNC is off"):
            client.wait_for("7", "ready")
        with pytest.raises(api.JobNotReached, match="preparing, not ready, after -1 s"):
            client.wait_for("7", "ready", timeout_s=-1.0)


def test_a_stream_that_breaks_goes_on_after_the_last_kept_event(monkeypatch):
    monkeypatch.setattr("truepath.client.events._PAUSES_S", (0.0,))
    script = Script(
        stream(("job", job("running"), 4), ("tick", {}, None)),
        LOST,
        answer(503, {"code": "storage"}),
        stream(("job", job("succeeded"), 5)),
    )
    with script.open() as client:
        found = client.events("7")
        received = [next(found) for _ in range(3)]
        found.close()
    heard = [(event.type, event.id) for event in received]
    assert heard == [("job", "4"), ("tick", "4"), ("job", "5")]
    sent = [r.headers.get("Last-Event-ID") for r in script.requests]
    assert sent == [None, "4", "4", "4"]
    assert {r.url.path for r in script.requests} == {"/api/v1/jobs/7/events"}
    refused = Script(answer(404, {"code": "not-found", "detail": "there is no job 7"}))
    with refused.open() as client, pytest.raises(Problem, match="there is no job 7"):
        next(client.events("7"))


def test_a_list_is_read_page_after_page_and_an_estimate_not_there_yet_is_none():
    pages = [{"items": [job("ready")], "next": "abc"}, {"items": [], "next": None}]
    script = Script(*[answer(200, page) for page in pages])
    with script.open() as client:
        assert [j["id"] for j in client.list_jobs(state=["ready"])] == ["7"]
    queries = [dict(r.url.params) for r in script.requests]
    assert queries == [{"state": "ready"}, {"state": "ready", "after": "abc"}]
    with Script(httpx2.Response(204)).open() as client:
        assert client.get_estimate("7") is None


def test_a_token_goes_with_every_request_after_the_log_in():
    answers = answer(200, {"token": "secret"}), answer(200, {}), httpx2.Response(204)
    script = Script(*answers)
    with script.open() as client:
        client.log_in("anna", "a long sentence is easy")
        client.get_system()
        client.log_out()
    sent = [r.headers.get("Authorization") for r in script.requests]
    assert sent == [None, "Bearer secret", "Bearer secret"]


OUT = "Job Run ErrorTables ErrorTable Squareness Verdict Estimate Condition System"
SCHEMA_OF = {name: name for name in ("JobLinks", "ResultLinks", "Problem")}
SCHEMA_OF |= {name: f"{name}Out" for name in OUT.split()}
SCHEMA_OF |= {"Progress": "JobProgress", "Health": "JobHealth", "Plan": "PlanResource"}
SCHEMA_OF |= {"Machine": "MachineEntry", "MachineRecord": "MachineDetail"}


@pytest.mark.parametrize("body", SCHEMA_OF)
def test_the_types_of_the_client_are_those_of_the_interface(body):
    described = read_document()["components"]["schemas"][SCHEMA_OF[body]]["properties"]
    assert set(get_type_hints(getattr(bodies, body))) <= set(described)


JOB = {"id": "7", "version": 3, "state": "succeeded", "token": "once", "ended": "now"}
PAGE = {**JOB, "items": [JOB], "next": None}
OF_ALL = "log_out get_system connect get_machine stop list_conditions list_machines"
OF_A_JOB = """
get_job prepare_arming pause cancel abort acknowledge take_control delete_job
get_verification list_certificates get_job_plan get_estimate get_result
get_error_tables get_discovery get_trend get_reanalysis wait_for events get_plan get_run
"""
CALLS = {
    **dict.fromkeys(OF_A_JOB.split(), ("7",)),
    **dict.fromkeys(("get_machine_record", "get_machine_standing"), ("mill",)),
    **dict.fromkeys(OF_ALL.split(), ()),
    **dict.fromkeys(("arm", "resume"), (JOB,)),
    "log_in": ("anna", "a long sentence"),
    "create_job": {"kind": "measure-otf"},
    "rename_job": ("7", {"name": "as found"}),
    "rename_run": ("7", {"note": "warm"}),
    "delete_run": ("7", {"with_results": True}),
    "add_machine": ("mill", {"machine_file": {}}),
    "change_machine": ("mill", {"place": "hall 3"}),
    "remove_machine": ("mill", 1),
    "set_machine_file": ("mill", {"machine_file": {}}),
    "set_machine_devices": ("mill", {"tracker_driver": "streaming"}),
    "get_machine_history": ("mill", {"quantity": "EXX", "position": 300.0}),
    "get_machine_changes": ("mill", "7"),
    "get_machine_temperature": ("mill", {"sensor": ["X", "Y"]}),
    "compare_machines": {"machine": ["mill", "lathe"]},
    **dict.fromkeys(
        ("issue_certificate", "preview_certificate"), ("7", {"language": "de"})
    ),
    "download": ("/api/v1/jobs/7/result/report.html",),
    "create_plan": {"mode": "otf"},
    "upload_bundle": (Path(__file__),),
    "make_compensation": ("7", {"format": "linuxcnc"}),
    "list_jobs": {"state": ["succeeded"]},
    "list_runs": {"machine": "mill"},
}
TLS = ssl.create_default_context()


@pytest.fixture(autouse=True)
def one_tls_context(monkeypatch):
    """One for all clients: each takes a twentieth of a second."""
    for face in ("sync_client", "async_client"):
        monkeypatch.setattr(f"truepath.client.{face}.make_tls_context", lambda _: TLS)


def list_methods(face):
    return {n for n in vars(face) if not n.startswith("_")} - {"close", "aclose"}


def test_no_method_is_left_out():
    assert set(CALLS) == list_methods(Client) == list_methods(AsyncClient)


class Service:
    def __init__(self):
        self.asked = []

    def __call__(self, request):
        self.asked.append((request.method, request.url.path, dict(request.url.params)))
        if request.url.path.endswith("/events"):
            text = f"id: 4\nevent: job\ndata: {json.dumps(JOB)}\n\n"
            headers = {"Content-Type": "text/event-stream"}
            return httpx2.Response(200, text=text, headers=headers)
        return httpx2.Response(200, json=PAGE)


def call_sync(service, name, given, words):
    with Client("http://mill", transport=httpx2.MockTransport(service)) as client:
        answer = getattr(client, name)(*given, **words)
        if not inspect.isgenerator(answer):
            return answer
        with closing(answer):
            return next(answer)


def call_async(service, name, given, words):
    async def call():
        transport = httpx2.MockTransport(service)
        async with AsyncClient("http://mill", transport=transport) as client:
            answer = getattr(client, name)(*given, **words)
            if not inspect.isasyncgen(answer):
                return await answer
            async with aclosing(answer):
                return await anext(answer)

    return asyncio.run(call())


@pytest.mark.parametrize("call", [call_sync, call_async])
@pytest.mark.parametrize("name", CALLS)
def test_it_asks_what_is_described_and_returns_what_came(name, call):
    given = CALLS[name]
    words = given if isinstance(given, dict) else {}
    given = () if isinstance(given, dict) else given
    if given and isinstance(given[-1], dict) and given[-1] is not JOB:
        *given, words = given
    service = Service()
    answer = call(service, name, tuple(given), words)
    for method, path, query in service.asked:
        fitting = [
            operations[method.lower()]
            for template, operations in read_document()["paths"].items()
            if re.fullmatch(re.sub(r"\{\w+\}", "[^/:]+", template), path)
            and method.lower() in operations
        ]
        assert fitting, f"{method} {path} is not described"
        operation = fitting[0]
        known = {p["name"] for p in operation.get("parameters", ()) if "name" in p}
        assert set(query) <= known
    if name in ("log_out", "delete_job", "delete_run", "remove_machine"):
        assert answer is None
    elif name == "events":
        assert (answer.type, answer.id, answer.data) == ("job", "4", JOB)
    elif name == "download":
        assert json.loads(answer) == PAGE
    else:
        assert answer in ((JOB, [JOB]) if name.startswith("list_") else (PAGE,))


def test_the_client_that_waits_is_the_asynchronous_one_without_its_words():
    written = ROOT / "app" / "truepath" / "client" / "sync_client.py"
    program = (
        "import sys; sys.path.insert(0, 'docs'); import write_sync_client as w; "
        "print(w.write_sync((w.CLIENT / 'async_client.py').read_text('utf-8')), end='')"
    )
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == written.read_text("utf-8")


GUIDE = (ROOT / "docs" / "clients.md").read_text("utf-8")


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with process(tmp_path_factory.mktemp("service")) as (_, client):
        yield str(client.base_url).rstrip("/")


def read_example(language):
    (example,) = re.findall(rf"```{language}\n(.*?)```", GUIDE, re.DOTALL)
    return example


@pytest.mark.long
@pytest.mark.timeout(240)
def test_the_python_example_calibrates_a_machine(address):
    program = read_example("python").replace("http://127.0.0.1:8411", address)
    assert len(program.splitlines()) <= 22
    run = [sys.executable, "-c", program]
    done = subprocess.run(run, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    *progress, verdict, table = done.stdout.splitlines()
    assert progress[0].startswith("measuring")
    assert verdict.split()[0] in ("usable", "doubtful")
    assert "position_mm" in table
    with Client(address) as client:
        (job,) = client.list_jobs(state=["succeeded"])
        assert job["health"]["samples"] > 5000
        assert client.download(job["result"]["error_tables_csv"]).startswith(b"error,")


@pytest.mark.long
@pytest.mark.ui
@pytest.mark.timeout(240)
def test_the_example_of_a_page_calibrates_a_machine(address):
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    assert found, "Chromium is missing: apt-get install chromium, or set CHROMIUM"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page()
        page.goto(f"{address}/docs")
        page.set_default_timeout(200_000)
        said = page.evaluate(
            f"""async () => {{
                {read_example("js")}
                const states = [];
                const tables = await calibrate((s) => states.push(s), () => true);
                return {{ states, tables }};
            }}"""
        )
        browser.close()
    assert {"ready", "running", "succeeded"} <= set(said["states"])
    assert said["tables"]["schema"] == "error-tables/1"
    assert len(said["tables"]["error_tables"]["EXX"]["position_mm"]) > 3
