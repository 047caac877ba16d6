"""Writes the table of reliability.md: marks of the tests and what they measured.

python docs/write_reliability.py [--check]

`make reliability` runs the marked tests, writes what they measured to
reliability-measured.json, and then the table.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from write_tables import write_section

PAGE = Path(__file__).with_name("reliability.md")
TESTS = Path(__file__).parents[1] / "tests"
MEASURED = PAGE.with_name("reliability-measured.json")
MOST_TEXTS = 8
_ROW = re.compile(r"pytest\.mark\.fault_row\((\d+)\)")
ROWS = (
    ("bits of the stream flip", "frames are refused and counted; many hold the feed"),
    ("frames are lost, doubled, swapped", "gaps are counted; nothing is taken twice"),
    ("a megabyte of noise", "bounded memory; the next frame is read"),
    ("reads of one byte, or joined", "the same samples"),
    ("the tracker is silent", "a hold that ends by itself; a fault when it lasts"),
    ("cable pulled, port renumbered", "told; opened again; identity checked"),
    ("another device on the port", "refused by name"),
    ("a slow link", "time is the device's; no false loss of the beam"),
    (
        "the beam is broken",
        "hold; samples without it are left out, a dwell begins anew",
    ),
    ("a warning of the tracker", "told, recorded, in the report"),
    ("the reflector is knocked", "told, placed in time, lines driven again"),
    (
        "spikes, a frozen value, no number",
        "named and left out; never a result in silence",
    ),
    ("exceptions of Modbus", "busy is waited for; the others are named"),
    ("no reply, half a reply, a bad CRC", "told within 0.5 s; nothing runs twice"),
    ("an older reply, another unit", "not taken"),
    ("resets, black holes, slow replies", "told in time; connected anew with back-off"),
    ("a write that is not kept", "found by reading back; nothing starts"),
    ("words in another order", "refused before the first motion"),
    ("alarm, emergency stop", "a fault with its words; the Run is kept"),
    ("held at the panel, override at 0 %", "told; goes on from the panel"),
    ("another program, or one that ends early", "a fault, or named in the result"),
    ("the machine is not where it was sent", "the point is not taken in silence"),
    ("the cell is killed or frozen", "the machine holds; the job says so"),
    ("a path beyond the travel", "refused before motion, by row and axis"),
    ("kill -9 at any moment", "nothing acknowledged is lost; nothing moves"),
    ("a damaged Run file", "committed batches are read; damage is named"),
    ("the disk is full or fails", "hold before loss; a clear line"),
    ("a slow disk", "bounded queue; hold before it overflows"),
    ("the wall clock jumps", "durations and order stay right"),
    ("processes that stand still", "deadlines fire; the feed is held"),
    ("a busy computer", "no sample lost, or each one counted"),
    ("many, slow or absent clients", "abort in time; acquisition is not slowed"),
    ("the same request twice, two operators", "one job; the second is refused"),
    ("every verb in every state", "only what the table of states allows"),
    ("hostile requests", "a problem, never a 5xx"),
    ("hostile files", "refused by file, row and column"),
    ("the catalogue is locked, newer, gone", "waited for, or refused with a way out"),
    ("workers or scheduler are killed", "the same bits, or a failure by name"),
    ("too few or parallel lines", "names what is not determined"),
    ("SIGTERM in motion", "the feed is held first; ends in time"),
    ("the tracker repeats one place bit for bit", "held by name; never taken"),
    ("axis positions that cannot be", "two in a row hold the feed, by name"),
    ("sensor readings that cannot be", "left out, counted, shown with the reason"),
    (
        "every reply of the link is late",
        "held blind within 0.5 s of the last right one",
    ),
    ("connections are used up", "a stop still arrives"),
    ("many windows, blocked streams, uploads", "ABORT arrives within 1 s"),
    ("a proxy before the service", "page and ABORT work, or the page says they do not"),
    ("a job has ended and the disk is full", "an end stays the end"),
    ("a plug-in that hangs, lies or breaks", "held in time; named; the others work"),
)


def _list_marks(file: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield (row, name of the test, whether it is long) of a file's marked tests."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.FunctionDef):
            continue
        is_long = "pytest.mark.long" in map(ast.unparse, node.decorator_list)
        for one in node.decorator_list:
            for marked in _list_marked(one):
                text = ast.unparse(marked)
                for row in map(int, _ROW.findall(text)):
                    yield row, node.name, is_long or "pytest.mark.long" in text


def _list_marked(decorator: ast.expr) -> list[ast.expr]:
    """Return the cases of a test that have marks of their own, or the mark itself."""
    cases = [
        node
        for node in ast.walk(decorator)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.param"
    ]
    return list[ast.expr](cases) or [decorator]


def _find_tests() -> dict[int, list[str]]:
    found: dict[int, list[str]] = defaultdict(list)
    for file in sorted(TESTS.rglob("test_*.py")):
        place = file.relative_to(TESTS).as_posix()
        for row, name, is_long in _list_marks(file):
            words = f"`{place}::{name}`" + " (long)" * is_long
            if words not in found[row]:
                found[row].append(words)
    return found


def _read_measured() -> dict[int, list[str]]:
    """Return what was measured of each row, in the order of the tests."""
    if not MEASURED.is_file():
        return {}
    content = json.loads(MEASURED.read_text(encoding="utf-8"))
    return {
        int(row): list(dict.fromkeys(chain.from_iterable(tests.values())))
        for row, tests in content.items()
    }


def _join_measured(texts: list[str]) -> str:
    if not texts:
        return "not measured yet"
    more = len(texts) - MOST_TEXTS
    shown = [text.replace("|", "/") for text in texts[:MOST_TEXTS]]
    return "; ".join(shown) + (f"; and {more} more" if more > 0 else "")


def write_table() -> str:
    """Return the table of all rows."""
    found, measured = _find_tests(), _read_measured()
    lines = [
        "| row | fault | what happens | measured | tests |",
        "| --- | --- | --- | --- | --- |",
    ]
    for number, (fault, answer) in enumerate(ROWS, 1):
        tests = "<br>".join(found.get(number, ["none yet"]))
        numbers = _join_measured(measured.get(number, []))
        lines.append(f"| {number} | {fault} | {answer} | {numbers} | {tests} |")
    return "\n".join(lines)


if __name__ == "__main__":
    check = "--check" in sys.argv[1:]
    changed = write_section(PAGE, "rows", write_table(), check=check)
    sys.exit(check and changed)
