"""Discovery: time and memory at 135 000 samples, clean and with effects.

From reading to what is stated, of Runs in which nothing is missing, one effect, three
effects, or a cause that nobody has listed.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from measure import measure

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table, write_section

from truepath.answers.discovery_json import discovery_json
from truepath.discovery.discover import discover
from truepath.files.bundle.bundle import read_bundle
from truepath_simulators.hidden.drives import Backlash, ScrewCyclic
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.setup import SettlingStand
from truepath_simulators.hidden.structure import ElasticSag
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import write_bundle_files

SEED, LINES, FEED_MM_MIN = 4, 66, 6000.0
THREE = (
    Backlash("X", 6.0),
    ScrewCyclic("Y", 10.0, 2.0, 0.5),
    ElasticSag("X", "Z", "Z", 8.0),
)
WORLDS: dict[str, tuple[HiddenEffect, ...]] = {
    "nothing": (),
    "one effect": THREE[:1],
    "three effects": THREE,
    "unlisted cause": (SettlingStand((20.0, -12.0), 60.0),),
}
DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "discovery.md"
HEAD = [
    "hidden",
    "samples",
    "named",
    "described",
    "wall s",
    "processor s",
    "peak MiB",
]


def read_and_discover(folder: Path) -> tuple[int, int, int]:
    run = read_bundle(folder)
    content = discovery_json(discover([run]))
    return len(run.tracker), len(content["effects"]), len(content["unnamed"])


def main() -> None:
    rows: list[list[str]] = []
    for title, hidden in WORLDS.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bundle"
            _record(folder, hidden)
            cost = measure(read_and_discover, folder)
        counts = [str(count) for count in cost.value]
        spent = f"{cost.wall_s:.1f}", f"{cost.processor_s:.1f}", f"{cost.peak_mib:.0f}"
        rows.append([title, *counts, *spent])
        print(*rows[-1], sep="  ", flush=True)
    write_section("discovery-cost", table(HEAD, rows), DOCUMENT)


def _record(folder: Path, hidden: tuple[HiddenEffect, ...]) -> None:
    content = load_machine("demo")
    program = paths.chord_path(parse_machine(content), SEED, LINES, FEED_MM_MIN)
    setting = replace(synthetic.Setting(), hidden=hidden)
    write_bundle_files(folder, synthetic.record(content, program, SEED, "otf", setting))


if __name__ == "__main__":
    main()
