"""Writes the tables of the documentation that the code states.

python docs/write_tables.py [--check] [NAME ...]

A table stands on its page between `<!-- NAME -->` and `<!-- end of NAME -->`. Without a
name all are written; with --check none is, and the exit code is 1 where one is not up
to date.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo
    from typer.core import TyperGroup

    from truepath.documents.file_model import FileModel

DOCS = Path(__file__).parent
Row = Iterable[object]

# Imported where it is used: a table needs only the code that states it.


def write_section(page: Path, name: str, text: str, *, check: bool) -> bool:
    """Write the text between the marks of a page; whether that changes it.

    check : leave the page as it is
    """
    old = page.read_text(encoding="utf-8")
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, rest = old.split(begin)
    new = f"{head}{begin}\n{text}\n{end}{rest.split(end)[1]}"
    if not check and new != old:
        page.write_text(new, encoding="utf-8")
    return new != old


def write_table(head: Row, rows: Iterable[Row]) -> str:
    """A table in Markdown."""
    lines = [[str(cell) for cell in line] for line in (head, *rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _write_addresses() -> str:
    document = json.loads((DOCS / "openapi.json").read_text(encoding="utf-8"))
    return write_table(
        ("address", "least role", "query", "does"),
        (
            (
                f"`{method.upper()} {path}`",
                operation["x-least-role"],
                ", ".join(
                    f"`{one['name']}`"
                    for one in operation.get("parameters", ())
                    if one["in"] == "query"
                ),
                operation["description"].partition("\n\n")[0].replace("\n", " "),
            )
            for path, operations in document["paths"].items()
            for method, operation in operations.items()
        ),
    )


def _write_problem_codes() -> str:
    from truepath.service.api.problems import BY_STATUS, PROBLEM_KINDS

    kinds = {(k.status, k.code): k for k in PROBLEM_KINDS.values()}
    kinds |= {(k.status, k.code): k for k in BY_STATUS.values()}
    rows = [(str(status), code, kinds[status, code].title) for status, code in kinds]
    known = {code for _, code in kinds}
    return "\n".join(
        [
            write_table(
                ("status", "code", "what it says"),
                ((status, f"`{code}`", title) for status, code, title in sorted(rows)),
            ),
            "",
            "The `error` of a job that has ended has one of these codes, without a "
            "status, or one of those that the machine, its tracker and the watch over "
            "them name; the notices and conditions of a measurement have the latter:",
            "",
            write_table(("code", "what it says"), _list_named_codes(known)),
        ]
    )


def _list_named_codes(known: set[str]) -> Iterator[Row]:
    """What the page words beside the kinds of problem."""
    file = files("truepath.service.page") / "static" / "locales" / "en.json"
    texts: dict[str, str] = json.loads(file.read_text("utf-8"))
    worded = "problem.code."
    codes = {k.removeprefix(worded): t for k, t in texts.items() if worded in k}
    for code, text in sorted(codes.items()):
        if not code.endswith("_action") and code not in known:
            yield f"`{code}`", text


def _write_commands() -> str:
    import typer

    from truepath.cli.command import app

    head = "command", "options", "does"
    return write_table(head, _list_commands(typer.main.get_group(app), ""))


def _list_commands(group: TyperGroup, before: str) -> Iterator[Row]:
    from typer.core import TyperGroup

    for word, command in group.commands.items():
        name = f"{before} {word}".strip()
        if isinstance(command, TyperGroup):
            yield from _list_commands(command, name)
            continue
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option"]
        words = [name, *(p.metavar or p.name.upper() for p in arguments)]
        listed = " ".join(f"`{p.opts[0]}`" for p in options)
        does = " ".join((command.help or "").partition("\n\n")[0].split())
        yield f"`{' '.join(words)}`", listed, does


def _write_settings() -> str:
    from truepath.operation.settings_text import list_settings

    def row(one: Any) -> Row:
        meaning = one.meaning.replace("|", "\\|")
        example = f" For example `{one.example}`." if one.example else ""
        default = f"`{one.default}`" if one.default else ""
        return f"`{one.name}`", default, f"{meaning}{example}", f"`{one.environment}`"

    head = "setting", "default", "meaning", "environment"
    return write_table(head, map(row, list_settings()))


def _write_faults() -> str:
    from truepath_simulators.faults import KINDS

    return write_table(
        ("device", "kind", "what happens", "amount"),
        (
            (
                device,
                f"`{name}`",
                kind.meaning,
                f"{kind.amount:g}" if kind.amount else "",
            )
            for device, kinds in KINDS.items()
            for name, kind in kinds.items()
        ),
    )


def _write_effects() -> str:
    from truepath.kinematics.effects.family import list_families

    return write_table(
        ("name", "cause", "looks like", "what to do", "of the"),
        (
            (
                f"`{family.name}`" + (" *" if not family.names_cause else ""),
                family.words["en"].cause,
                family.words["en"].looks_like,
                family.words["en"].remedy,
                "machine" if family.is_kept else "measurement",
            )
            for family in list_families()
        ),
    )


UNITS = {
    "mm": "mm",
    "deg": "deg",
    "um": "µm",
    "urad": "µrad",
    "ppm": "µm/m",
    "hz": "Hz",
    "m": "m",
    "mm_min": "mm/min",
    "mm_s2": "mm/s²",
    "mm_s3": "mm/s³",
}
LIKE = {
    "axes.Y": "axes.X",
    "axes.Z": "axes.X",
    "axes.A": "axes.C",
    "axes.B": "axes.C",
    "targets": "targets.NAME",
}
"""Keys of the machine file whose rows are those of others."""


def _write_machine_keys() -> str:
    """All keys but those of the tracker's specification."""
    from truepath.files.bundle.machine_file import MachineFile

    head = "key", "unit", "left out", "is"
    return write_table(head, dict.fromkeys(_list_keys(MachineFile, "")))


def _list_keys(model: type[FileModel], above: str) -> Iterator[Row]:
    for name, field in model.model_fields.items():
        key = f"{above}{field.alias or name}"
        if field.description:
            yield (
                f"`{key}`",
                _find_unit(name),
                _describe_default(field),
                field.description,
            )
        for inner in _find_models(field.annotation):
            if name != "specification":
                yield from _list_keys(inner, f"{LIKE.get(key, key)}.")


def _find_models(annotation: object) -> Iterator[type[FileModel]]:
    from truepath.documents.file_model import FileModel

    if isinstance(annotation, type) and issubclass(annotation, FileModel):
        yield annotation
    for part in get_args(annotation):
        yield from _find_models(part)


def _find_unit(name: str) -> str:
    ends = (end for end in sorted(UNITS, key=len, reverse=True))
    return UNITS.get(next((e for e in ends if name.endswith(f"_{e}")), ""), "")


def _describe_default(field: FieldInfo) -> str:
    if field.is_required():
        return "refused"
    if field.default_factory:
        return ""
    return f"`{json.dumps(field.default)}`" if field.default is not None else ""


def _write_register_blocks() -> str:
    from truepath_drivers.cnc.modbus import registers as r

    blocks = [
        ("identity", r.IDENTITY, "read once"),
        ("status", r.STATUS, "polled"),
        ("readiness", r.READINESS, "polled where `features` tells it"),
        ("alarm text", r.ALARM_TEXT, "read in ALARM"),
        ("control", r.CONTROL, "heartbeat and watchdog"),
        ("limits", r.LIMITS, "may be missing: exception 2"),
        ("command", r.COMMAND, "written in one request"),
    ]
    return write_table(
        ("block", "first", "registers", "use"),
        ((name, block.address, block.count, use) for name, block, use in blocks),
    )


def _write_registers() -> str:
    from truepath_drivers.cnc.modbus import registers as r

    def row(register: r.Register) -> Row:
        last = register.end - 1
        place = f"{register.address}–{last}" if last > register.address else last
        several = f" × {register.count}" if register.count > 1 else ""
        kind = f"{register.kind}{several}"
        name = f"`{register.name}`"
        return place, name, kind, register.access, register.unit, register.meaning

    head = "address", "name", "type", "access", "unit", "meaning"
    return write_table(head, map(row, r.REGISTERS))


def _write_register_commands() -> str:
    from truepath_drivers.cnc.modbus import registers as r

    def states(command: r.Command) -> str:
        allowed = r.ALLOWED[command]
        if len(allowed) == len(r.STATES):
            return "any"
        return ", ".join(s.name for s in r.STATES if s in allowed)

    rows = ((c.value, c.name, states(c)) for c in r.Command)
    return write_table(("code", "verb", "in state"), rows)


def _write_register_results() -> str:
    from truepath_drivers.cnc.modbus import registers as r

    return write_table(("code", "result"), ((c.value, c.name) for c in r.Result))


def _write_register_states() -> str:
    from truepath_drivers.cnc.modbus import registers as r

    rows = ((code, state.name) for code, state in enumerate(r.STATES))
    return write_table(("code", "state"), rows)


TABLES: dict[str, tuple[str, Callable[[], str]]] = {
    "addresses": ("rest-api.md", _write_addresses),
    "codes": ("rest-api.md", _write_problem_codes),
    "commands": ("command-line.md", _write_commands),
    "settings": ("settings.md", _write_settings),
    "faults": ("simulators.md", _write_faults),
    "effects": ("discovery.md", _write_effects),
    "machine keys": ("machine-file.md", _write_machine_keys),
    "register blocks": ("modbus-register-map.md", _write_register_blocks),
    "registers": ("modbus-register-map.md", _write_registers),
    "register commands": ("modbus-register-map.md", _write_register_commands),
    "register results": ("modbus-register-map.md", _write_register_results),
    "register states": ("modbus-register-map.md", _write_register_states),
}
"""Page and text of each table by its name."""


def main(names: Iterable[str], *, check: bool) -> int:
    """Write these tables, or all; 1 where `check` finds one not up to date."""
    changed = [
        write_section(DOCS / page, name, write(), check=check)
        for name, (page, write) in ((n, TABLES[n]) for n in list(names) or TABLES)
    ]
    return int(check and any(changed))


if __name__ == "__main__":
    words = sys.argv[1:]
    wanted = [word for word in words if word != "--check"]
    sys.exit(main(wanted, check="--check" in words))
