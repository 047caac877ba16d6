"""Repair of a Run whose writer was killed or whose disk failed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from truepath.documents.whole_files import sync_to_disk
from truepath.measurement.messages import RunClosed
from truepath.measurement.run_file.run_file import (
    CLOSED,
    connect,
    create_run_file,
    hash_file,
    insert_batches,
    put_manifest,
    seal,
    transaction,
)
from truepath.measurement.run_file.run_loader import NAMED_PROBLEMS, TORN, read_samples
from truepath.measurement.run_file.run_salvage import RunContent, find_log, read_content


def repair_run(file: str | Path) -> RunClosed:
    """Make one closed file of a Run whose writer was killed.

    What SQLite itself cannot repair is copied batch by batch into a new file; the
    damaged one is kept beside it as `.torn`. A closed Run stays as it is.
    """
    place = Path(file)
    content = read_content(place)
    tracker = read_samples(content.batches)
    failure = "; ".join(content.problems[:NAMED_PROBLEMS])
    lost = int(np.diff(tracker.sequence).sum()) - max(len(tracker) - 1, 0)
    end = {"outcome": TORN, "samples": len(tracker), "lost_samples": lost}
    if content.problems:
        content.manifest.setdefault(CLOSED, json.dumps(end))
        sha256 = _salvage(place, content)
    elif CLOSED in content.manifest and not find_log(place).exists():
        sha256 = hash_file(place)
    else:
        database = connect(place)
        if CLOSED not in content.manifest:
            put_manifest(database, {CLOSED: json.dumps(end)})
        sha256 = seal(database, place)
    return RunClosed(str(place), "", len(tracker), lost, sha256, failure)


def _salvage(file: Path, content: RunContent) -> str:
    draft = file.with_name(file.name + ".salvage")
    draft.unlink(missing_ok=True)
    database = create_run_file(draft, content.manifest)
    with transaction(database):
        insert_batches(database, tuple(content.batches))
        database.executemany(
            "INSERT INTO event VALUES (?, ?, ?, ?, ?)", content.event_rows
        )
    sha256 = seal(database, draft)
    file.replace(file.with_name(file.name + ".torn"))
    if find_log(file).exists():
        find_log(file).replace(file.with_name(file.name + ".torn-wal"))
    file.with_name(file.name + "-shm").unlink(missing_ok=True)
    draft.replace(file)
    sync_to_disk(file.parent)
    return sha256
