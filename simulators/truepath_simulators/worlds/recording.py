"""A recording, the truth behind it, and its files as a measurement bundle."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.machine.tracker_head import TrackerClock, TrackerPose
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion.program import Program
from truepath_simulators.randomness import generator
from truepath_simulators.timeline import Timeline


@dataclass(frozen=True, slots=True)
class Temperatures:
    """Readings of sensors on the tracker's clock.

    names : of the axes whose scales have one; time_s (n,); celsius (n, sensors)
    """

    names: tuple[str, ...]
    time_s: np.ndarray
    celsius: np.ndarray


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording and its truth.

    time_s (n,), position_mm (n, 3), status (n,) : in the tracker's frame and clock
    commanded_mm (n, 3) : nominal axis positions at each sample
    row (n,) : towards which the machine moved, or at which it dwelt, at each sample
    hidden : effects outside of a rigid-body model; clock : of the tracker
    temperatures : None where the machine has no sensors
    """

    content: Mapping[str, Any]
    mode: str
    program: Program
    truth: TruthMachine
    pose: TrackerPose
    time_s: np.ndarray
    position_mm: np.ndarray
    status: np.ndarray
    commanded_mm: np.ndarray
    row: np.ndarray
    timeline: Timeline
    clock: TrackerClock
    hidden: tuple[HiddenEffect, ...] = ()
    temperatures: Temperatures | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def hidden_truth(self) -> list[dict[str, Any]]:
        """Hidden effects in the form of `discovery.json`."""
        return [effect.truth(self.clock) for effect in self.hidden]


_GRID_MARGIN_MM = 15.0
_POINTS = 8  # of the grid, along each axis


def write_bundle_files(folder: Path, recording: Recording, csv: bool = False) -> None:
    """The recording as a measurement bundle, with `truth.json` next to it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "machine.json").write_text(json.dumps(dict(recording.content), indent=1))
    _write_program(folder, recording)
    _write_stream(folder, recording, csv=csv)
    if (read := recording.temperatures) is not None:
        names = ["t_s", *(f"{name}_degC" for name in read.names)]
        table = np.column_stack([read.time_s, read.celsius])
        _write_table(folder / "environment.csv", names, table, "%.3f")
    truth = truth_of(recording.truth, recording.hidden_truth())
    (folder / "truth.json").write_text(json.dumps(truth))


def truth_of(
    truth: TruthMachine, hidden: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Volumetric error on a grid of the travel, in the form of a test case.

    hidden : effects in addition to the error motions; not included in the grid
    """
    grid = _grid(truth.machine).round(4)
    return {
        "note": "synthetic recording",
        "effects": list(hidden),
        "points_mm": grid.tolist(),
        "deviation_um": (1e3 * truth.deviation_mm(grid)).round(4).tolist(),
    }


def _grid(machine: MachineFile) -> np.ndarray:
    low, high = machine.low_mm + _GRID_MARGIN_MM, machine.high_mm - _GRID_MARGIN_MM
    if machine.rotary_axes:
        rng = generator(0, "grid of the truth")
        return rng.uniform(machine.low, machine.high, (_POINTS**3, len(machine.axes)))
    axes = [np.linspace(a, b, _POINTS) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _write_program(folder: Path, recording: Recording) -> None:
    machine, program = recording.truth.machine, recording.program
    if any(program.arc):
        raise SimulatorError("a program with arcs is not written as a bundle")
    names = [f"{axis.name.lower()}_mm" for axis in machine.linear_axes]
    names += [f"{axis.name.lower()}_deg" for axis in machine.rotary_axes]
    columns = [program.position]
    if recording.mode == "otf":
        name, names = "path.csv", [*names, "feed_mm_min", "dwell_s"]
        columns += [60.0 * program.feed_mm_s[:, None]]
    else:
        name, names = "points.csv", [*names, "dwell_s"]
    table = np.hstack([*columns, program.dwell_s[:, None]])
    if not program.target:
        _write_table(folder / name, names, table, "%.4f")
        return
    rows = [
        ",".join([*(f"{value:.4f}" for value in row), target])
        for row, target in zip(table.tolist(), program.target, strict=True)
    ]
    text = "\n".join([",".join([*names, "target"]), *rows])
    (folder / name).write_text(f"{text}\n")


def _write_stream(folder: Path, recording: Recording, *, csv: bool) -> None:
    columns = {
        "t_s": recording.time_s,
        **{
            f"{name}_mm": column
            for name, column in zip("xyz", recording.position_mm.T, strict=True)
        },
        "status": recording.status,
    }
    if csv:
        table = np.stack(list(columns.values()), axis=1)
        formats = ["%.6f"] * 4 + ["%d"]
        _write_table(folder / "tracker.csv", list(columns), table, formats)
        return
    import pyarrow as pa  # heavy, and needed for this file alone
    from pyarrow import parquet

    parquet.write_table(pa.table(columns), folder / "tracker.parquet")


def _write_table(
    path: Path, names: Sequence[str], table: np.ndarray, form: str | list[str]
) -> None:
    np.savetxt(
        path, table, fmt=form, delimiter=",", header=",".join(names), comments=""
    )
