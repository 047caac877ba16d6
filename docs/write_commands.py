"""Writes the table of commands in command-line.md from the commands of `truepath`.

python docs/write_commands.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import typer
from page_section import write_section
from typer.core import TyperGroup

from truepath.cli.command import app

PAGE = Path(__file__).with_name("command-line.md")
BEGIN, END = "<!-- commands -->", "<!-- end of commands -->"


def write_table() -> str:
    """Return the table of all commands."""
    head = ["| command | options | does |", "| --- | --- | --- |"]
    return "\n".join([*head, *_list_rows(typer.main.get_group(app), "")])


def _list_rows(group: TyperGroup, before: str) -> Iterator[str]:
    for word, command in group.commands.items():
        name = f"{before} {word}".strip()
        if isinstance(command, TyperGroup):
            yield from _list_rows(command, name)
            continue
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option"]
        words = [name, *(p.metavar or p.name.upper() for p in arguments)]
        listed = " ".join(f"`{p.opts[0]}`" for p in options)
        does = " ".join((command.help or "").partition("\n\n")[0].split())
        yield f"| `{' '.join(words)}` | {listed} | {does} |"


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_table))
