"""What a Run's model lacks is named; what a tracker adds is not taken for it."""

from dataclasses import replace

import numpy as np
import pytest

from following import shift
from recorded import choose_program, load_erring, record_run, record_small
from truepath.answers.discovery import build_next_model
from truepath.answers.discovery_json import (
    discovery_json,
    effect_json,
    explain_proposal,
)
from truepath.discovery.discover import align_runs, discover, extend_model
from truepath.discovery.evidence import TermData, log_bayes
from truepath.discovery.findings import compute_share, state_findings
from truepath.discovery.line_blocks import build_lines
from truepath.discovery.name_trial import CERTAIN, LIKELY, POSSIBLE, Support, TriedNames
from truepath.discovery.open_questions import FREE_FORM, TRACKER, design_discrimination
from truepath.discovery.scan import scan_term
from truepath.discovery.term_equations import TermEquations
from truepath.discovery.value_refinement import refine_values
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath_simulators.hidden import drives, setup
from truepath_simulators.hidden.drives import Backlash, ScrewCyclic
from truepath_simulators.hidden.setup import SettlingStand, SetupStep, TableDrift
from truepath_simulators.hidden.structure import ThermalGrowth
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.synthetic import Setting

KNOCK_S, STEP_UM = 20.0, (4.0, -3.0, 0.0)
KNOCK = SetupStep(KNOCK_S, STEP_UM)
LEAD_MM, WAVE_UM = 5.0, 4.0
TAU_S, RISE_K, PER_K = 70.0, 2.5, 10.0
SMALL = {"rows": 30, "travel_mm": 150.0}


@pytest.fixture(scope="module")
def drive(record):
    def driven(*hidden):
        setting = Setting(hidden=hidden)
        return discover([record(11, rows=40, travel_mm=150.0, setting=setting)[0]])

    return driven


@pytest.fixture(scope="module")
def knocked(drive):
    return drive(KNOCK)


@pytest.fixture(scope="module")
def clean(drive):
    return drive()


def test_nothing_is_found_nor_asked_where_nothing_is_missing(clean):
    assert clean.findings == ()
    assert clean.gap.after_um == pytest.approx(clean.gap.before_um)
    assert clean.gap.after_um < 1.05 * clean.gap.noise_floor_um
    assert design_discrimination(clean) is None


def test_an_effect_below_what_a_control_corrects_needs_nothing_done(knocked):
    (found,) = knocked.findings
    stated = effect_json(found)
    # The mean place of the tracker takes half of a step in the middle.
    assert stated["largest_um"] == pytest.approx(np.linalg.norm(STEP_UM) / 2, rel=0.1)
    assert not stated["is_small"]
    stated = effect_json(replace(found, largest_mm=2e-4))
    assert stated["is_small"]
    assert stated["remedy"].endswith("it moves the target by 0.20 µm at most.")


def test_waves_and_spikes_are_as_large_as_cells_that_have_little_of_them_say(record):
    """X is crossed on every line; its wave is 0 wherever it stands."""
    rng, rows = np.random.default_rng(5), 24
    share = rng.integers(1, 8, rows) + 22 * (np.arange(rows) % 2)
    position = np.column_stack([LEAD_MM * share, *rng.uniform(10.0, 60.0, (2, rows))])
    program = Program(np.round(position, 3), np.full(rows, 100.0), np.full(rows, 0.4))
    setting = Setting(hidden=(ScrewCyclic("X", LEAD_MM, WAVE_UM, 0.0),))
    run, _ = record(11, program=program, travel_mm=150.0, setting=setting)
    crossing = discover([run])
    waves = [f for f in crossing.findings if f.candidate.label == "screw-cyclic X"]
    (found,) = waves
    assert effect_json(found)["largest_um"] == pytest.approx(WAVE_UM, rel=0.1)
    # A spike is largest at the reversal, before the first cell.
    fitter, label = crossing.fitter, "reversal-spike X X"
    (term,) = (each for each in fitter.catalogue if each.label == label)
    fit = fitter.fit([term.with_value(3.0)], refine=False)
    (found,) = state_findings(fitter, fit, TriedNames(fit, fit, (), {}, {}))
    assert found.largest_mm == pytest.approx(abs(found.theta[0]))


def test_a_vibration_is_asked_against_a_free_form_or_the_tracker(knocked):
    (found,) = knocked.findings
    swing = replace(found, grade=POSSIBLE, is_imitated=True)
    open_ = replace(knocked, fit=knocked.baseline_fit, findings=(), possible=(swing,))
    for evidence, other in ((50.0, FREE_FORM), (0.0, TRACKER)):
        doubted = {found.term.label: Support(evidence, 20.0, ())}
        tried = replace(knocked.tried, doubted=doubted)
        asked = design_discrimination(replace(open_, tried=tried))
        assert [question.right for question in asked.questions] == [other]


def test_a_knock_is_named_with_its_moment_and_size_and_closes_the_gap(knocked):
    (found,) = knocked.findings
    assert found.candidate.family == "setup-step"
    assert not found.alternatives
    assert found.grade == CERTAIN
    assert design_discrimination(knocked) is None
    assert knocked.possible == ()
    said = found.parameters
    begin = knocked.aligned[0].run.tracker.device_time_s[0]
    assert abs(said["t_s"].value - begin - KNOCK_S) < 0.1
    for axis, value in zip("xyz", STEP_UM, strict=True):
        step = said[f"step_um[{axis}]"]
        assert abs(step.value - value) < 3.0 * step.uncertainty
        assert step.uncertainty < 0.5
    gap = knocked.gap  # on lines that were not seen it falls to the noise
    open_before = gap.before_um - gap.noise_floor_um
    assert open_before > 2.0 * (gap.after_um - gap.noise_floor_um)
    assert gap.after_um < 1.05 * gap.noise_floor_um
    assert 0.9 < found.evidence.share <= 1.0
    (shown,) = knocked.residuals
    shares = shown.before.shares
    assert list(shares)[:2] == ["line", "time"]
    assert shares["line"] > 2.0 * shown.after.shares["line"]


@pytest.mark.long
def test_an_effect_beside_one_that_stays_closes_its_part_of_the_gap(record):
    hidden = SetupStep(40.0, STEP_UM), TableDrift((0.0, 0.05, 0.04))
    both = discover([record(11, rows=60, setting=Setting(hidden=hidden))[0]])
    without, terms = both.fitter.fit([]), [found.term for found in both.findings]
    assert len(terms) == 2
    alone = [both.fitter.fit([term]) for term in terms]
    shares = [compute_share(without.misfit - a.misfit, without, a) for a in alone]
    assert max(shares) < 0.9


def test_the_file_states_what_the_contract_asks(knocked, clean):
    content = discovery_json(knocked)
    assert content["schema"] == "discovery/1"
    (effect,) = content["effects"]
    assert effect["name"] == "setup-step"
    assert set(effect["parameters"]["t_s"]) == {"value", "uncertainty"}
    assert len(effect["parameters"]["step_um"]["uncertainty"]) == 3
    assert effect["indistinguishable_from"] == []
    stated = {"unit", "before", "after", "noise_floor", "expected", "on"}
    assert set(content["gap"]) == stated
    assert content["gap"]["noise_floor"] < content["gap"]["expected"]
    assert content["unnamed"] == []
    worst = content["where"]
    assert [s["rms_um"] for s in worst] == sorted(s["rms_um"] for s in worst)[::-1]
    lines = content["lines"]
    assert max(line["before_um"] for line in lines) == worst[0]["rms_um"]
    times_s = [line["time_s"] for line in lines]
    assert times_s == sorted(times_s)
    assert discovery_json(clean)["effects"] == []


def test_a_cause_that_nobody_listed_gets_no_name(record):
    """The tracker's stand leans, in no shape of the catalogue."""
    setting = Setting(hidden=(SettlingStand((20.0, -14.0), 15.0),))
    run, _ = record(11, rows=20, travel_mm=150.0, setting=setting)
    settling = discovery_json(discover([run]))
    assert settling["effects"] == []
    assert any("t" in one["depends_on"] for one in settling["unnamed"])
    assert all(one["grade"] == "possible" for one in settling["possible"])


@pytest.mark.long
def test_growth_and_time_constant_agree_with_the_truth_and_carry_what_is_open(record):
    """A Run as short as the time constant that its Z axis warms with, unseen."""
    growth = ThermalGrowth("Z", PER_K, RISE_K, TAU_S, has_sensor=False)
    warming = discover([record(11, rows=40, setting=Setting(hidden=(growth,)))[0]])
    (found,) = warming.findings
    said = found.parameters
    assert found.candidate.label == "thermal-growth Z"
    for name, truth in (("growth_um_per_m", PER_K * RISE_K), ("tau_s", TAU_S)):
        assert abs(said[name].value - truth) < 2.0 * said[name].uncertainty
    # Growth is foretold for a time nobody has seen: far from as well as the data fit.
    assert said["tau_s"].uncertainty > 0.1 * said["tau_s"].value
    _, alone = warming.fit.parameters_of(0)
    assert float(found.term.covariance[0, 0]) > 2.0 * float(alone[0, 0])


@pytest.mark.parametrize(
    ("line", "share"), [(12, 0.37), pytest.param(17, 0.8, marks=pytest.mark.long)]
)
def test_a_knock_on_a_line_is_not_taken_for_one_in_a_pause(record, line, share):
    quiet, truth = record(11, **SMALL)
    at = align_runs([quiet])[0].observations.at
    time_s = at.time_s[at.line == line]
    moment_s = time_s.min() + share * np.ptp(time_s)
    machine_s = float(truth.recording.clock.true_s(np.array(moment_s)))
    setting = Setting(hidden=(SetupStep(machine_s, (3.0, -2.0, 1.0)),))
    (found,) = discover([record(11, **SMALL, setting=setting)[0]]).findings
    said = found.parameters["t_s"]
    assert found.candidate.family == "setup-step"
    assert abs(said.value - moment_s) < min(0.1, 3.0 * said.uncertainty)


def term_data(run, found):
    lines = build_lines([run], [found.aligned[0].observations], found.baseline)
    precision = found.baseline.prior.precision_matrix(lines.size)
    return TermData(TermEquations(lines), precision + lines.pose_precision)


def test_a_time_constant_is_the_mean_of_all_that_the_run_allows():
    """It is as likely near each value of the scan; a short Run excludes few."""
    growth = ThermalGrowth("Z", PER_K, RISE_K, TAU_S, has_sensor=False)
    run, _ = record_small(11, rows=20, hidden=(growth,))
    found = discover([run])
    data = term_data(run, found)
    term = next(t for t in found.fitter.catalogue if t.label == "thermal-growth Z")
    (refined,) = refine_values(data, [term])
    scanned = term.scan(data.conditions_of(term)).values
    tau_s = np.linspace(scanned[0], scanned[-1], 600)
    log_bayes = data.try_values([], refined, tau_s).log_bayes
    weight = np.exp(log_bayes - log_bayes.max())
    weight /= np.interp(tau_s, scanned, np.gradient(scanned))
    weight /= weight.sum()
    mean_s = weight @ tau_s
    spread_s = np.sqrt(weight @ (tau_s - mean_s) ** 2)
    assert abs(refined.candidate.value - mean_s) < 0.3 * spread_s
    assert refined.value_sigma == pytest.approx(spread_s, rel=0.2)


def test_moments_are_compared_at_once_as_one_by_one(record):
    run, _ = record(11, **SMALL)
    found = discover([run])
    data = term_data(run, found)
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
    J = term.with_value(float(moment_s)).candidate.effect.jacobian(residuals[0].at)
    data = np.einsum("nip,ni->p", J, residuals[0].weighted)
    square = np.einsum("nip,nij,njq->pq", J, residuals[0].precision, J)
    return log_bayes(square, data, term.candidate.prior_sigma)


def measure(errors, *hidden, stated=None):
    made, setting = load_erring(errors), Setting(hidden=hidden)
    run, _ = record_run(made, choose_program(made, 12, rows=40), 12, setting=setting)
    if stated is None:
        return run
    tracker = replace(run.machine.tracker, specification=stated)
    return replace(run, machine=replace(run.machine, tracker=tracker))


def test_what_a_tracker_beyond_its_specification_may_do_is_asked_not_named():
    stated = TrackerSpecification(delay_us=8.0)
    found = discover([measure({"delay_us": 90.0}, stated=stated)])
    content = discovery_json(found)
    assert content["effects"] == []
    (possible,) = content["possible"]
    assert {"name": "tracker-errors"} in possible["indistinguishable_from"]
    assert "an error of the tracker" in explain_proposal(design_discrimination(found))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_is_counted_as_noise_beyond_the_stated_is_described(seed):
    """The distance meter errs by half to twice 10 µm, in cycles of 1 to 4 mm."""
    amplitude, cycles = np.random.default_rng(seed).uniform(-1.0, 1.0, 2)
    run = measure(None)
    point_mm = run.tracker.position_mm
    distance_mm = np.linalg.norm(point_mm, axis=1)[:, None]
    turns = distance_mm / (2.0 * 2.0**cycles)
    cyclic_mm = 0.01 * 2.0**amplitude * np.sin(2.0 * np.pi * turns)
    found = discover([shift(run, cyclic_mm * point_mm / distance_mm)])
    said = [one["description"] for one in discovery_json(found)["unnamed"]]
    assert any("along the beam" in text and "as noise" in text for text in said)


def sample_delay(seed):
    """Delays and crosstalk of half to twice 30 µs (one standard deviation)."""
    return {"delay_us": 30.0 * 2.0 ** np.random.default_rng(seed).uniform(-1.0, 1.0)}


@pytest.mark.parametrize(
    "errors",
    [None, {"delay_us": 90.0}, sample_delay(1), sample_delay(2)],
    ids=["typical", "late", "drawn-1", "drawn-2"],
)
def test_a_tracker_that_errs_is_no_lost_motion_and_no_lag_of_the_machine(errors):
    found = discover([measure(errors, stated=TrackerSpecification())])
    assert found.findings == ()
    assert found.possible == ()
    assert found.gap.after_um < 1.05 * found.gap.noise_floor_um


def test_play_is_certain_and_errors_of_the_tracker_are_no_part_of_the_next_model():
    worn = discover([measure(None, Backlash("Y", 8.0))])
    (found,) = worn.findings
    assert found.candidate.label == "backlash Y"
    assert found.grade == CERTAIN
    width = found.parameters["width_um"]
    assert abs(width.value - 8.0) < 3.0 * width.uncertainty
    extended = extend_model(worn)
    ((_, effect),) = extended.added
    part = extended.model.slices[effect.name]
    known = extended.covariance[part, part].diagonal()
    assert known == pytest.approx(found.covariance.diagonal(), rel=0.1)
    said = str(build_next_model(worn, None).content["model"])
    assert "backlash" in said
    assert "tracker" not in said
    assert "set-up" not in said


@pytest.fixture
def search(record):
    def searched(seed, *hidden):
        setting = Setting(hidden=hidden)
        return discover([record(seed, rows=40, travel_mm=150.0, setting=setting)[0]])

    return searched


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_a_cycle_of_the_range_is_named_with_its_period_and_size(search, seed):
    rng = np.random.default_rng(seed)
    amplitude_um = rng.uniform(1.5, 4.0)
    period_mm = np.exp(rng.uniform(np.log(5.0), np.log(120.0)))
    hidden = setup.RangeCycle(period_mm, amplitude_um, rng.uniform(0.0, 2.0 * np.pi))
    (found,) = search(seed, hidden).findings
    assert found.candidate.family == "range-cycle"
    for name in ("period_mm", "amplitude_um"):
        said, true = found.parameters[name], getattr(hidden, name)
        assert abs(said.value - true) < 3.0 * said.uncertainty
        assert said.uncertainty < 0.1 * true


def test_a_longer_cycle_gets_no_other_cause_and_a_vibration_is_still_one(search):
    found = search(1, setup.RangeCycle(245.0, 2.8, 0.9))
    causes = [one for one in found.findings if one.structure is None]
    assert {one.candidate.family for one in causes} <= {"range-cycle"}
    (found,) = search(1, drives.Vibration("Y", 12.0, 2.0)).findings
    assert found.candidate.label == "vibration Y"
    assert (found.grade, found.is_imitated) == (LIKELY, True)  # or the tracker's head
