"""When something happened once is known to a few hundredths of a second."""

import numpy as np
import pytest

from app.alignment.observations import Observations
from app.discovery.discover import align_runs, discover
from simulators.hidden.setup_step import SetupStep
from simulators.synthetic import Setting

ROWS = 30


def moment_within(seen: Observations, line: int, share: float) -> float:
    """Return a moment of a line's share, on the tracker's clock."""
    time_s = seen.at.time_s[seen.at.line == line]
    return float(time_s.min() + share * np.ptp(time_s))


@pytest.mark.parametrize(("line", "share"), [(12, 0.37), (17, 0.8)])
def test_a_knock_while_a_line_is_driven_is_not_taken_for_one_in_a_pause(
    record, line, share
):
    quiet, truth = record(11, rows=ROWS)
    clock = truth.recording.clock
    moment_s = moment_within(align_runs([quiet])[0].observations, line, share)
    machine_s = float(clock.true_s(np.array(moment_s)))
    setting = Setting(hidden=(SetupStep(machine_s, (3.0, -2.0, 1.0)),))
    (found,) = discover([record(11, rows=ROWS, setting=setting)[0]]).findings
    said = found.parameters["t_s"]
    assert found.candidate.family == "setup-step"
    assert abs(said.value - moment_s) < min(0.1, 3.0 * said.uncertainty)
