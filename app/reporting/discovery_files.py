"""The files of a discovery: report, lines to drive next, model and findings."""

from __future__ import annotations

from pathlib import Path

from app.files.commanded_file import encode_commanded
from app.files.file_model import encode_json
from app.files.whole_files import write_files
from app.reporting.analysis_files import REPORT
from app.reporting.discovery_report import render_discovery_report
from app.results.discovery import ASK, Discovered

DISCOVERY, MODEL = "discovery.json", "model.json"


def write_discovery(discovered: Discovered, folder: str | Path) -> None:
    """Write the files of a discovery into a folder, each whole or not at all."""
    found, asked = discovered.found, discovered.asked
    report = render_discovery_report(found, discovered.model, asked, ASK)
    files = {REPORT: report.encode()}
    if asked is None:
        (Path(folder) / ASK).unlink(missing_ok=True)  # that of an earlier discovery
    else:
        files[ASK] = encode_commanded(asked.path)
    # The discovery last: where it stands, the others stand as well.
    files[MODEL] = encode_json(discovered.model.content)
    files[DISCOVERY] = encode_json(discovered.content)
    write_files(Path(folder), files)
