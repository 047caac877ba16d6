"""A plan of verification as files: its points, and how they were drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from truepath.app.files.commanded_file import encode_commanded
from truepath.app.files.file_model import encode_json
from truepath.app.files.whole_files import write_files
from truepath.app.kinematics.machine import Machine
from truepath.app.motion.motion_times import DEFAULT_FEED_MM_MIN, row_times_s
from truepath.app.motion.verification_kinds import VerificationKind
from truepath.app.motion.verification_points import make_verification_rows
from truepath.drivers.interfaces.records import Path as MotionPath

POINTS, PATH, PLAN = "points.csv", "path.csv", "plan.json"


def write_verification_plan(
    machine: Machine, kinds: Sequence[VerificationKind], seed: int, folder: Path
) -> dict[str, Any]:
    """Write the rows and `plan.json`; return the content of the second.

    The rows are `points.csv`, of circles in motion `path.csv`.
    """
    points = make_verification_rows(machine, kinds, seed)
    rows = PATH if isinstance(points, MotionPath) else POINTS
    row_s = row_times_s(points, DEFAULT_FEED_MM_MIN, machine.motion)
    document = {
        "schema": "verification-plan/1",
        "machine": machine.name,
        "what": [kind.value for kind in VerificationKind if kind in kinds],
        "seed": seed,
        "rows": len(points),
        "duration_s": float(row_s.sum()),
        "files": [rows, PLAN],
    }
    files = {rows: encode_commanded(points), PLAN: encode_json(document)}
    write_files(folder, files)
    return document
