"""In which order the calibrations of a machine stand."""

from __future__ import annotations

from pathlib import Path

from truepath.answers.history.machine_documents import Calibration
from truepath.catalogue.calibrations import sort_by_time


def calibration(name, measured, *, is_time_stated=True):
    return Calibration(
        "mill", name, (name,), measured, 1, None, Path(name), is_time_stated
    )


def names(*found):
    return [one.job_id for one in sort_by_time(found)]


def test_what_was_recorded_here_stands_in_its_order_whatever_the_clock_said():
    first = calibration("first", "2026-03-01T00:00:00Z")
    wrong = calibration("wrong", "2099-01-01T00:00:00Z")
    newest = calibration("newest", "2026-05-01T00:00:00Z")
    back = calibration("back", "1970-01-01T00:00:00Z")
    assert names((wrong, 5), (newest, 7), (first, 3)) == ["first", "wrong", "newest"]
    assert names((back, 8), (newest, 7), (first, 3)) == ["first", "newest", "back"]


def test_what_was_uploaded_stands_by_its_time():
    recorded = calibration("recorded", "2026-03-01T00:00:00Z")
    older = calibration("older", "2026-01-01T00:00:00Z")
    newer = calibration("newer", "2026-04-01T00:00:00Z")
    no_time = calibration("no time", "2026-09-01T00:00:00Z", is_time_stated=False)
    found = names((recorded, 1), (newer, None), (older, None), (no_time, None))
    assert found == ["no time", "older", "recorded", "newer"]
