"""The description says enough to generate a client from it."""

from __future__ import annotations

import re

import pytest
from described_answers import list_errors, read_document, resolve

from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import VERB_TRANSITIONS, State, Verb
from truepath.service.api.job_description import describe_job
from truepath.service.api.security.route_roles import LEAST_ROLES

OPERATIONS = {
    operation["operationId"]: operation
    for operations in read_document()["paths"].values()
    for operation in operations.values()
}
SCHEMAS = read_document()["components"]["schemas"]


def list_answers():
    for name, operation in OPERATIONS.items():
        for status, answer in operation["responses"].items():
            if status < "300":
                yield name, status, resolve(answer)


def walk(part, path=""):
    if isinstance(part, dict):
        yield path, part
        for key, value in part.items():
            yield from walk(value, f"{path}/{key}")
    elif isinstance(part, list):
        for index, value in enumerate(part):
            yield from walk(value, f"{path}/{index}")


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_and_each_of_its_parameters_is_described(name):
    operation = OPERATIONS[name]
    assert operation["summary"]
    assert operation["description"]
    for parameter in operation.get("parameters", ()):
        assert parameter.get("description"), parameter["name"]
        assert {"type", "anyOf", "$ref"} & set(parameter["schema"])


def test_every_answer_that_succeeds_has_a_type_and_an_example_of_it():
    missing = []
    for name, status, answer in list_answers():
        if status == "204":
            continue
        for media_type, content in answer["content"].items():
            if media_type == "text/event-stream":
                assert "event: job" in content["example"]
            elif "schema" not in content or "example" not in content:
                missing.append((name, media_type))
            else:
                missing += [
                    (name, each)
                    for each in list_errors(content["schema"], content["example"])
                ]
    assert not missing


def test_every_request_body_has_an_example_that_its_schema_takes():
    for name, operation in OPERATIONS.items():
        for content in operation.get("requestBody", {}).get("content", {}).values():
            schema = resolve(content["schema"])
            given = [content["example"]] if "example" in content else []
            examples = given or schema.get("examples", [])
            assert examples, name
            for example in examples:
                assert not list_errors(content["schema"], example), name


def test_no_object_of_the_interface_is_left_open():
    left_open = [
        f"{name}{path}"
        for name, schema in SCHEMAS.items()
        for path, part in walk(schema)
        if part.get("type") == "object"
        and "properties" not in part
        and part.get("additionalProperties", True) is True
    ]
    assert not left_open


def test_an_object_that_takes_further_keys_says_so():
    for name, schema in SCHEMAS.items():
        if schema.get("additionalProperties") is True:
            assert re.search(r"[Ff]urther|[Mm]ore keys", schema["description"]), name


def test_every_problem_has_an_example_of_each_of_its_codes():
    for name, answer in read_document()["components"]["responses"].items():
        (content,) = answer["content"].values()
        assert content["examples"]
        for code, example in content["examples"].items():
            assert example["value"]["code"] == code
            assert example["value"]["status"] == int(name.removeprefix("Problem"))
            assert not list_errors(content["schema"], example["value"])


def test_no_operation_has_an_answer_of_any_status():
    for name, operation in OPERATIONS.items():
        assert "default" not in operation["responses"], name


def test_what_moves_the_machine_requires_its_version():
    for name in ("arm_job", "resume_job"):
        (version,) = [
            p for p in OPERATIONS[name]["parameters"] if p["name"] == "if-match"
        ]
        assert version["required"]


def test_lists_of_names_say_that_they_may_grow():
    for name in ("State", "JobKind", "Stage", "Verb"):
        assert "More may be added" in SCHEMAS[name]["description"]


@pytest.mark.parametrize("state", State)
def test_every_verb_that_a_job_names_has_an_address(state):
    job = Job(JobKind.MEASURE_OTF, id="7", state=state, desired_state="ready")
    for verb, address in describe_job(job).links.verbs.items():
        assert address == f"/api/v1/jobs/7/{verb}"
        assert f"POST /api/v1/jobs/{{job_id}}/{verb}" in LEAST_ROLES


@pytest.mark.parametrize("state", State)
def test_a_job_names_the_verbs_that_its_state_allows_and_no_other(state):
    job = Job(JobKind.MEASURE_OTF, state=state)
    legal = {verb for verb, states in VERB_TRANSITIONS.items() if state in states}
    if state is State.RUNNING:
        legal.discard(Verb.PAUSE)  # its stage is not the measuring
    assert set(job.allowed_verbs) == legal


def test_a_job_that_computes_can_only_be_ended():
    assert Job(JobKind.ANALYSE, state=State.RUNNING).allowed_verbs == (
        Verb.CANCEL,
        Verb.ABORT,
    )
