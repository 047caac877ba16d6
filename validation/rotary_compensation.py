"""What compensation files leave of machines with rotary axes, over all their travel.

Twenty machines that no writer was made on, chain, travels and places of axes drawn,
each target off its place by itself, are calibrated through the whole product; their
files are read by simulated controllers, which share no code with the writers, and the
exact machine stands where they send it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from compensation_tables import DOCUMENT, Outcome
from document import table, write_section
from five_axes_in_motion import stand
from recordings import run_of
from scipy.stats import qmc
from target_seats import remove_rigid_motion

from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import map_errors
from truepath.documents.file_model import encode_json
from truepath.files.earlier.result_file import decode_result
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.recording import Recording

MACHINES, FIRST_SEED = 20, 7001  # which nothing was made or mended on
POSITIONS = 2048
FORMATS = ("linuxcnc", "siemens-lec", "siemens", "isg-csv")
_HEAD = "format, before, stated after, U (k = 2), true after, wrong sign, within U"


def judge(seed: int) -> Iterator[Outcome]:
    """Yield what the files of each format leave of a machine."""
    (made,) = stand(seed)
    found = encode_json(result_json(analyse(run_of(made))))
    errors = map_errors(decode_result(found, file=f"result of {seed}"))
    before = measure_um(made, LoadedTables(), seed)
    for name in FORMATS:
        export = export_result(errors, name, "comp")
        over = export.account["over_all_axes_um"]
        right = LoadedTables(export.files, Rules())
        wrong = replace(right, rules=Rules(reversed_sign=True))
        yield Outcome(
            name,
            False,  # loses no motion
            before,
            over["after_expected"],
            over["after_expanded_uncertainty"],
            measure_um(made, right, seed),
            measure_um(made, wrong, seed),
        )


def measure_um(made: Recording, tables: LoadedTables, seed: int) -> float:
    """Return the mean length over the travel of all axes, without rigid motion."""
    truth, stated = made.truth, parse_machine(made.content)
    unit = qmc.Sobol(len(stated.low), rng=np.random.default_rng(seed)).random(POSITIONS)
    position = stated.low + unit * (stated.high - stated.low)
    place = perfect(stated).nominal_point_mm(position, stated.reflector("T1"))
    correction, driven = tables.correct(stated), position
    if correction is not None:
        driven = position + correction.added(position, np.ones_like(position))
    actual = truth.point_mm(driven, truth.machine.reflector("T1"))
    left = remove_rigid_motion(place, actual - place)
    return 1e3 * float(np.linalg.norm(left, axis=1).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    options, _ = parser.parse_known_args()
    outcomes: list[Outcome] = []
    for seed in range(FIRST_SEED, FIRST_SEED + options.machines):
        outcomes += judge(seed)
        print(seed, *outcomes[-len(FORMATS) :], sep="\n", flush=True)
    rows = [_summarize(name, outcomes) for name in FORMATS]
    write_section("rotary-compensation", table(_HEAD.split(", "), rows), DOCUMENT)


def _summarize(name: str, outcomes: list[Outcome]) -> list[str]:
    mine = [o for o in outcomes if o.order == name]
    words = [
        f"{np.mean([getattr(o, key) for o in mine]):.2f}"
        for key in ("before", "stated", "expanded", "true", "wrong")
    ]
    return [f"`{name}`", *words, f"{sum(o.is_covered for o in mine)} of {len(mine)}"]


if __name__ == "__main__":
    main()
