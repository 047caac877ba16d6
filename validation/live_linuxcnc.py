"""A calibration live on LinuxCNC: its planner and its limits drive, ours measures.

The simulated tracker follows the motor positions that LinuxCNC commands each
millisecond, adds the exact errors of a random machine, and streams them at 500 Hz.
Cell, recorder and analysis are those of the service; the truth shares nothing with
them. One case drives over the register map, by the driver `modbus`. Needs Debian's
linuxcnc-uspace and root.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from document import table, write_section

from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    CellState,
    CellVerb,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_loader import open_run
from truepath.planning.default_path import default_path
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_simulators.bench.bench import Bench
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig
from truepath_simulators.machine_file import load_machine, parse_machine

_BEYOND = 10.0  # travel of LinuxCNC beyond that of the machine file, mm or deg
SAMPLE_S = 1e-3
_POINTS = 400
TURN_DWELL_S = 1.5
FEED_MM_MIN = 9000.0
FIRST_SEED = 1001
PAGE = FilePath(__file__).resolve().parent.parent / "docs" / "linuxcnc.md"
HEAD = (
    "machine",
    "driver",
    "lines",
    "time s",
    "samples",
    "lost",
    "before µm",
    "left µm",
    "factor",
    "inside 2u",
)
_MAIN = "import sys; from truepath.cli.command import main; sys.exit(main())"


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
    driver: str
    options: Mapping[str, Any]

    @property
    def config(self) -> CellConfig:
        """Drivers and options of the service's cell."""
        return CellConfig(
            "streaming", self.bench.tracker_options, self.driver, self.options
        )


@contextmanager
def live_rig(
    content: Mapping[str, Any],
    seed: int,
    case: Case,
    tables: Mapping[str, str] | None = None,
) -> Iterator[LiveRig]:
    """Start LinuxCNC with the travel of a machine file, and a tracker beside it.

    tables : compensation table of an axis that LinuxCNC corrects by
    """
    machine = parse_machine(content)
    travel = {
        axis.name: (low - _BEYOND, high + _BEYOND)
        for axis, low, high in zip(machine.axes, machine.low, machine.high, strict=True)
    }
    machine_on_linuxcnc = LinuxCncMachine(
        travel, tables or {}, kinematics=case.kinematics, hal=case.hal
    )
    is_modbus = case.driver == "modbus"
    with (
        LinuxCncRig(
            machine_on_linuxcnc, samples=True, gateway=content if is_modbus else None
        ) as linuxcnc,
        Bench(
            content,
            seed,
            source=linuxcnc.positions,
            source_unit_s=SAMPLE_S,
        ) as bench,
    ):
        if is_modbus:
            options = linuxcnc.modbus_options
            with ModbusController(**options) as controller:
                controller.reset()
                controller.home(10.0)
        else:
            ready = {"reset_at_connect": True, "home_at_connect": True}
            options = linuxcnc.motion_options | ready | {"prologue": case.prologue}
        yield LiveRig(linuxcnc, bench, case.driver, options)


def measure(rig: LiveRig, order: MeasurementOrder, within_s: float) -> RunClosed:
    """Measure through a cell process, as a job of the service does."""
    changes = list_target_changes(rig.bench, order)
    cell = Cell(rig.config)
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.05):
                if isinstance(event, FaultReported | StateChanged):
                    print(event, file=sys.stderr, flush=True)
                if getattr(event, "state", None) is CellState.PAUSED:
                    cell.send(CellVerb.RESUME)  # what the operator would do
                if isinstance(event, MeasurementProgress) and changes:
                    changes = turn_tracker(rig.bench, event, changes)
                if isinstance(event, RunClosed):
                    return event
        raise TimeoutError(f"not measured in {within_s:g} s")
    finally:
        cell.close()


Change = tuple[np.ndarray, str, float]


def list_target_changes(bench: Bench, order: MeasurementOrder) -> list[Change]:
    """Return where the machine stands for another target, the order, and from when."""
    path, known = (
        order.commanded,
        [r.name for r in parse_machine(bench.machine).reflectors],
    )
    return [
        (path.position[row], f"tracker:target*{known.index(name) + 1}", np.inf)
        for row, name in enumerate(path.target)
        if row and name != path.target[row - 1]
    ]


def turn_tracker(
    bench: Bench, progress: MeasurementProgress, changes: list[Change]
) -> list[Change]:
    """Turn the tracker once the machine has stood for a dwell at the next change."""
    (place, fault, since_s), *later = changes
    now_s = time.monotonic()
    stands = np.allclose(progress.position, place, rtol=0, atol=0.01)
    if not stands:
        return [(place, fault, np.inf), *later]
    if now_s - since_s < TURN_DWELL_S + 0.3:
        return [(place, fault, min(since_s, now_s)), *later]
    bench.inject(fault)
    return later


def make_order(
    content: Mapping[str, Any], lines: int, seed: int, file: FilePath
) -> MeasurementOrder:
    """Return the order to drive the default path, standing longer for each turn."""
    machine = machine_from_json(dict(content))
    path = default_path(machine, FEED_MM_MIN, lines=lines, seed=seed)
    target = np.array(path.target or [""] * len(path))
    changed = np.append(False, target[1:] != target[:-1])
    stands = changed | np.append(changed[1:], False)
    dwell_s = np.where(stands, TURN_DWELL_S, path.dwell_s)
    path = replace(path, dwell_s=dwell_s)
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
    axes = machine.axis_names
    q = np.random.default_rng(5).uniform(
        machine.low, machine.high, (_POINTS, len(axes))
    )
    q = np.round(q, 4)
    target = machine.reflectors[0].name
    names = [f"{axis.lower()}_{'deg' if axis in 'ABC' else 'mm'}" for axis in axes]
    lines = [",".join([*names, "target"])]
    lines += [",".join([*map(str, row), target]) for row in q.tolist()]
    (folder / "points.csv").write_text("\n".join(lines) + "\n")
    truth_um = bench.truth_at(q)
    point = bench.truth.nominal_point_mm(q, machine.reflector())
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
    command = [sys.executable, "-c", _MAIN, *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603


@dataclass(frozen=True)
class Case:
    """A machine of the simulators' scenarios and how LinuxCNC drives it.

    prologue : what the driver says before each motion
    driver : of the motion; `modbus` drives over the register map
    """

    name: str
    lines: int
    kinematics: str = ""
    hal: str = ""
    prologue: str = ""
    driver: str = "linuxcnc"


THREE_AXES = Case("demo", 60)
OVER_MODBUS = replace(THREE_AXES, driver="modbus")
FIVE_AXES = Case(
    "trunnion",
    96,
    "xyzac-trt-kins sparm=identityfirst",
    "setp xyzac-trt-kins.y-offset 20\nsetp xyzac-trt-kins.z-offset 10\n"
    "net kinstype motion.analog-out-03 => motion.switchkins-type\n",
    "M68 E3 Q0; M66 E0 L0",
)
CASES = {"demo": THREE_AXES, "demo-modbus": OVER_MODBUS, "trunnion": FIVE_AXES}


def run_case(case: Case, seed: int, folder: FilePath) -> Outcome:
    """Calibrate a machine of a seed on a LinuxCNC of its own."""
    content = load_machine(case.name)
    with live_rig(content, seed, case) as rig:
        order = make_order(content, case.lines, seed, folder / "run.sqlite")
        return calibrate(rig, order, folder, 1500.0)


def describe(case: Case, outcome: Outcome) -> list[str]:
    return [
        f"`{case.name}`, {len(load_machine(case.name)['axes'])} axes",
        f"`{case.driver}`",
        str(case.lines),
        f"{outcome.seconds:.0f}",
        str(outcome.samples),
        str(outcome.lost),
        f"{outcome.before_um:.1f}",
        f"{outcome.left_um:.2f}",
        f"{outcome.factor:.0f}",
        f"{100 * outcome.inside:.1f} %",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", choices=[*CASES])
    parser.add_argument("--seed", type=int, default=FIRST_SEED)
    options = parser.parse_args()
    rows: list[list[str]] = []
    for name, case in CASES.items():
        if options.case in (None, name):
            # Not below /tmp, which LinuxCNC does not see.
            with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
                outcome = run_case(case, options.seed, FilePath(folder))
            rows.append(describe(case, outcome))
            print(" | ".join(rows[-1]), flush=True)
    if options.case is None:
        write_section("live", table(HEAD, rows), PAGE)


if __name__ == "__main__":
    main()
