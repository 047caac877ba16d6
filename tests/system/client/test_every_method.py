"""Every method of both clients sends a request that the interface describes."""

import asyncio
import inspect
import json
import re
import ssl
import subprocess
import sys
from contextlib import aclosing, closing
from pathlib import Path

import httpx2
import pytest

from truepath.client import AsyncClient, Client

ROOT = Path(__file__).parents[3]
PATHS = json.loads((ROOT / "docs" / "openapi.json").read_text("utf-8"))["paths"]
JOB = {"id": "7", "version": 3, "state": "succeeded", "token": "once", "ended": "now"}
PAGE = {**JOB, "items": [JOB], "next": None}
CALLS = {
    "log_in": ("anna", "a long sentence"),
    "log_out": (),
    "get_system": (),
    "connect": (),
    "get_machine": (),
    "list_conditions": (),
    "create_job": {"kind": "measure-otf"},
    "get_job": ("7",),
    "prepare_arming": ("7",),
    "arm": (JOB,),
    "pause": ("7",),
    "resume": (JOB,),
    "cancel": ("7",),
    "abort": ("7",),
    "acknowledge": ("7",),
    "take_control": ("7",),
    "rename_job": ("7", {"name": "as found"}),
    "rename_run": ("7", {"note": "warm"}),
    "delete_job": ("7",),
    "delete_run": ("7", {"with_results": True}),
    "list_machines": (),
    "get_machine_record": ("mill",),
    "add_machine": ("mill", {"machine_file": {}}),
    "change_machine": ("mill", {"place": "hall 3"}),
    "remove_machine": ("mill", 1),
    "set_machine_file": ("mill", {"machine_file": {}}),
    "set_machine_devices": ("mill", {"tracker_driver": "streaming"}),
    "get_machine_history": ("mill", {"quantity": "EXX", "position": 300.0}),
    "get_machine_changes": ("mill", "7"),
    "get_machine_temperature": ("mill", {"sensor": ["X", "Y"]}),
    "get_machine_standing": ("mill",),
    "compare_machines": {"machine": ["mill", "lathe"]},
    "get_verification": ("7",),
    "issue_certificate": ("7", {"language": "de"}),
    "list_certificates": ("7",),
    "stop": (),
    "get_job_plan": ("7",),
    "get_estimate": ("7",),
    "get_result": ("7",),
    "get_error_tables": ("7",),
    "get_discovery": ("7",),
    "get_trend": ("7",),
    "get_reanalysis": ("7",),
    "download": ("/api/v1/jobs/7/result/report.html",),
    "create_plan": {"mode": "otf"},
    "get_plan": ("7",),
    "upload_bundle": (Path(__file__),),
    "get_run": ("7",),
    "make_compensation": ("7", {"format": "linuxcnc"}),
    "wait_for": ("7",),
    "list_jobs": {"state": ["succeeded"]},
    "list_runs": {"machine": "mill"},
    "events": ("7",),
}


TLS = ssl.create_default_context()


@pytest.fixture(autouse=True)
def one_tls_context(monkeypatch):
    """One for all clients: each takes a twentieth of a second."""
    for face in ("sync_client", "async_client"):
        made = f"truepath.client.{face}.make_tls_context"
        monkeypatch.setattr(made, lambda _: TLS)


def list_methods(face):
    return {n for n in vars(face) if not n.startswith("_")} - {"close", "aclose"}


def test_no_method_is_left_out():
    assert set(CALLS) == list_methods(Client) == list_methods(AsyncClient)


class Service:
    """Answers everything, and keeps what was asked."""

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
        operation = find_operation(method, path)
        known = {p["name"] for p in operation.get("parameters", ()) if "name" in p}
        assert set(query) <= known
    if name in ("log_out", "delete_job", "delete_run", "remove_machine"):
        assert answer is None
    elif name == "events":
        assert (answer.type, answer.id, answer.data) == ("job", "4", JOB)
    elif name == "download":
        assert json.loads(answer) == PAGE
    else:
        listed = name.startswith("list_")
        assert answer in ((JOB, [JOB]) if listed else (PAGE,))


def find_operation(method, path):
    fitting = [
        operations[method.lower()]
        for template, operations in PATHS.items()
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/:]+", template), path)
        and method.lower() in operations
    ]
    assert fitting, f"{method} {path} is not described"
    return fitting[0]


def test_the_client_that_waits_is_the_asynchronous_one_without_its_words(tmp_path):
    written = ROOT / "app" / "truepath" / "client" / "sync_client.py"
    program = (
        "import sys; sys.path.insert(0, 'docs'); import write_sync_client as w; "
        "print(w.write_sync((w.CLIENT / 'async_client.py').read_text('utf-8')), end='')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == written.read_text("utf-8")
