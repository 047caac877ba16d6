"""The files of a plan: commanded rows, NC programs, `plan.json`, and a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

from app.files.commanded_file import encode_commanded
from app.files.file_model import encode_json
from app.files.whole_files import write_files
from app.motion.nc_programs.programs import (
    list_dialects,
    name_file,
    write_program,
)
from app.planning.plan import Plan
from app.reporting.plan_report import render_plan_report
from app.results.plan_document import plan_document
from drivers.interfaces.records import Path


def write_plan(
    planned: Plan, folder: FilePath, controls: Sequence[str] = ()
) -> dict[str, Any]:
    """Write the files of a plan and return the content of `plan.json`.

    controls : whose NC programs are written; of all where left out

    Raises BadInput, nothing written, if a control cannot drive the plan.
    """
    commanded, machine = planned.commanded, planned.machine
    rows = "path.csv" if isinstance(commanded, Path) else "points.csv"
    files = {rows: encode_commanded(commanded)}
    feed = planned.order.feeds_mm_min[0]
    for control in controls or list_dialects():
        text = write_program(commanded, machine, control, feed_mm_min=feed)
        files[f"{control}/{name_file(text, control)}"] = text.encode()
    document = plan_document(planned) | {"files": [*files, "plan.json", "plan.html"]}
    files["plan.json"] = encode_json(document, indent=1)
    files["plan.html"] = render_plan_report(document).encode()
    write_files(folder, files)
    return document
