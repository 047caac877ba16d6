"""Names that compete or that a Run cannot tell, and the lines that decide."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from recorded import choose_program, load_erring, record_run
from truepath.answers import discovery_report
from truepath.answers.discovery import build_next_model
from truepath.answers.discovery_json import discovery_json, proposal_json
from truepath.answers.shown.page import render_part
from truepath.discovery.discover import Discovery, baseline_model, discover
from truepath.discovery.discrimination import DiscriminationDesign
from truepath.discovery.open_questions import design_discrimination
from truepath.errors import BundleError
from truepath.files.bundle.commanded_file import decode_commanded, encode_commanded
from truepath.kinematics.model import EstimatedModel, MachineModel
from truepath.motion.workspace import check_travel
from truepath.service.api.models.job_request import JobRequest
from truepath.service.api.models.results.discovery import CannotTellOut
from truepath_simulators.hidden.drives import Backlash, LateralBacklash, ServoMismatch
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting

MACHINE = 5
TRAVEL_MM = 400.0
CONTENT = load_machine("demo")
for one in CONTENT["axes"].values():
    one["max_mm"] = TRAVEL_MM
LOW, HIGH = (parse_machine(CONTENT).low_mm, parse_machine(CONTENT).high_mm)


@dataclass(frozen=True)
class Circle:
    first: Discovery
    asked: DiscriminationDesign
    both: Discovery


def even_in_x():
    """Lines on which X has one speed: on them lost motion looks like a lag."""
    rng, n = np.random.default_rng(3), 24
    share = rng.random((n, 3))
    far = np.arange(n) % 2 == 1
    share[:, 0] = np.where(far, 0.75 + 0.25 * share[:, 0], 0.25 * share[:, 0])
    position = np.round(LOW + 15.0 + share * (HIGH - LOW - 30.0), 3)
    step = np.diff(position, axis=0, prepend=position[:1])
    slant = np.linalg.norm(step[1:], axis=1) / np.abs(step[1:, 0])
    feed = 80.0 * np.append(1.0, slant)
    return Program(position, feed, np.full(n, 0.35))


def two_sides_of_y(n=40, depth=0.0):
    """Points at both ends of Y, each approached from the other: play looks like a lean.

    The first point, approached from nowhere, is in the middle, where no lean shows.
    depth : of the ends, as a share of the travel
    """
    share = np.random.default_rng(4).random((n, 3))
    far = np.arange(n) % 2 == 1
    share[:, 1] = np.where(far, 1.0 - depth * share[:, 1], depth * share[:, 1])
    share[0, 1] = 0.5
    position = np.round(LOW + 15.0 + share * (HIGH - LOW - 30.0), 3)
    return Program(position, np.full(n, 100.0), np.full(n, 0.8))


@pytest.fixture(scope="module")
def calibrated(record):
    setting = Setting(machine_seed=MACHINE)
    how = {"rows": 40, "feed": 6000.0, "travel_mm": TRAVEL_MM}
    return baseline_model(discover([record(9, **how, setting=setting)[0]]))


def without(known, effect):
    kept = tuple(e for e in known.model.effects if e.name != effect)
    number = np.arange(known.model.size)
    columns = np.concatenate([number[known.model.slices[e.name]] for e in kept])
    model = MachineModel(known.model.machine, kept)
    covariance = known.covariance[np.ix_(columns, columns)]
    return EstimatedModel(model, known.theta[columns], covariance)


SIDEWAYS = LateralBacklash("Y", "EXY", 5.0, 0.3)
LEAN = pytest.param(None, marks=pytest.mark.long, id="squareness")


@pytest.fixture(scope="module", params=[pytest.param(SIDEWAYS, id=SIDEWAYS.name), LEAN])
def leaning(request, run_of, calibrated):
    effect = request.param
    name = "squareness" if effect is None else effect.name
    given = without(calibrated, "C0Y" if effect is None else "")
    hidden = () if effect is None else (effect,)
    program = two_sides_of_y()
    setting = Setting(machine_seed=MACHINE, hidden=hidden)
    run = run_of(synthetic.record(CONTENT, program, 6, "standstill", setting))
    first = discover([run], given)
    asked = design_discrimination(first)
    assert asked is not None
    path = asked.path
    more = Program(path.position, path.feed_mm_min / 60.0, path.dwell_s)
    extra = run_of(synthetic.record(CONTENT, more, 77, "otf", setting))
    return name, Circle(first, asked, discover([run, extra], given))


LAG = pytest.param(ServoMismatch("X", 0.06), marks=pytest.mark.long)


@pytest.mark.parametrize("effect", [Backlash("X", 8.0), LAG], ids=lambda e: e.name)
def test_standstills_tell_lost_motion_from_a_lag_at_one_speed(run_of, effect):
    setting = Setting(machine_seed=MACHINE, hidden=(effect,))
    run = run_of(synthetic.record(CONTENT, even_in_x(), 6, "otf", setting))
    (found,) = discover([run]).findings
    assert found.candidate.label == f"{effect.name} X"
    assert not found.alternatives
    (said,) = found.parameters.values()
    truth = {"backlash": 8.0, "servo-mismatch": 0.06}[effect.name]
    assert abs(said.value - truth) < 3.0 * said.uncertainty


def test_lateral_backlash_and_squareness_are_told_apart_by_few_lines(leaning):
    name, done = leaning
    competing = {"lateral-backlash Y EXY", "squareness C0Y"}
    assert {done.asked.questions[0].left, done.asked.questions[0].right} == competing
    assert done.asked.lines < 10
    found = done.both.findings[0]
    assert found.candidate.family == name
    assert not found.alternatives


def test_every_run_is_shown_where_it_disagrees(leaning):
    name, done = leaning
    both = json.loads(json.dumps(discovery_json(done.both)))
    assert [run["mode"] for run in both["runs"]] == ["standstill", "otf"]
    points, rows = (len(scene.run.commanded) for scene in done.both.aligned)
    # Lines and the standstills at their ends: from where the first point, or the
    # beginning of a path, was come to is unknown.
    parts = (points - 1, 2 * (rows - 1))
    assert [len(run["where"]) for run in both["runs"]] == [min(20, p) for p in parts]
    worst = [segment["rms_um"] for segment in both["where"]]
    assert worst == sorted(worst, reverse=True)
    every = [s["rms_um"] for run in both["runs"] for s in run["where"]]
    assert worst[0] == max(every)
    model = build_next_model(done.both, None)
    page = discovery_report.render_discovery_report(
        done.both, model, None, "ask/path.csv"
    )
    assert page.count("Run 2: ") == 2
    if name == "lateral-backlash":  # directions are two sides, not a scale from −1 to 1
        assert "− direction" in page
        assert "+ direction" in page
    assert page.count("Root mean square on every line") == 2


def test_the_lines_and_the_reason_are_said_in_file_report_and_order(leaning):
    _, done = leaning
    said = proposal_json(done.asked, "ask/path.csv")
    assert "lateral-backlash Y EXY" in said["reason"]
    assert "squareness C0Y" in said["reason"]
    assert f"{said['lines']} lines" in said["reason"]
    assert said["path"] == "ask/path.csv"
    assert said["decides"]
    asked = discovery_report.describe_proposal(done.asked, "ask/path.csv")
    page = render_part("discovery/ask.html", {"ask": asked})
    question = done.asked.questions[0]
    assert f"{question.left}, or {question.right}?" in page
    assert f"{done.asked.expected[0]:.1f}" in page
    assert page.count("<tr>") == 2 + len(done.asked.questions) + len(done.asked.path)
    assert "ask/path.csv" in page
    order = JobRequest.model_validate({"kind": "measure-otf", "path": said["rows"]})
    assert order.path is not None
    driven = [[row.x_mm, row.y_mm, row.z_mm] for row in order.path]
    assert driven == done.asked.path.position.tolist()
    machine, path = done.first.aligned[0].run.machine, done.asked.path
    read = decode_commanded(encode_commanded(path), machine, "path.csv", is_path=True)
    np.testing.assert_array_equal(read.feed_mm_min, path.feed_mm_min)
    check_travel(machine, path)
    assert (path.position >= LOW).all()
    assert (path.position <= HIGH).all()
    assert (path.feed_mm_min > 0.0).all()


def test_from_where_the_first_point_was_reached_explains_nothing(run_of, calibrated):
    points = two_sides_of_y(24, 0.1)
    home = np.vstack([LOW, points.position])
    way = Program(home, np.full(len(home), 100.0), np.full(len(home), 0.8))
    setting = Setting(machine_seed=MACHINE, hidden=(SIDEWAYS,))
    recording = synthetic.record(CONTENT, way, 7, "standstill", setting)
    run = run_of(replace(recording, program=points))
    (finding,) = discover([run], without(calibrated, "")).findings
    assert finding.candidate.label == "lateral-backlash Y EXY"


def test_an_axis_may_stand_in_a_further_run(record, run_of):
    rows = [[20.0, 20.0, 50.0], [180.0, 150.0, 50.0], [20.0, 150.0, 50.0]] * 2
    flat = Program(np.array(rows), np.full(6, 100.0), np.full(6, 0.35))
    content = {**CONTENT, "kinematic_chain": "w-b-X-Y-Z-t"}
    setting = Setting(machine_seed=11)
    extra = run_of(synthetic.record(content, flat, 78, setting=setting))
    assert not discover([record(11, travel_mm=TRAVEL_MM)[0], extra]).findings


def test_both_runs_must_be_of_one_machine(record):
    ours = record(11, rows=14)[0]
    other = record(11, rows=14, chain="w-X-b-Y-Z-t")[0]
    with pytest.raises(BundleError, match="kinematic_chain"):
        discover([ours, other])


RNG = np.random.default_rng(0)
ONWARD = np.column_stack([np.linspace(20, 380, 40), *RNG.uniform(20, 380, (2, 40))])


def step_axes(lines):
    """One axis moves on each line."""
    position = [np.full(3, 20.0)]
    for k in range(lines):
        here, axis = position[-1].copy(), k % 3
        high = here[axis] > TRAVEL_MM / 2
        here[axis] = RNG.uniform(20, 180) if high else RNG.uniform(220, 380)
        position.append(here)
    return np.array(position)


PATHS = {
    "onward": ONWARD,
    "there-and-back": np.vstack([ONWARD, ONWARD[-2::-1]]),
    "one-axis": step_axes(45),
}


@pytest.fixture(scope="module")
def listed(record):
    made = {}

    def list_untold(name):
        if name not in made:
            position, count = np.round(PATHS[name], 3), len(PATHS[name])
            program = Program(position, np.full(count, 100.0), np.full(count, 0.4))
            run, _ = record(11, program=program, travel_mm=TRAVEL_MM)
            made[name] = discovery_json(discover([run]))["cannot_tell"]
        return {(one["name"], one.get("axis", "")): one for one in made[name]}

    return list_untold


def test_play_of_an_axis_that_never_turns_is_a_place_of_the_tracker(listed):
    play = listed("onward")["backlash", "X"]
    assert play["taken_by"][0] == "pose"
    assert play["would_tell"] == "both-directions"
    assert play["sentence"].startswith("Backlash of X is not distinguishable from the")
    assert ("backlash", "Y") not in listed("onward")
    assert ("backlash", "X") not in listed("there-and-back")


def test_a_creep_is_not_told_from_an_axis_that_goes_on_with_time(listed):
    creep = listed("onward")["table-drift", ""]
    assert creep["taken_by"] == ["X"]
    assert creep["would_tell"] == "repeated-lines"
    assert ("table-drift", "") not in listed("there-and-back")


def test_a_lag_is_timing_where_one_axis_moves_at_a_time(listed):
    lag = listed("one-axis")["servo-mismatch", "X"]
    assert lag["taken_by"] == ["timing"]
    assert lag["would_tell"] == "oblique-lines"
    assert ("servo-mismatch", "X") not in listed("onward")


def test_an_offset_of_the_range_is_within_what_a_tracker_may_have(listed):
    made = load_erring(None)
    run, _ = record_run(made, choose_program(made, 12, rows=40), 12)
    untold = discovery_json(discover([run]))["cannot_tell"]
    (offset,) = (one for one in untold if one["name"] == "tracker-range-offset")
    assert "tracker-errors" in offset["taken_by"]
    perfect = listed("there-and-back")
    assert ("tracker-range-offset", "") not in perfect
    assert "Set the home distance again" in offset["sentence"]


def test_a_tilt_and_a_shift_of_one_carriage_are_alike_with_one_tool(listed):
    alike = listed("one-axis")["lateral-backlash", "Z"]
    others = alike["indistinguishable_from"]
    motions = {one["motion"] for one in (alike, *others)}
    assert motions in ({"EXZ", "EBZ"}, {"EYZ", "EAZ"})
    assert (alike["taken_by"], alike["would_tell"]) == ([], "other-target")


def test_the_list_is_short_and_as_described(listed):
    untold = listed("onward").values()
    assert 0 < len(untold) <= 12
    for one in untold:
        CannotTellOut.model_validate(one)
