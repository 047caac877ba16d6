"""The tracker of a bundled machine errs as its maker specifies, as real ones do."""

import json
from dataclasses import asdict
from importlib import resources

from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_simulators.scenario import list_machines


def test_bundled_machines_state_a_typical_tracker():
    folder = resources.files("truepath_simulators") / "scenarios"
    for name in list_machines():
        content = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        assert content["tracker"]["specification"] == asdict(TrackerSpecification())
