"""The interface as it describes itself."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import urljoin

import pytest
from fastapi import APIRouter
from pydantic import TypeAdapter

from truepath import errors as app_errors
from truepath.catalogue import errors as job_errors
from truepath.catalogue.job import Failure
from truepath.service.api import problems
from truepath.service.api.application import create_application, describe_interface
from truepath.service.api.models.jobs.job_request import JobRequest
from truepath.service.api.problems import find_kind_of_status
from truepath_drivers.interfaces import errors as device_errors

ROOT = Path(__file__).parents[2]
HTTP_METHODS = {"get", "post", "put", "patch", "delete"}


@pytest.fixture(scope="module")
def document():
    return json.loads(describe_interface())


@pytest.fixture(scope="module")
def operations(document):
    return [
        (path, method, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
        if method in HTTP_METHODS
    ]


def test_the_checked_in_description_is_current():
    kept = (ROOT / "docs" / "openapi.json").read_text(encoding="utf-8")
    command = "python -m truepath.service.api.application docs/openapi.json"
    assert kept == describe_interface(), command


def test_the_service_hands_out_the_same_description(client, document):
    assert client.get("/api/v1/openapi.json").json() == document


def test_every_operation_has_a_name_of_its_own_a_tag_and_a_sentence(
    document, operations
):
    names = [operation["operationId"] for _, _, operation in operations]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)+", name) for name in names)
    tags = {tag["name"] for tag in document["tags"]}
    for path, _, operation in operations:
        assert set(operation["tags"]) <= tags, path
        assert operation["description"].endswith("."), path


def test_every_refusal_is_a_problem(operations):
    for path, _, operation in operations:
        for status, answer in operation["responses"].items():
            if status >= "400":
                refused = f"#/components/responses/Problem{status}"
                assert answer == {"$ref": refused}, path


def test_reading_never_conflicts(operations):
    for path, method, operation in operations:
        if method == "get":
            assert "409" not in operation["responses"], path


def test_the_examples_of_a_job_are_taken(document):
    examples = document["components"]["schemas"]["JobRequest"]["examples"]
    assert len(examples) >= 3
    for example in examples:
        TypeAdapter(JobRequest).validate_python(example)


def test_all_paths_but_probes_are_versioned(operations):
    probes = {path for path, _, _ in operations if not path.startswith("/api/v1/")}
    assert probes == {"/healthz", "/metrics", "/readyz"}


def test_writing_the_file_writes_the_description(tmp_path):
    file = tmp_path / "openapi.json"
    module = "truepath.service.api.application"
    subprocess.run([sys.executable, "-m", module, str(file)], check=True)
    assert file.read_text(encoding="utf-8") == describe_interface()


def test_the_documentation_comes_from_the_service_itself(client):
    page = client.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    addresses = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(addresses) == 4
    for address in addresses:
        if address != "data:,":
            own = urljoin("/docs", address)
            assert own.startswith("/docs/")
            assert client.get(own).status_code == 200
    assert "<script>" not in page.text
    assert "/api/v1/openapi.json" in client.get("/docs/begin.js").text


def test_there_are_no_other_documentation_pages(client, is_problem):
    is_problem(client.get("/redoc"), 404, "not-found")


def test_the_operator_page_can_be_added(service):
    pages = APIRouter()

    @pages.get("/")
    def page():
        return "the page"

    app = create_application(service, pages=pages)
    assert any(getattr(r, "path", "") == "/" for r in pages.routes)
    assert app.url_path_for("page") == "/"


def families(module):
    return [
        kind
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Exception) and kind.__module__ == module.__name__
    ]


NO_ANSWER = {
    "TruepathError",  # the root
    "JobError",  # likewise
    "Aborted",  # no failure
    "Cancelled",  # likewise
    "TaskFailed",  # told by the family of what the task raised
    "InUse",  # likewise
}


@pytest.mark.parametrize(
    "family",
    [*families(app_errors), *families(job_errors), *families(device_errors)],
    ids=lambda family: f"{family.__module__}.{family.__name__}",
)
def test_every_family_of_errors_is_a_kind_of_problem(family):
    kind = next(
        (
            problems.PROBLEM_KINDS[f]
            for f in family.__mro__
            if f in problems.PROBLEM_KINDS
        ),
        None,
    )
    assert (kind is None) == (family.__name__ in NO_ANSWER)


def test_codes_and_titles_read_well():
    kinds = [
        *problems.PROBLEM_KINDS.values(),
        *problems.BY_STATUS.values(),
        problems.INTERNAL,
    ]
    for kind in kinds:
        assert re.fullmatch(r"[a-z]+(-[a-z]+)*", kind.code)
        assert not kind.title.endswith(".")
        assert kind.action.endswith((".", '"<version>".'))
        assert 400 <= kind.status < 600


def test_an_error_nobody_foresaw_is_internal_and_tells_nothing():
    content = problems.describe_error(KeyError("secret"))
    assert (content["status"], content["code"]) == (500, "internal-error")
    assert "secret" not in str(content)
    assert problems.find_kind(KeyError) is problems.INTERNAL


def test_a_failure_of_a_job_is_found_by_the_name_of_its_family():
    content = problems.describe_failure(Failure("BundleError", "tracker.csv: NaN"))
    assert content["code"] == "bundle"
    assert content["detail"] == "tracker.csv: NaN"
    assert "status" not in content


def test_a_failure_whose_family_has_no_kind_of_its_own_is_of_the_nearest():
    text = "127.0.0.1:5000 streams at up to 400 Hz, not at 500 Hz"
    failure = Failure("MeasurementEnded", text, "refused", "check the rate")
    content = problems.describe_failure(failure)
    assert content["detail"] == text
    assert content["title"] == "The measurement ended before its path did"
    assert (content["code"], content["action"]) == ("refused", "check the rate")


def test_a_failure_named_by_the_machine_keeps_its_code_and_way_out():
    failure = Failure("MachineFault", "the beam is lost", "beam-lost", "lock it")
    content = problems.describe_failure(failure)
    assert (content["code"], content["action"]) == ("beam-lost", "lock it")
    assert content["type"] == "/problems/beam-lost"
    assert content["title"] == "Machine, tracker or link failed"


@pytest.mark.parametrize(
    ("status", "code", "shown"),
    [(418, "bad-request", 418), (599, "internal-error", 500)],
)
def test_a_bare_status_becomes_the_nearest_kind(status, code, shown):
    kind = find_kind_of_status(status)
    assert (kind.code, kind.status) == (code, shown)
