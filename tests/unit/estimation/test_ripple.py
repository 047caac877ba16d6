"""What axes do between knots is in the stated uncertainty."""

import numpy as np
import pytest

from truepath.estimation.checks import ripple
from truepath.results.analysis import analyse
from truepath_simulators.hidden.screws import ScrewCyclic
from truepath_simulators.worlds.synthetic import Setting


def analyse_with(record, monkeypatch, *hidden):
    """Return what was added to the variance of error motions, in µm², by symbol."""
    run, _ = record(33, rows=30, setting=Setting(hidden=hidden))
    before = []

    def spy(found, runs):
        before.append(found)
        return ripple.add_ripple(found, runs)

    monkeypatch.setattr("truepath.results.analysis.add_ripple", spy)
    found = analyse(run)
    (plain,) = before
    scaled = plain.widen_by_scale(1e-6 * found.length_scale_ppm)
    added = np.diag(found.estimate.covariance - scaled.covariance)
    sizes = {}
    for motion in plain.model.error_motions:
        rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, 50))
        own = added[plain.model.slices[motion.name]]
        sizes[motion.symbol] = 1e6 * float((rows**2 @ own).mean())
    return found, sizes


def test_a_clean_machine_has_none(record, monkeypatch):
    found, sizes = analyse_with(record, monkeypatch)
    assert found.verdict.state == "usable"
    assert max(sizes.values()) < 0.1**2


@pytest.mark.parametrize("lead_mm", [5.0, 20.0])
def test_a_screw_too_short_for_knots_is_found_to_its_size(record, monkeypatch, lead_mm):
    screw = ScrewCyclic("Y", lead_mm, 1.5, 0.3)
    _, sizes = analyse_with(record, monkeypatch, screw)
    assert 0.8 < sizes.pop("EYY") / (1.5**2 / 2.0) < 1.2
    assert max(sizes.values()) < 0.3**2
