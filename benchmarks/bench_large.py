"""Large machines: time and memory as samples and travel grow.

A gantry of 6 × 2.5 × 1.2 m at 24 m/min with more and more lines, then machines of the
same proportions from 0.5 to 30 m with 60 lines each: all of it, from reading to what is
stated. The last column is how often the processor's time doubles where the samples do:
1 is linear. Then the command line, from its start to its files.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import Measurement, measure

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table, write_section

from truepath.files.bundle.bundle import read_bundle
from truepath.results.analysis import analyse
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import write_bundle_files

SEED, FEED_MM_MIN = 4, 24_000.0
GANTRY = (6000.0, 2500.0, 1200.0)
MORE_LINES = (30, 60, 120, 240, 460)
LENGTHS_MM = (500.0, 1500.0, 6000.0, 30_000.0)
LINES = 60
COMMANDS = (((500.0, 400.0, 300.0), 210), (GANTRY, 120))


def read_and_analyse(folder: Path) -> tuple[int, int]:
    run = read_bundle(folder)
    estimate = analyse(run).estimate
    return len(run.tracker), estimate.model.size


def run_command(folder: Path) -> tuple[float, float]:
    """Run `truepath analyse` on a recording; return its seconds and its peak in MiB."""
    begin = time.perf_counter()
    command = Path(sys.executable).with_name("truepath")
    output = folder.with_name("result")
    subprocess.run(
        [command, "analyse", folder, "-o", output], check=True, capture_output=True
    )
    spent_s = time.perf_counter() - begin
    return spent_s, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


COMMAND_HEAD = ["travel of X, lines", "samples", "wall s", "peak MiB"]
HEAD = [
    "travel of X, lines",
    "samples",
    "parameters",
    "wall s",
    "processor s",
    "peak MiB",
    "growth",
]


def main() -> None:
    rows = _measure_row([(GANTRY, lines) for lines in MORE_LINES])
    sizes = [tuple(x / GANTRY[0] * side for side in GANTRY) for x in LENGTHS_MM]
    rows += _measure_row([(size, LINES) for size in sizes])
    write_section("large-growth", table(HEAD, rows))
    commands = [_measure_command(*world) for world in COMMANDS]
    write_section("large-command", table(COMMAND_HEAD, commands))


def _measure_row(worlds: list[tuple[tuple[float, ...], int]]) -> list[list[str]]:
    rows: list[list[str]] = []
    before: Measurement | None = None
    for travel_mm, lines in worlds:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bundle"
            _record(folder, travel_mm, lines)
            cost = measure(read_and_analyse, folder)
        samples, parameters = cost.value
        growth = "" if before is None else f"{_exponent(before, cost):.2f}"
        size = f"{travel_mm[0] / 1e3:.3g} m, {lines}"
        spent = f"{cost.wall_s:.1f}", f"{cost.processor_s:.1f}", f"{cost.peak_mib:.0f}"
        rows.append([size, f"{samples}", f"{parameters}", *spent, growth])
        print(*rows[-1], sep="  ", flush=True)
        before = cost
    return rows


def _measure_command(travel_mm: tuple[float, ...], lines: int) -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bundle"
        _record(folder, travel_mm, lines)
        spent_s, peak_mib = measure(run_command, folder).value
        samples = len(read_bundle(folder).tracker)
    size = f"{travel_mm[0] / 1e3:.3g} m, {lines}"
    return [size, f"{samples}", f"{spent_s:.1f}", f"{peak_mib:.0f}"]


def _exponent(before: Measurement, after: Measurement) -> float:
    more = np.log(after.value[0] / before.value[0])
    return float(np.log(after.processor_s / before.processor_s) / more)


def _record(folder: Path, travel_mm: tuple[float, ...], lines: int) -> None:
    content = load_machine("demo")
    content["axes"] = {
        name: {"type": "linear", "min_mm": 0.0, "max_mm": length}
        for name, length in zip("XYZ", travel_mm, strict=True)
    }
    program = paths.chord_path(parse_machine(content), SEED, lines, FEED_MM_MIN)
    write_bundle_files(folder, synthetic.record(content, program, SEED, "otf"))


if __name__ == "__main__":
    main()
