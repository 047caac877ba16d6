"""Writes the tables of modbus-register-map.md from the data in the driver.

python docs/write_register_map.py [--check]
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from truepath_drivers.cnc.modbus import registers as r

PAGE = Path(__file__).with_name("modbus-register-map.md")


def _table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    lines = [list(head), *([str(cell) for cell in row] for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _blocks() -> str:
    blocks = [
        ("identity", r.IDENTITY, "read once"),
        ("status", r.STATUS, "polled"),
        ("readiness", r.READINESS, "polled where `features` tells it"),
        ("alarm text", r.ALARM_TEXT, "read in ALARM"),
        ("control", r.CONTROL, "heartbeat and watchdog"),
        ("limits", r.LIMITS, "may be missing: exception 2"),
        ("command", r.COMMAND, "written in one request"),
    ]
    return _table(
        ("block", "first", "registers", "use"),
        ((name, block.address, block.count, use) for name, block, use in blocks),
    )


def _registers() -> str:
    def row(register: r.Register) -> tuple[object, ...]:
        last = register.end - 1
        place = f"{register.address}–{last}" if last > register.address else last
        several = f" × {register.count}" if register.count > 1 else ""
        return (
            place,
            f"`{register.name}`",
            f"{register.kind}{several}",
            register.access,
            register.unit,
            register.meaning,
        )

    head = ("address", "name", "type", "access", "unit", "meaning")
    return _table(head, map(row, r.REGISTERS))


def _commands() -> str:
    def states(command: r.Command) -> str:
        allowed = r.ALLOWED[command]
        if len(allowed) == len(r.STATES):
            return "any"
        return ", ".join(s.name for s in r.STATES if s in allowed)

    return _table(
        ("code", "verb", "in state"), ((c.value, c.name, states(c)) for c in r.Command)
    )


def _results() -> str:
    return _table(("code", "result"), ((c.value, c.name) for c in r.Result))


def _states() -> str:
    return _table(
        ("code", "state"), ((code, s.name) for code, s in enumerate(r.STATES))
    )


TABLES: dict[str, Callable[[], str]] = {
    "blocks": _blocks,
    "registers": _registers,
    "commands": _commands,
    "results": _results,
    "states": _states,
}


def filled(page: str) -> str:
    """Return the page with every table between its markers written anew."""

    def table(found: re.Match[str]) -> str:
        return f"<!-- table: {found[1]} -->\n{TABLES[found[1]]()}\n<!-- end -->"

    return re.sub(r"<!-- table: (\w+) -->\n.*?<!-- end -->", table, page, flags=re.S)


def main() -> int:
    """Write the page, or with --check tell whether it is up to date."""
    old = PAGE.read_text()
    new = filled(old)
    if "--check" in sys.argv[1:]:
        return int(old != new)
    PAGE.write_text(new)
    return 0


if __name__ == "__main__":
    sys.exit(main())
