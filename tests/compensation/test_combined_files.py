"""Files in place of those that the control had add what both add together."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.account.remaining_error import sample_travel
from truepath.compensation.active_files import make_active_files
from truepath.compensation.installed import load_format
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured import Unmeasured, find_measured_ranges

ROUNDING_UM = {"fanuc": 3.0, "heidenhain": 0.2}  # of three files; 0.1 of the others
FORMATS = (
    "linuxcnc",
    "siemens",
    "siemens-lec",
    "siemens-cec",
    "heidenhain",
    "fanuc",
    "isg-csv",
    "etalon-exchange",
    "csv",
    "json",
)


def make_errors(loaded, size, lost_um):
    """A machine whose errors are so many times those of the result."""
    half = {"X": (np.array([-200.0, 300.0]), np.array(lost_um))}
    return map_errors(
        replace(loaded, theta=size * loaded.theta, half_difference_um=half)
    )


@pytest.mark.parametrize("name", FORMATS)
def test_combined_files_add_what_active_ones_and_the_difference_add(name, loaded):
    found, left = (
        make_errors(loaded, 0.6, [3.0, 5.0]),
        make_errors(loaded, -0.2, [-1.0, 2.0]),
    )
    kind, machine = load_format(name), found.machine
    measured = find_measured_ranges(machine, {}, Unmeasured.HOLD)
    made = Tabulation(kind, "a", (), 10.0, measured)
    texts = made.write(found)
    data = {file: text.encode() for file, text in texts.items()}
    active = make_active_files(data, name, machine, {})
    combined = replace(made, active=active)
    place, _ = sample_travel(found)
    off_um = []
    for side in (1.0, -1.0):
        apart = combined.read_back(left)(place, side) - made.read_back(left)(
            place, side
        )
        off_um.append(1e3 * apart)
    off_um -= np.mean(off_um, axis=(0, 1))
    added_um = 1e3 * active.correction(place, 1.0)
    assert np.abs(added_um).max() > 10.0
    assert np.abs(off_um).max() < ROUNDING_UM.get(name, 0.1)
