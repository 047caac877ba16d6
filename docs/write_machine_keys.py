"""Writes the table of keys in machine-file.md from the models of the file.

python docs/write_machine_keys.py [--check]
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from page_section import write_section
from pydantic.fields import FieldInfo

from truepath.documents.file_model import FileModel
from truepath.files.bundle.machine_file import MachineFile

PAGE = Path(__file__).with_name("machine-file.md")
BEGIN, END = "<!-- keys -->", "<!-- end of keys -->"
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


def write_table() -> str:
    """Return the table of all keys but those of the tracker's specification."""
    head = ["| key | unit | left out | is |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *dict.fromkeys(_list_rows(MachineFile, ""))])


def _list_rows(model: type[FileModel], above: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        key = f"{above}{field.alias or name}"
        if field.description:
            row = f"`{key}`", _find_unit(name), _describe_default(field)
            yield f"| {' | '.join([*row, field.description])} |"
        for inner in _find_models(field.annotation):
            if name != "specification":
                yield from _list_rows(inner, f"{LIKE.get(key, key)}.")


def _find_models(annotation: object) -> Iterator[type[FileModel]]:
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


if __name__ == "__main__":
    sys.exit(write_section(PAGE, BEGIN, END, write_table))
