"""Writes the table of addresses in rest-api.md from openapi.json.

python docs/write_addresses.py [--check]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from page_section import write_section

PAGE = Path(__file__).with_name("rest-api.md")
BEGIN, END = "<!-- addresses -->", "<!-- end of addresses -->"


def write_table() -> str:
    """Return the table of all addresses, in the order of the document."""
    head = ["| address | least role | query | does |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *_list_rows()])


def _list_rows() -> Iterator[str]:
    document = json.loads(PAGE.with_name("openapi.json").read_text(encoding="utf-8"))
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            role, query = operation["x-least-role"], _list_query(operation)
            does = operation["description"].partition("\n\n")[0].replace("\n", " ")
            yield f"| `{method.upper()} {path}` | {role} | {query} | {does} |"


def _list_query(operation: dict[str, Any]) -> str:
    parameters = operation.get("parameters", ())
    return ", ".join(f"`{p['name']}`" for p in parameters if p["in"] == "query")


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_table))
