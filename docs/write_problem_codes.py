"""Writes the tables of codes in rest-api.md from the kinds of problem of the service.

python docs/write_problem_codes.py [--check]
"""

from __future__ import annotations

import json
import sys
from importlib.resources import files
from pathlib import Path

from page_section import write_section

from truepath.service.api.problems import BY_STATUS, PROBLEM_KINDS

PAGE = Path(__file__).with_name("rest-api.md")
BEGIN, END = "<!-- codes -->", "<!-- end of codes -->"
_WORDED = "problem.code."


def write_tables() -> str:
    """Return the table of the kinds of problem, and that of what a machine names."""
    kinds = {(k.status, k.code): k for k in PROBLEM_KINDS.values()}
    kinds |= {(k.status, k.code): k for k in BY_STATUS.values()}
    rows = [(str(status), code, kinds[status, code].title) for status, code in kinds]
    known = {code for _, code in kinds}
    return "\n".join(
        [
            "| status | code | what it says |",
            "| --- | --- | --- |",
            *(f"| {s} | `{code}` | {title} |" for s, code, title in sorted(rows)),
            "",
            "The `error` of a job that has ended has one of these codes, without a "
            "status, or one of those that the machine, its tracker and the watch over "
            "them name; the notices and conditions of a measurement have the latter:",
            "",
            "| code | what it says |",
            "| --- | --- |",
            *(f"| `{code}` | {title} |" for code, title in _list_named(known)),
        ]
    )


def _list_named(known: set[str]) -> list[tuple[str, str]]:
    """Return what the page words beside the kinds of problem."""
    file = files("truepath.service.page") / "static" / "locales" / "en.json"
    texts: dict[str, str] = json.loads(file.read_text("utf-8"))
    codes = {k.removeprefix(_WORDED): t for k, t in texts.items() if _WORDED in k}
    return sorted(
        (code, text)
        for code, text in codes.items()
        if not code.endswith("_action") and code not in known
    )


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_tables))
