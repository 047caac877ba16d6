"""Discovery: time and memory at 150 000 samples, clean and with effects.

From reading to what is stated, of Runs in which nothing is missing, one effect, three
effects, or a cause that nobody has listed.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from measure import measure

from app.discovery.discover import discover
from app.files.bundle import read_bundle
from app.results.discovery_json import discovery_json
from simulators import paths, synthetic
from simulators.bundle_files import write_bundle_files
from simulators.hidden.backlash import Backlash
from simulators.hidden.effect import HiddenEffect
from simulators.hidden.elastic_sag import ElasticSag
from simulators.hidden.screw_cyclic import ScrewCyclic
from simulators.hidden.settling_stand import SettlingStand
from simulators.machine_file import parse_machine
from simulators.scenario import load_machine

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


def read_and_discover(folder: Path) -> tuple[int, int, int]:
    """Return samples, names and descriptions of a recording."""
    run = read_bundle(folder)
    content = discovery_json(discover([run]))
    return len(run.tracker), len(content["effects"]), len(content["unnamed"])


def main() -> None:
    """Measure each world and print it."""
    print(f"{'hidden':>16s} {'samples':>9s} {'named':>6s} {'described':>10s}")
    for title, hidden in WORLDS.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "bundle"
            _record(folder, hidden)
            cost = measure(read_and_discover, folder)
        samples, named, described = cost.value
        counts = f"{samples:9d} {named:6d} {described:10d}"
        print(f"{title:>16s} {counts} {cost}", flush=True)


def _record(folder: Path, hidden: tuple[HiddenEffect, ...]) -> None:
    content = load_machine("demo")
    program = paths.chord_path(parse_machine(content), SEED, LINES, FEED_MM_MIN)
    setting = replace(synthetic.Setting(), hidden=hidden)
    write_bundle_files(folder, synthetic.record(content, program, SEED, "otf", setting))


if __name__ == "__main__":
    main()
