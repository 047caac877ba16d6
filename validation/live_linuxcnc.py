"""A calibration live on LinuxCNC: its planner and its limits drive, ours measures.

The simulated tracker follows the motor positions that LinuxCNC commands each
millisecond, adds the exact errors of a random machine, and streams them at 500 Hz.
Cell, recorder and analysis are those of the service; the truth shares nothing with
them. Needs Debian's linuxcnc-uspace and root.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from app.files.bundle import write_bundle
from app.files.machine_file import machine_from_json
from app.measurement.cell import Cell
from app.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    RunClosed,
)
from app.measurement.run_reading import open_run
from drivers.interfaces.records import Path
from simulators.bench import Bench
from simulators.linuxcnc.files import LinuxCncMachine
from simulators.linuxcnc.rig import LinuxCncRig
from simulators.machine_file import parse_machine
from simulators.timeline import Program

_BEYOND = 10.0  # travel of LinuxCNC beyond that of the machine file, mm or deg
SAMPLE_S = 1e-3
_POINTS = 400
_MAIN = "import sys; from app.cli.command import main; sys.exit(main())"


@dataclass(frozen=True)
class Outcome:
    """Mean length of the volumetric error, µm, before and left; share within 2u."""

    before_um: float
    left_um: float
    inside: float
    samples: int
    lost: int
    seconds: float

    @property
    def factor(self) -> float:
        """How many times smaller the error has become."""
        return self.before_um / self.left_um


@dataclass(frozen=True)
class LiveRig:
    """LinuxCNC and a tracker that follows it."""

    linuxcnc: LinuxCncRig
    bench: Bench
    options: Mapping[str, Any]

    @property
    def config(self) -> CellConfig:
        """Drivers and options of the service's cell."""
        return CellConfig(
            "streaming", self.bench.tracker_options, "linuxcnc", self.options
        )


@contextmanager
def live_rig(content: Mapping[str, Any], seed: int, **more: Any) -> Iterator[LiveRig]:
    """Start LinuxCNC with the travel of a machine file, and a tracker beside it.

    more : of `LinuxCncMachine`
    """
    machine = parse_machine(content)
    travel = {
        axis.name: (low - _BEYOND, high + _BEYOND)
        for axis, low, high in zip(machine.axes, machine.low, machine.high, strict=True)
    }
    with (
        LinuxCncRig(LinuxCncMachine(travel, **more), samples=True) as linuxcnc,
        Bench(
            content,
            seed,
            source=linuxcnc.positions,
            source_unit_s=SAMPLE_S,
        ) as bench,
    ):
        ready = {"reset_at_connect": True, "home_at_connect": True}
        yield LiveRig(linuxcnc, bench, linuxcnc.motion_options | ready)


def measure(rig: LiveRig, order: MeasurementOrder, within_s: float) -> RunClosed:
    """Measure through a cell process, as a job of the service does."""
    cell = Cell(rig.config)
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.2):
                if isinstance(event, FaultReported):
                    print(event, file=sys.stderr, flush=True)
                if isinstance(event, RunClosed):
                    return event
        raise TimeoutError(f"not measured in {within_s:g} s")
    finally:
        cell.close()


def make_order(
    content: Mapping[str, Any], program: Program, file: FilePath
) -> MeasurementOrder:
    """Return the order to drive a program of the simulators."""
    machine = machine_from_json(dict(content))
    path = Path(
        machine.axis_names,
        program.position,
        60.0 * program.feed_mm_s,
        program.dwell_s,
        program.target,
    )
    return MeasurementOrder("live", str(file), machine, path)


def calibrate(
    rig: LiveRig, order: MeasurementOrder, folder: FilePath, within_s: float
) -> Outcome:
    """Measure, analyse by the command line, and hold against the truth."""
    begin_s = time.monotonic()
    closed = measure(rig, order, within_s)
    seconds = time.monotonic() - begin_s
    if closed.outcome != "finished":
        raise RuntimeError(f"the measurement ended {closed.outcome}")
    write_bundle(open_run(FilePath(closed.run_file)), folder / "bundle")
    before, left, inside = judge(rig.bench, folder)
    return Outcome(before, left, inside, closed.samples, closed.lost_samples, seconds)


def judge(bench: Bench, folder: FilePath) -> tuple[float, float, float]:
    """Return the error before and left in µm, and the share within 2u."""
    machine = parse_machine(bench.machine)
    q = np.random.default_rng(5).uniform(
        machine.low, machine.high, (_POINTS, len(machine.axes))
    )
    truth_um = bench.truth_at(q)
    names = [
        f"{axis.name.lower()}_{'deg' if axis.name in 'ABC' else 'mm'}"
        for axis in machine.axes
    ]
    point = bench.truth.nominal_point_mm(q, machine.reflector())
    np.savetxt(
        folder / "points.csv",
        q,
        delimiter=",",
        header=",".join(names),
        comments="",
        fmt="%.4f",
    )
    run("analyse", folder / "bundle", "-o", folder)
    run(
        "predict",
        folder / "result.json",
        "--points",
        folder / "points.csv",
        "-o",
        folder / "map.csv",
    )
    found = np.genfromtxt(folder / "map.csv", delimiter=",", names=True)
    error_um = np.stack([found[k] for k in ("dx_um", "dy_um", "dz_um")], 1)
    u_um = np.stack([found[k] for k in ("ux_um", "uy_um", "uz_um")], 1)
    left_um = remove_rigid_motion(point, truth_um - error_um)
    before_um = remove_rigid_motion(point, truth_um)
    return (
        float(np.linalg.norm(before_um, axis=1).mean()),
        float(np.linalg.norm(left_um, axis=1).mean()),
        float((np.abs(left_um) < 2 * u_um).mean()),
    )


def remove_rigid_motion(point_mm: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return errors (n, 3) at points without the rigid motion of all of them."""
    columns = np.zeros((len(point_mm), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, point_mm - point_mm.mean(axis=0))
    flat = columns.reshape(-1, 6)
    fit = np.linalg.lstsq(flat, error.reshape(-1), rcond=None)[0]
    return error - columns @ fit


def run(*arguments: object) -> None:
    """Run a command of the service."""
    command = [sys.executable, "-c", _MAIN, *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603
