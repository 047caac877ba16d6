"""Answers held against the description of the interface: status, headers, content."""

import json
from functools import cache
from pathlib import Path

from jsonschema import Draft202012Validator

from truepath.service.api.route_roles import find_route

DOCUMENT = Path(__file__).parents[2] / "docs" / "openapi.json"


@cache
def read_document():
    """Return the checked-in description; a test of it proves that it is current."""
    return json.loads(DOCUMENT.read_text(encoding="utf-8"))


def _close(part):
    """Return a schema that takes no key but its own, unless it says so."""
    if isinstance(part, list):
        return [_close(each) for each in part]
    if not isinstance(part, dict):
        return part
    closed = {key: _close(value) for key, value in part.items()}
    if closed.get("type") == "object" and "properties" in closed:
        closed.setdefault("additionalProperties", False)
    return closed


@cache
def _make_validator(schema):
    components = {"schemas": _close(read_document()["components"]["schemas"])}
    return Draft202012Validator({**json.loads(schema), "components": components})


def list_errors(schema, instance):
    errors = _make_validator(json.dumps(schema)).iter_errors(instance)
    places = (("/".join(map(str, one.absolute_path)), one.message) for one in errors)
    return [f"{place}: {message[:300]}" for place, message in places]


def resolve(part):
    if "$ref" not in part:
        return part
    found = read_document()
    for name in part["$ref"].removeprefix("#/").split("/"):
        found = found[name]
    return found


def check_answer(response):
    """Fail where an answer is not as it is described; a hook of a client."""
    request = response.request
    method, _, path = find_route(request.method, request.url.path).partition(" ")
    operation = read_document()["paths"].get(path, {}).get(method.lower())
    if operation is None or request.method == "HEAD":
        return
    name, status = operation["operationId"], str(response.status_code)
    assert status in operation["responses"], f"{name} answers {status}"
    described = resolve(operation["responses"][status])
    for header, content in described.get("headers", {}).items():
        is_there = header in response.headers
        assert is_there or not resolve(content)["required"], (name, status, header)
    media_type = response.headers.get("content-type", "").partition(";")[0]
    if not described.get("content"):
        return
    assert media_type in described["content"], (name, status, media_type)
    if media_type.endswith("json"):
        response.read()
        schema = described["content"][media_type]["schema"]
        errors = list_errors(schema, response.json())
        assert not errors, (name, status, errors)
