"""Requests drawn from the description of the interface: every answer is as it says."""

import json
from importlib import resources

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi import checks

from described_answers import read_document
from truepath.service.api.application import create_application

HEADERS = {"host": "127.0.0.1"}
CHECKS = [
    not_a_server_error,
    checks.status_code_conformance,
    checks.content_type_conformance,
    checks.response_headers_conformance,
    checks.response_schema_conformance,
]
EXAMPLES = json.loads(
    resources.files("truepath.service.api").joinpath("examples.json").read_text()
)
OPERATIONS = sorted(
    (path, method)
    for path, methods in read_document()["paths"].items()
    for method in methods
    if not path.endswith("/events")  # endless
)


@pytest.fixture
def planner(planner):
    document = EXAMPLES["get_plan"]["document"]
    return lambda *order, on_progress: (
        planner(*order, on_progress=on_progress) | {"document": document}
    )


@pytest.fixture
def described(service):
    found = schemathesis.openapi.from_dict(
        read_document()
    )  # described once, not each time
    found.app = create_application(service)
    return found


def check_answers(described, path, method, most):
    @settings(
        max_examples=most,
        deadline=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )
    @given(case=described[path][method].as_strategy())
    def check(case):
        case.validate_response(case.call(headers=HEADERS), checks=CHECKS)

    check()


@pytest.mark.database
@pytest.mark.fault_row(35)
@pytest.mark.timeout(240)
def test_every_answer_is_documented(described):
    for path, method in OPERATIONS:
        check_answers(described, path, method, 2)


@pytest.mark.long
@pytest.mark.parametrize(("path", "method"), OPERATIONS)
@pytest.mark.timeout(120)
def test_every_answer_to_many_requests_is_documented(described, path, method):
    check_answers(described, path, method, 20)
