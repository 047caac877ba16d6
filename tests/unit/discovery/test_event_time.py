"""When something happened once is known to a few hundredths of a second."""

import numpy as np
import pytest

from truepath.alignment.observations.observations import Observations
from truepath.discovery.discover import align_runs, discover
from truepath.discovery.evidence import TermData, log_bayes
from truepath.discovery.scan import scan_term
from truepath.discovery.terms.folded_lines import build_lines
from truepath.discovery.terms.term_equations import TermEquations
from truepath_simulators.hidden.setup import SetupStep
from truepath_simulators.worlds.synthetic import Setting

SMALL = {"rows": 30, "travel_mm": 150.0}


def moment_within(seen: Observations, line: int, share: float) -> float:
    """Return a moment of a line's share, on the tracker's clock."""
    time_s = seen.at.time_s[seen.at.line == line]
    return float(time_s.min() + share * np.ptp(time_s))


@pytest.mark.parametrize(
    ("line", "share"),
    [
        (12, 0.37),
        pytest.param(17, 0.8, marks=pytest.mark.long),
    ],
)
def test_a_knock_while_a_line_is_driven_is_not_taken_for_one_in_a_pause(
    record, line, share
):
    quiet, truth = record(11, **SMALL)
    clock = truth.recording.clock
    moment_s = moment_within(align_runs([quiet])[0].observations, line, share)
    machine_s = float(clock.true_s(np.array(moment_s)))
    setting = Setting(hidden=(SetupStep(machine_s, (3.0, -2.0, 1.0)),))
    (found,) = discover([record(11, **SMALL, setting=setting)[0]]).findings
    said = found.parameters["t_s"]
    assert found.candidate.family == "setup-step"
    assert abs(said.value - moment_s) < min(0.1, 3.0 * said.uncertainty)


def test_moments_are_compared_at_once_as_one_by_one(record):
    run, _ = record(11, **SMALL)
    found = discover([run])
    lines = build_lines([run], [found.aligned[0].observations], found.baseline)
    precision = found.baseline.prior.precision_matrix(lines.size)
    data = TermData(TermEquations(lines), precision + lines.pose_precision)
    term = next(t for t in found.fitter.catalogue if t.family.happens_once)
    beside = [t for t in found.fitter.catalogue if not t.family.happens_once][:2]
    scan = term.scan(data.conditions_of(term))
    moment_s = np.sort(np.r_[scan.values[::11], scan.values[40] + [0.03, 0.06]])
    each = data.compare(beside, [term.with_value(float(t)) for t in moment_s])
    at_once = data.compare_moments(beside, term, moment_s)
    assert np.allclose(at_once.log_bayes(), each.log_bayes(), rtol=1e-8, atol=1e-6)
    residuals = found.fitter.residuals(found.baseline_fit)
    best = scan_term(term, residuals).candidate.value
    quick = [quick_gain(term, residuals, t) for t in [*scan.values, best]]
    assert quick[-1] == pytest.approx(max(quick), abs=1e-9)


def quick_gain(term, residuals, moment_s):
    """Return the log Bayes factor of a shift of all cells, the machine left aside."""
    J = term.with_value(float(moment_s)).candidate.effect.jacobian(residuals[0].at)
    data = np.einsum("nip,ni->p", J, residuals[0].weighted)
    square = np.einsum("nip,nij,njq->pq", J, residuals[0].precision, J)
    return log_bayes(square, data, term.candidate.usual)
