"""Machines calibrated through the whole product, kept as their result files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from recordings import plan_program, random_air, random_content, run_of

from truepath.documents.file_model import encode_json
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds import synthetic

LINES, FEED_MM_MIN = 24, 6000.0
_WIDEST_UM = 8  # of lost motion


@dataclass(frozen=True)
class CalibratedMachine:
    """A machine with its truth, and the file of its result.

    backlash : what it loses on reversal, of every second machine
    """

    seed: int
    truth: TruthMachine
    backlash: Backlash | None
    result: Path


def calibrate(seed: int, folder: Path) -> CalibratedMachine:
    """Record and analyse a machine; a result that is there already is taken."""
    content, file = random_content(seed), folder / f"machine-{seed}.json"
    truth = random_machine(parse_machine(content), seed)
    backlash = Backlash("XYZ"[seed % 3], 2.0 + seed % _WIDEST_UM) if seed % 2 else None
    if not file.exists():
        setting = synthetic.Setting(
            air=random_air(seed), hidden=(backlash,) if backlash else ()
        )
        program = plan_program(content, FEED_MM_MIN, LINES)
        recording = synthetic.record(content, program, seed, "otf", setting)
        folder.mkdir(parents=True, exist_ok=True)
        found = result_json(analyse(run_of(recording)))
        file.write_bytes(encode_json(found, indent=1))
    return CalibratedMachine(seed, truth, backlash, file)
