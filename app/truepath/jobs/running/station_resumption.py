"""Resumption of an interrupted station: Runs to keep, rows that remain.

Known points come first, as at every station. If the target is where it was at them, the
station is unchanged. If not, the tracker or the reflector was moved, and the operator
decides. Continued from there, the rest is a separate station, for every Run has its own
pose; its known points have to fit those before by a rigid motion, as between any two
stations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from truepath.catalogue.job import Json
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.jobs.running.resumption import choose_first_row
from truepath.motion.configurations import Commanded, select_rows


def select_remaining(station: Json) -> Commanded:
    """Remaining rows of a station, as the plan keeps it."""
    commanded, resumption = decode_commanded_json(station), station.get("resumption")
    if resumption is None:
        return commanded
    return select_rows(commanded, slice(resumption["first_row"], None))


def list_kept_ids(station: Json) -> list[str]:
    """Runs of a station that the analysis takes in addition to its last."""
    return list((station.get("resumption") or {}).get("kept_run_ids", ()))


def make_resumption(
    station: Json, parts: Sequence[Json], found: Sequence[Json | None]
) -> dict[str, Any] | None:
    """How a station is resumed; None where all its rows are to be measured again.

    `first_row` of the station, `kept_run_ids`, and of the known points before the last
    of these `points_id` and `place_mm`, the target position at the last of them.

    parts : `run_id`, `points_id` and `first_row` of each Run of the station
    found : progress of each Run, then of each set of known points, as in
        `find_committed_rows`
    """
    pairs = zip(parts, found[: len(parts)], found[len(parts) :], strict=True)
    usable = [(part, run, points) for part, run, points in pairs if run and points]
    if not usable:
        return None
    last, run, points = usable[-1]
    reached = last["first_row"] + run["next_row"]
    return {
        "first_row": choose_first_row(decode_commanded_json(station), reached),
        "kept_run_ids": [part["run_id"] for part, _, _ in usable],
        "points_id": last["points_id"],
        "place_mm": points["place_mm"],
    }
