"""What compensation files leave: as stated, as it is, and with the wrong sign.

Thirty machines that no writer was made on are calibrated through the whole product;
their files are read by simulated controllers, which share no code with the writers, and
the exact machine stands where they send it. Every second machine loses motion on
reversal.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from document import table, write_section
from recordings import plan_program, random_air, random_content, run_of
from scipy.stats import qmc

from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import ErrorMap, map_errors
from truepath.documents.file_model import encode_json
from truepath.files.earlier.result_file import read_result
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
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


DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "compensation.md"
MACHINES, FIRST_SEED = 30, 5001  # which nothing was made or mended on
POSITIONS = 4096
_COVERAGE_FACTOR = 2.0

_OTHER = "difference"  # what BACKLASH may hold beside the value in negative travel
_READ_AS_OTHER = "heidenhain, BACKLASH read the other way"
ORDERS: Mapping[str, tuple[str, dict[str, str]]] = {
    "linuxcnc": ("linuxcnc", {}),
    "siemens-lec": ("siemens-lec", {}),
    "siemens-cec": ("siemens-cec", {}),
    "siemens": ("siemens", {}),
    "siemens, 828D": ("siemens", {"control": "828d"}),
    "heidenhain": ("heidenhain", {}),
    "heidenhain, difference": ("heidenhain", {"backlash_reading": _OTHER}),
    _READ_AS_OTHER: ("heidenhain", {}),
    "fanuc": ("fanuc", {}),
    "isg-csv": ("isg-csv", {}),
    "isg-csv, tool followed": ("isg-csv", {"tool_length": "followed"}),
    "etalon-exchange": ("etalon-exchange", {}),
    "csv": ("csv", {}),
    "json": ("json", {}),
}


@dataclass(frozen=True)
class Outcome:
    """One machine with the files of one format; mean lengths of the error in µm.

    stated, expanded : after, as the account has it, and its expanded uncertainty, k = 2
    true, wrong : after, by the exact machine, and with the sign of the files reversed
    loses_motion : whether the machine does, on reversal
    """

    order: str
    loses_motion: bool
    before: float
    stated: float
    expanded: float
    true: float
    wrong: float

    @property
    def is_covered(self) -> bool:
        """Whether the true one is within the stated interval."""
        return abs(self.true - self.stated) <= self.expanded


def judge(machine: CalibratedMachine, errors: ErrorMap) -> Iterator[Outcome]:
    """Yield what the files of each format leave of a machine."""
    before = _measure_um(machine, LoadedTables())
    for order, (name, choices) in ORDERS.items():
        export = export_result(errors, name, "comp", choices=choices)
        stated = export.account["volumetric_error_um"]["after"]
        tool = machine.truth.machine.reflector().offset_mm
        right = Rules(tool_length_mm=abs(tool[2]))
        if order == _READ_AS_OTHER or _OTHER in choices.values():
            right = replace(right, backlash_reading=_OTHER)
        wrong = replace(right, reversed_sign=True)
        yield Outcome(
            order,
            machine.backlash is not None,
            before,
            stated["mean"],
            _COVERAGE_FACTOR * stated["mean_uncertainty"],
            _measure_um(machine, LoadedTables(export.files, right)),
            _measure_um(machine, LoadedTables(export.files, wrong)),
        )


def judge_seed(seed: int, folder: Path) -> Iterator[Outcome]:
    """Yield what the files leave of the machine of a seed; its result is kept."""
    machine = calibrate(seed, folder)
    yield from judge(machine, map_errors(read_result(machine.result)))


def main() -> None:
    """Judge the machines and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument(
        "--keep", type=Path, help="folder of the results, to go on from"
    )
    options, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        outcomes = [
            outcome
            for seed in range(FIRST_SEED, FIRST_SEED + options.machines)
            for outcome in judge_seed(seed, options.keep or Path(folder))
        ]
    write_section("compensation-tables", _describe(outcomes), DOCUMENT)


def _measure_um(machine: CalibratedMachine, tables: LoadedTables) -> float:
    """Return the mean length over the travel, both directions, without rigid motion."""
    truth, nominal = machine.truth, machine.truth.machine
    unit = qmc.Sobol(3, rng=np.random.default_rng(machine.seed)).random(POSITIONS)
    position = nominal.low + unit * (nominal.high - nominal.low)
    correction, reflector = tables.correct(nominal), nominal.reflector()
    errors: list[np.ndarray] = []
    for side in (1.0, -1.0):
        heading = np.full_like(position, side)
        driven = position
        if correction is not None:
            driven = position + correction.added(position, heading)
        carry: dict[str, np.ndarray] = {}
        if machine.backlash:
            own = nominal.axis_names.index(machine.backlash.axis)
            lost = np.zeros((POSITIONS, 6))
            lost[:, own] = -0.5e-3 * side * machine.backlash.width_um
            carry = {machine.backlash.axis: lost}
        actual = truth.point_mm(driven, reflector, "workpiece", carry)
        errors.append(actual - truth.nominal_point_mm(position, reflector))
    left = _remove_rigid_motion(np.vstack([position] * 2), np.vstack(errors))
    return 1e3 * float(np.linalg.norm(left, axis=1).mean())


def _remove_rigid_motion(point: np.ndarray, error: np.ndarray) -> np.ndarray:
    centred = point - point.mean(axis=0)
    columns = np.zeros((len(point), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, centred)
    flat = columns.reshape(-1, 6)
    fit = np.linalg.lstsq(flat, error.reshape(-1), rcond=None)[0]
    return error - columns @ fit


def _describe(outcomes: list[Outcome]) -> str:
    rows: list[list[str]] = []
    for order in ORDERS:
        mine = [o for o in outcomes if o.order == order]
        covered = sum(o.is_covered for o in mine)
        words = [
            f"{np.mean([getattr(o, key) for o in mine]):.2f}"
            for key in ("before", "stated", "expanded", "true", "wrong")
        ]
        steady = np.mean([o.true for o in mine if not o.loses_motion])
        within = f"{covered} of {len(mine)}"
        rows.append([f"`{order}`", *words, within, f"{steady:.2f}"])
    head = (
        "format",
        "before",
        "stated after",
        "U (k = 2)",
        "true after",
        "wrong sign",
        "within U",
        "true after, of machines that lose no motion",
    )
    return table(head, rows)


if __name__ == "__main__":
    main()
