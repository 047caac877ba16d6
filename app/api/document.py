"""The OpenAPI document beyond what the framework writes of the routes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from truepath.app.api.document_examples import add_examples
from truepath.app.api.document_headers import add_headers
from truepath.app.api.document_refusals import add_refusals
from truepath.app.api.route_roles import describe_roles

_OPEN = "More may be added: a reader keeps to what it knows."


def complete_document(document: dict[str, Any]) -> dict[str, Any]:
    """Return the document with roles, refusals, headers, examples and open lists."""
    describe_roles(document)
    add_refusals(document)
    add_headers(document)
    add_examples(document)
    _open_lists(document)
    return document


def _open_lists(document: dict[str, Any]) -> None:
    """Say of every list of names in an answer that it may grow."""
    schemas = document["components"]["schemas"]
    answered = {
        name
        for operations in document["paths"].values()
        for operation in operations.values()
        for response in operation["responses"].values()
        for name in _list_references(response)
    }
    waiting = list(answered)
    while waiting:
        for name in _list_references(schemas[waiting.pop()]):
            if name not in answered:
                answered.add(name)
                waiting.append(name)
    for name in sorted(answered):
        for listed in _find_lists(schemas[name]):
            said = f"{listed.get('description', '')} {_OPEN}"
            listed["description"] = said.strip()


def _list_references(part: Any) -> Iterator[str]:
    """Yield the names of the schemas that a part of the document refers to."""
    for each in _walk(part):
        name = each.get("$ref", "")
        if isinstance(name, str) and name.startswith("#/components/schemas/"):
            yield name.rpartition("/")[2]


def _find_lists(schema: Any) -> Iterator[dict[str, Any]]:
    for each in _walk(schema):
        if isinstance(each.get("enum"), list):
            yield each


def _walk(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        yield part
        part = part.values()
    elif not isinstance(part, list):
        return
    for each in part:
        yield from _walk(each)
