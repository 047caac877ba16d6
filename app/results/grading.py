"""The grade of what would be measured, from a plan or from files; nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from app.files.commanded_file import decode_path, decode_points
from app.files.machine_file import read_machine
from app.files.whole_files import read_whole
from app.kinematics.machine import Machine
from app.motion.configurations import Commanded


def graded(
    machine: Machine,
    commanded: Commanded,
    *,
    tracker_mm: Sequence[float] | None = None,
    perpendicular_only: bool = False,
) -> dict[str, Any]:
    """Return the grade of a set-up as JSON.

    tracker_mm : where the tracker stands, in the frame that it stands on; four usual
        places are tried where nobody has said so
    """
    # Imported where it computes: the service itself carries no science.
    from app.planning.grade import grade
    from app.results.grade_json import grade_json

    stand = None if tracker_mm is None else np.array(tracker_mm, np.float64)
    found = grade(
        machine, commanded, station_mm=stand, perpendicular_only=perpendicular_only
    )
    return grade_json(found)


def read_set_up(
    machine_file: FilePath, commanded_file: FilePath
) -> tuple[Machine, Commanded]:
    """Return the machine and its path, or points where the file has no feed.

    Raises BundleError with file, row and column.
    """
    machine = read_machine(machine_file)
    data = read_whole(commanded_file)
    header = data.split(b"\n", 1)[0].decode("utf-8", "replace")
    is_path = "feed_mm_min" in [name.strip() for name in header.split(",")]
    decode = decode_path if is_path else decode_points
    return machine, decode(data, machine, file=str(commanded_file))
