"""A value whose odds fall slowly to one side is stated with all that it may be."""

import pytest

from truepath.discovery.discover import discover
from truepath_simulators.hidden.warming import ThermalGrowth
from truepath_simulators.worlds.synthetic import Setting

pytestmark = pytest.mark.long
TAU_S, RISE_K, PER_K = 70.0, 2.5, 10.0


@pytest.fixture(scope="module")
def warming(record):
    """A Run as short as the time constant that its Z axis warms with, unseen."""
    growth = ThermalGrowth("Z", PER_K, RISE_K, TAU_S, has_sensor=False)
    return discover([record(11, rows=40, setting=Setting(hidden=(growth,)))[0]])


def test_growth_and_time_constant_agree_with_the_truth(warming):
    (found,) = warming.findings
    said = found.parameters
    assert found.candidate.label == "thermal-growth Z"
    for name, truth in (("growth_um_per_m", PER_K * RISE_K), ("tau_s", TAU_S)):
        assert abs(said[name].value - truth) < 2.0 * said[name].uncertainty
    # Growth is foretold for a time nobody has seen: far from as well as the data fit.
    assert said["tau_s"].uncertainty > 0.1 * said["tau_s"].value


def test_what_the_value_leaves_open_is_in_the_uncertainty_of_the_growth(warming):
    (found,) = warming.findings
    term = found.term
    _, alone = warming.fit.parameters_of(0)
    assert term.covariance is not None
    assert float(term.covariance[0, 0]) > 2.0 * float(alone[0, 0])
