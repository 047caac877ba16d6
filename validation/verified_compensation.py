"""Forty random machines as found, compensated, and as left.

Each is calibrated on the product's own path and its result written as files of a format
that carries all error motions. A simulated controller, which shares no code with the
writers, applies them, and points that the calibration has not measured are measured
with and without. What is left is held against what was stated.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from document import table, write_section
from recordings import plan_program, random_air, random_content, run_of

from truepath.answers.verification.matched_points import K
from truepath.answers.verification.verification import Verification, verify
from truepath.compensation.active_files import make_active_files
from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import map_errors
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult, result_from_json
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_points
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

MACHINES, LINES, FEED_MM_MIN = 40, 60, 6000.0
FIRST_SEED = 501  # which nothing was made or mended on
FORMAT, SPACING_MM = "isg-csv", 10.0
DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "verification.md"


@dataclass(frozen=True)
class Outcome:
    """One machine; mean lengths over the measured places, in µm.

    found, left : as measured; expanded : of left; stated : as the result and the files
        say, with its own expanded uncertainty
    """

    seed: int
    found: float
    left: float
    expanded: float
    stated: float
    stated_expanded: float
    within: bool
    consistent: bool
    share_within: float


def outcome(seed: int, lines: int) -> Outcome:
    """Calibrate, compensate and verify one machine."""
    content, air = random_content(seed), random_air(seed)
    program = plan_program(content, FEED_MM_MIN, lines)
    setting = synthetic.Setting(machine_seed=seed, air=air)
    recording = synthetic.record(content, program, seed, "otf", setting)
    document = result_json(analyse(run_of(recording)))
    result = result_from_json(json.loads(json.dumps(document)))
    files = export_result(map_errors(result), FORMAT, "c", spacing_mm=SPACING_MM).files
    before = _verify(result, content, seed, setting, {})
    after = _verify(result, content, seed, setting, files)
    left, stated = (
        after.statistics[name]["mean"] for name in ("measured", "predicted")
    )
    expanded = K * float(np.hypot(left.uncertainty_um, stated.uncertainty_um))
    return Outcome(
        seed,
        before.statistics["measured"]["mean"].value_um,
        left.value_um,
        K * left.uncertainty_um,
        stated.value_um,
        K * stated.uncertainty_um,
        abs(left.value_um - stated.value_um) <= expanded,
        after.consistency.is_consistent,
        after.consistency.share_within,
    )


def _verify(
    result: CalibrationResult,
    content: dict[str, object],
    seed: int,
    setting: synthetic.Setting,
    files: dict[str, str],
) -> Verification:
    """Measure random points, with files in the controller if there are any."""
    machine = machine_from_json(dict(content), file="machine.json")
    number = 1000 + 2 * seed + bool(files)
    points = make_verification_points(machine, [VerificationKind.RANDOM_POINTS], number)
    program = Program(
        points.position,
        np.full(len(points), FEED_MM_MIN / 60.0),
        points.dwell_s,
        points.target,
    )
    recording = synthetic.record(
        content,
        program,
        number,
        "standstill",
        replace(setting, compensation=LoadedTables(files)),
    )
    added = None
    if files:
        data = {name: text.encode() for name, text in files.items()}
        added = make_active_files(data, FORMAT, machine, {}).additional_correction_at
    return verify(result, run_of(recording), correction=added)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--lines", type=int, default=LINES)
    options, _ = parser.parse_known_args()
    seeds = range(FIRST_SEED, FIRST_SEED + options.machines)
    outcomes = [outcome(seed, options.lines) for seed in seeds]
    write_section("as-left", _state(outcomes, options.lines), DOCUMENT)


def _state(outcomes: list[Outcome], lines: int) -> str:
    rows = [
        [
            one.seed,
            f"{one.found:.1f}",
            f"{one.left:.2f} ± {one.expanded:.2f}",
            f"{one.stated:.2f} ± {one.stated_expanded:.2f}",
            f"{one.found / one.left:.0f}",
            "yes" if one.within else "no",
            "yes" if one.consistent else "no",
            f"{one.share_within:.0%}",
        ]
        for one in outcomes
    ]
    ratio = sum(o.found for o in outcomes) / sum(o.left for o in outcomes)
    least = min(one.found / one.left for one in outcomes)
    within = sum(one.within for one in outcomes)
    consistent = sum(one.consistent for one in outcomes)
    share = float(np.mean([one.share_within for one in outcomes]))
    head = [
        "machine",
        "as found µm",
        "as left µm",
        "stated µm",
        "ratio",
        "within U",
        "agrees",
        "components in U",
    ]
    count = len(outcomes)
    sentence = (
        f"{lines} lines at {FEED_MM_MIN:.0f} mm/min, files of format `{FORMAT}` every "
        f"{SPACING_MM:.0f} mm, 30 random points: the volumetric error goes "
        f"down {ratio:.0f} times ({least:.0f} at the least). As left and stated differ "
        f"by no more than their expanded uncertainty on {within} of {count} machines; "
        f"{consistent} agree by χ²; {share:.0%} of all components lie within theirs."
    )
    return f"{sentence}\n\n{table(head, rows)}"


if __name__ == "__main__":
    main()
