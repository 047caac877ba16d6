"""Writes the table of faults in simulators.md from the kinds that simulators know.

python docs/write_faults.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from page_section import write_section

from truepath_simulators.faults import KINDS

PAGE = Path(__file__).with_name("simulators.md")
BEGIN, END = "<!-- faults -->", "<!-- end of faults -->"


def write_table() -> str:
    """Return the table of the faults of each device."""
    head = ["| device | kind | what happens | amount |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *_list_rows()])


def _list_rows() -> Iterator[str]:
    for device, kinds in KINDS.items():
        for name, kind in kinds.items():
            amount = f"{kind.amount:g}" if kind.amount else ""
            yield f"| {device} | `{name}` | {kind.meaning} | {amount} |"


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_table))
