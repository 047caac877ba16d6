"""The interface as it describes itself, and answers that are as it says."""

import inspect
import json
import re
import runpy
import sys
from importlib import resources
from urllib.parse import urljoin

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from pydantic import TypeAdapter
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi import checks

from described_answers import DOCUMENT, list_errors, read_document, resolve
from truepath import errors as app_errors
from truepath.catalogue import errors as job_errors
from truepath.catalogue.job import Failure, Job, JobKind
from truepath.catalogue.transitions import VERB_TRANSITIONS, State, Verb
from truepath.service.api import application, problems
from truepath.service.api.job import describe_job
from truepath.service.api.models.job_request import JobRequest
from truepath.service.api.route_roles import LEAST_ROLES
from truepath_drivers.interfaces import errors as device_errors


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
def test_the_checked_in_description_is_what_its_command_writes(tmp_path, monkeypatch):
    module, file = "truepath.service.api.application", tmp_path / "openapi.json"
    monkeypatch.setattr(sys, "argv", [module, str(file)])
    runpy.run_module(module, run_name="__main__")
    command = f"python -m {module} docs/openapi.json"
    assert file.read_bytes() == DOCUMENT.read_bytes(), command


def test_the_only_documentation_comes_from_the_service_itself(client, is_problem):
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
    assert client.get("/api/v1/openapi.json").json() == read_document()
    is_problem(client.get("/redoc"), 404, "not-found")


# Roots, what is no failure, and what is told by the family of what a task raised.
NO_ANSWER = {"TruepathError", "JobError", "Aborted", "Cancelled", "TaskFailed", "InUse"}


def test_every_family_of_errors_is_a_kind_of_problem():
    without = {
        name
        for module in (app_errors, job_errors, device_errors)
        for name, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Exception) and kind.__module__ == module.__name__
        if not any(one in problems.PROBLEM_KINDS for one in kind.__mro__)
    }
    assert without == NO_ANSWER


def test_a_failure_of_a_job_is_a_problem_of_its_family_with_its_own_code_and_way_out():
    content = problems.describe_failure(Failure("BundleError", "tracker.csv: NaN"))
    assert (content["code"], content["detail"]) == ("bundle", "tracker.csv: NaN")
    assert "status" not in content
    text = "127.0.0.1:5000 streams at up to 400 Hz, not at 500 Hz"
    failure = Failure("MeasurementEnded", text, "refused", "check the rate")
    content = problems.describe_failure(failure)
    assert content["detail"] == text
    assert content["title"] == "The measurement ended before its path did"
    assert (content["code"], content["action"]) == ("refused", "check the rate")
    failure = Failure("MachineFault", "the beam is lost", "beam-lost", "lock it")
    content = problems.describe_failure(failure)
    assert (content["code"], content["action"]) == ("beam-lost", "lock it")
    assert content["type"] == "/problems/beam-lost"
    assert content["title"] == "Machine, tracker or link failed"


def test_an_error_or_status_nobody_foresaw_is_of_the_nearest_kind_and_tells_nothing():
    content = problems.describe_error(KeyError("secret"))
    assert (content["status"], content["code"]) == (500, "internal-error")
    assert "secret" not in str(content)
    assert problems.find_kind(KeyError) is problems.INTERNAL
    for status, told in ((418, ("bad-request", 418)), (599, ("internal-error", 500))):
        kind = problems.find_kind_of_status(status)
        assert (kind.code, kind.status) == told


OPERATIONS = {
    operation["operationId"]: operation
    for operations in read_document()["paths"].values()
    for operation in operations.values()
}
SCHEMAS = read_document()["components"]["schemas"]


def walk(part, path=""):
    if isinstance(part, dict):
        yield path, part
        for key, value in part.items():
            yield from walk(value, f"{path}/{key}")
    elif isinstance(part, list):
        for index, value in enumerate(part):
            yield from walk(value, f"{path}/{index}")


def test_every_operation_and_each_of_its_parameters_is_described():
    tags = {tag["name"] for tag in read_document()["tags"]}
    for name, operation in OPERATIONS.items():
        assert re.fullmatch(r"[a-z]+(_[a-z]+)+", name)
        assert operation["summary"], name
        assert operation["description"].endswith("."), name
        assert set(operation["tags"]) <= tags, name
        assert "default" not in operation["responses"], name
        for parameter in operation.get("parameters", ()):
            assert parameter.get("description"), (name, parameter["name"])
            assert {"type", "anyOf", "$ref"} & set(parameter["schema"])


def test_paths_have_versions_reading_no_conflicts_and_every_refusal_is_a_problem():
    paths = read_document()["paths"].items()
    listed = [(path, *one) for path, methods in paths for one in methods.items()]
    assert len(OPERATIONS) == len(listed)
    probes = {path for path, _, _ in listed if not path.startswith("/api/v1/")}
    assert probes == {"/healthz", "/metrics", "/readyz"}
    for path, method, operation in listed:
        assert method != "get" or "409" not in operation["responses"], path
        for status, answer in operation["responses"].items():
            if status >= "400":
                refused = f"#/components/responses/Problem{status}"
                assert answer == {"$ref": refused}, path
    for name, answer in read_document()["components"]["responses"].items():
        (content,) = answer["content"].values()
        assert content["examples"]
        for code, example in content["examples"].items():
            assert example["value"]["code"] == code
            assert example["value"]["status"] == int(name.removeprefix("Problem"))
            assert not list_errors(content["schema"], example["value"])


def test_every_body_and_every_answer_that_succeeds_has_an_example_of_its_type():
    answers = [
        (name, media_type, content)
        for name, operation in OPERATIONS.items()
        for status, answer in operation["responses"].items()
        if status < "300" and status != "204"
        for media_type, content in resolve(answer)["content"].items()
    ]
    for name, media_type, content in answers:
        if media_type == "text/event-stream":
            assert "event: job" in content["example"]
        else:
            assert {"schema", "example"} <= set(content), (name, media_type)
            assert not list_errors(content["schema"], content["example"]), name
    for name, operation in OPERATIONS.items():
        for content in operation.get("requestBody", {}).get("content", {}).values():
            schema = resolve(content["schema"])
            given = [content["example"]] if "example" in content else []
            examples = given or schema.get("examples", [])
            assert examples, name
            for example in examples:
                assert not list_errors(content["schema"], example), name
                if name == "create_job":
                    TypeAdapter(JobRequest).validate_python(example)


def test_no_object_is_left_open_and_what_may_grow_or_moves_the_machine_says_so():
    left_open = [
        f"{name}{path}"
        for name, schema in SCHEMAS.items()
        for path, part in walk(schema)
        if part.get("type") == "object"
        and "properties" not in part
        and part.get("additionalProperties", True) is True
    ]
    assert not left_open
    for name, schema in SCHEMAS.items():
        if schema.get("additionalProperties") is True:
            assert re.search(r"[Ff]urther|[Mm]ore keys", schema["description"]), name
    for name in ("State", "JobKind", "Stage", "Verb"):
        assert "More may be added" in SCHEMAS[name]["description"]
    for name in ("arm_job", "resume_job"):  # what moves the machine
        parameters = {one["name"]: one for one in OPERATIONS[name]["parameters"]}
        assert parameters["if-match"]["required"]


def test_a_job_names_the_verbs_that_its_state_allows_each_with_its_address():
    for state in State:
        job = Job(JobKind.MEASURE_OTF, id="7", state=state, desired_state="ready")
        for verb, address in describe_job(job).links.verbs.items():
            assert address == f"/api/v1/jobs/7/{verb}"
            assert f"POST /api/v1/jobs/{{job_id}}/{verb}" in LEAST_ROLES
        legal = {verb for verb, states in VERB_TRANSITIONS.items() if state in states}
        if state is State.RUNNING:
            legal.discard(Verb.PAUSE)  # its stage is not the measuring
        assert set(job.allowed_verbs) == legal
    computing = Job(JobKind.ANALYSE, state=State.RUNNING)
    assert computing.allowed_verbs == (Verb.CANCEL, Verb.ABORT)


SLOW = [HealthCheck.too_slow, HealthCheck.filter_too_much]
DRAWN = settings(deadline=None, derandomize=True, phases=[Phase.generate])
DRAWN = settings(DRAWN, suppress_health_check=SLOW)
CHECKS = [
    not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
]
EXAMPLES = resources.files("truepath.service.api").joinpath("examples.json")
ROUTES = sorted(
    (path, method)
    for path, methods in read_document()["paths"].items()
    for method in methods
    if not path.endswith("/events")  # endless
)


@pytest.fixture
def planner(planner):
    more = {"document": json.loads(EXAMPLES.read_text())["get_plan"]["document"]}
    return lambda *order, on_progress: planner(*order, on_progress=on_progress) | more


@pytest.fixture
def described(service):
    found = schemathesis.openapi.from_dict(read_document())
    found.app = application.create_application(service)
    return found


def check_answers(described, path, method, most):
    @settings(DRAWN, max_examples=most)
    @given(case=described[path][method].as_strategy())
    def check(case):
        case.validate_response(case.call(headers={"host": "127.0.0.1"}), checks=CHECKS)

    check()


@pytest.mark.database
@pytest.mark.fault_row(35)
@pytest.mark.timeout(240)
def test_every_answer_is_documented(described):
    for path, method in ROUTES:
        check_answers(described, path, method, 2)


@pytest.mark.long
@pytest.mark.parametrize(("path", "method"), ROUTES)
@pytest.mark.timeout(120)
def test_every_answer_to_many_requests_is_documented(described, path, method):
    check_answers(described, path, method, 20)
