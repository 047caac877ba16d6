"""Doubles of the tasks by which a measurement that was cut short goes on."""

from pathlib import Path

from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.measurement.run_file.run_loader import open_recorded

PLACES = [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]


class Resumer:
    def __init__(self):
        self.calls, self.next_row, self.error = [], 4, None

    def __call__(self, files, machine, *, on_progress):
        self.calls.append(files)
        if self.error is not None:
            raise self.error
        if self.next_row is None:
            return [None for _ in files]
        reached = {"next_row": self.next_row, "row": [2, 3], "place_mm": PLACES}
        told = [encode_commanded_json(open_recorded(Path(f)).commanded) for f in files]
        return [reached | {"commanded": rows} for rows in told]


class Closer:
    def __init__(self):
        self.calls, self.problem = [], ""

    def __call__(self, file, place_mm, *, on_progress):
        self.calls.append(place_mm)
        return {"step_um": 1.0, "allowed_um": 20.0, "problem": self.problem}
