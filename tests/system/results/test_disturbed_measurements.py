"""Disturbed or driven otherwise: the right result, or words that it is not."""

import copy
import pathlib
from dataclasses import replace

import numpy as np
import pytest

from following import shift
from recorded import with_samples
from results_fixtures import shorten
from truepath.alignment.align import align, drop_measured_elsewhere
from truepath.alignment.observations.observations import Driving
from truepath.errors import AlignmentError
from truepath.files.earlier.verdict import Verdict
from truepath.kinematics.conditions import make_standstill
from truepath.motion.configurations import select_rows
from truepath.results import analysis, result_assessment
from truepath.results.analysis import analyse
from truepath.results.result_assessment import assess_driving
from truepath.results.result_json import result_json
from truepath.results.volumetric_error import VolumetricError, make_grid
from truepath_drivers.interfaces.records import Path
from truepath_simulators import machine_file
from truepath_simulators.hidden.setup import TableDrift, TrackerRangeOffset
from truepath_simulators.motion.paths import turning_points
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Defects, Setting

TRAVEL_MM = 150.0
SEAT_MM = np.array([0.06, -0.08, 0.05])  # of W1 off its place
CONTENT = shorten(machine_file.load_machine("trunnion"))
CONTENT["tracker"]["stands_on"] = "base"


def shifted(run, first, last, shift_mm):
    moved = run.tracker.position_mm.copy()
    moved[first:last] += shift_mm
    return with_samples(run, position_mm=moved)


@pytest.fixture(scope="module")
def clean(record):
    return record(21, rows=40, travel_mm=TRAVEL_MM)[0]


@pytest.fixture(scope="module")
def found(clean):
    return analyse(clean)


def assert_states_the_same(spoilt, found):
    assert spoilt.verdict.state == "usable"
    stated_um = spoilt.volumetric.before.mean.value_um
    clean_um = found.volumetric.before.mean.value_um
    assert stated_um == pytest.approx(clean_um, rel=0.02)
    return stated_um, clean_um


def test_a_clean_measurement_is_usable_and_keeps_all(found):
    assert found.verdict.state == "usable"
    # One line is too short for a constant feed.
    assert {r.kind for r in found.verdict.reasons} <= {"lines-without-data"}
    assert found.setup_shifts == ()
    content = result_json(found)
    assert {each["cause"] for each in content["left_out"]} <= {"no-pass"}
    assert content["setup_steps"] == []


@pytest.mark.parametrize(("samples", "off_mm"), [(50, 5.0), (700, 0.1)])
@pytest.mark.fault_row(12)
def test_a_burst_is_left_out_and_named_by_its_time(
    clean, found, samples, off_mm, measured
):
    first = len(clean.tracker) // 3
    spoilt = analyse(shifted(clean, first, first + samples, [0.0, off_mm, 0.0]))
    time_s = clean.tracker.device_time_s[[first, first + samples - 1]]
    told = [each for each in result_json(spoilt)["left_out"] if each["samples"]]
    assert told
    assert min(each["from_s"] for each in told) < time_s[1]
    assert max(each["to_s"] for each in told) > time_s[0]
    assert max(each["distance_um"] for each in told) > 500.0 * off_mm
    stated_um, clean_um = assert_states_the_same(spoilt, found)
    measured(
        f"{samples} samples {off_mm:g} mm off: {stated_um:.2f} µm stated, "
        f"{clean_um:.2f} µm without them"
    )


@pytest.mark.fault_row(11)
def test_a_knock_splits_the_run_and_both_places_are_solved(clean, found):
    first = int(0.55 * len(clean.tracker))
    spoilt = analyse(shifted(clean, first, None, [0.03, -0.03, 0.02]))
    (knock,) = spoilt.setup_shifts
    assert abs(knock.time_s - clean.tracker.device_time_s[first]) < 3.0
    assert 1e3 * knock.moved_mm == pytest.approx(46.9, abs=2.0)
    assert [run.part for run in spoilt.runs] == [1, 2]
    (step,) = result_json(spoilt)["setup_steps"]
    assert step["kind"] == "place"
    assert "set-up-moved" in {reason.kind for reason in spoilt.verdict.reasons}
    assert_states_the_same(spoilt, found)


def test_a_drift_is_no_knock_and_widens_what_is_stated(record):
    drift, how = TableDrift((0.3, -0.3, 0.24)), {"rows": 40, "travel_mm": TRAVEL_MM}
    settings = Setting(), Setting(hidden=(drift,))
    runs = (record(22, setting=setting, **how)[0] for setting in settings)
    still, drifting = map(analyse, runs)
    assert drifting.setup_shifts == ()
    before, after = (one.volumetric.before.mean for one in (still, drifting))
    assert after.uncertainty_um > 1.3 * before.uncertainty_um
    apart = np.hypot(before.uncertainty_um, after.uncertainty_um)
    assert abs(after.value_um - before.value_um) < 2.0 * apart
    noise = drifting.estimate.runs[0].noise
    assert noise.ou_time_s > 3.0 * still.estimate.runs[0].noise.ou_time_s


@pytest.mark.fault_row(12)
def test_a_frozen_tracker_is_said(clean):
    first = len(clean.tracker) // 2
    moved = clean.tracker.position_mm.copy()
    moved[first : first + 1000] = moved[first]
    spoilt = analyse(with_samples(clean, position_mm=moved))
    assert "frozen" in {each.cause for each in spoilt.left_out[0]}
    assert spoilt.verdict.state == "usable"


@pytest.mark.long
@pytest.mark.fault_row(12)
def test_single_samples_of_the_wrong_sign_are_left_out_and_named(clean, found):
    rows = np.random.default_rng(5).choice(len(clean.tracker), 40, replace=False)
    moved = clean.tracker.position_mm.copy()
    moved[rows] *= [-1.0, 1.0, 1.0]
    spoilt = analyse(with_samples(clean, position_mm=moved))
    told = [each for each in result_json(spoilt)["left_out"] if each["samples"]]
    assert sum(each["samples"] for each in told) >= 30  # others are in no pass
    assert_states_the_same(spoilt, found)


@pytest.mark.parametrize(
    ("offset_um", "state", "how", "most_um"),
    [
        (-60.0, "doubtful", {"rows": 30, "travel_mm": 300.0}, 12.0),
        pytest.param(-40.0, "doubtful", {"rows": 60}, 6.0, marks=pytest.mark.long),
        pytest.param(250.0, "not-usable", {"rows": 60}, 10.0, marks=pytest.mark.long),
    ],
)
def test_a_wrong_home_distance_is_named_in_um(record, offset_um, state, how, most_um):
    setting = Setting(hidden=(TrackerRangeOffset(offset_um),))
    findings = analyse(record(31, **how, setting=setting)[0])
    assert findings.setup_shifts == ()
    reasons = findings.verdict.reasons
    (reason,) = (one for one in reasons if one.kind == "range-off")
    assert reason.state == state
    found, within = reason.values["distance_um"], reason.values["within_um"]
    assert abs(found - offset_um) < 1.5 * within
    assert within < most_um


@pytest.fixture(scope="module")
def made():
    program = turning_points(machine_file.parse_machine(CONTENT), 5, 96, dwell_s=0.4)
    return synthetic.record(CONTENT, program, 5, "standstill")


@pytest.fixture(scope="module")
def change(made):
    return made.program.target.index("W1")


def test_a_point_lost_where_the_target_changes_may_be_a_knock(made, run_of, change):
    run, amid = run_of(made), change + 8
    status = np.where(np.isin(made.row, (change, amid)), 1, run.tracker.status)
    verdict = analyse(with_samples(run, status=status)).verdict
    values = {reason.kind: reason.values for reason in verdict.reasons}
    assert verdict.state == "doubtful"
    assert values["points-without-data"] == {"points": f"{change}, {amid}"}
    near = values["knock-unseen"]["rows"].split(", ")
    assert (str(change) in near, str(amid) in near) == (True, False)


@pytest.mark.long
def test_a_run_without_its_first_target_at_the_end_says_so(made, run_of, change):
    kinds = {r.kind: r.values for r in analyse(run_of(made)).verdict.reasons}
    assert str(change) in kinds["not-measured-again"]["rows"].split(", ")


@pytest.mark.long
def test_a_knock_at_a_change_shows_where_the_first_target_comes_again(made, run_of):
    program = made.program
    own = program.target.index("T2") // 2
    position = np.vstack([program.position[:-4], program.position[:4]])
    target = program.target[own:] + program.target[:own]
    order = replace(program, position=position, target=target)
    seated = copy.deepcopy(CONTENT)
    w1 = seated["targets"]["W1"]
    w1["offset_mm"] = (np.array(w1["offset_mm"]) + SEAT_MM).tolist()
    recorded = synthetic.record(seated, order, 5, "standstill")
    made_again = replace(recorded, content=CONTENT)
    first = made_again.program.target.index("W1")
    knock_s = made_again.time_s[made_again.row >= first][0]
    run = run_of(made_again)
    late = (run.tracker.device_time_s >= knock_s)[:, None]
    knocked = analyse(shift(run, late * [0.012, -0.008, 0.014]))
    (knock,) = knocked.setup_shifts
    assert 1e3 * knock.moved_mm == pytest.approx(20.1, abs=3.0)
    every = [seat for part in knocked.runs for seat in part.estimate.seats]
    seats = [seat for seat in every if seat.target.name == "W1"]
    assert seats
    for seat in seats:
        assert (np.abs(seat.shift_mm - SEAT_MM) < 3.0 * seat.sigma_mm).all()


VALIDATION = pathlib.Path(__file__).parents[3] / "validation"
LEAN = np.array([[1.0, 0.002, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def said_of(run) -> Verdict:
    return assess_driving([align(run).driving], ["run"])


def at_feed(run, share):
    path = run.commanded
    return replace(run, commanded=replace(path, feed_mm_min=path.feed_mm_min / share))


def values_of(verdict):
    return {reason.kind: reason.values for reason in verdict.reasons}


def held(record, lines=(5, 12), stood_s=(2.0, 0.8)):
    run, _ = record(6, travel_mm=200.0)
    passes = {each.row: each for each in align(run).passes}
    time_s = run.tracker.device_time_s - run.tracker.device_time_s[0]
    middles = [time_s[(passes[k].first + passes[k].last) // 2] for k in lines]
    later_s = np.concatenate([[0.0], np.cumsum(stood_s)[:-1]])
    holds = tuple(zip(middles + later_s, stood_s, strict=True))
    setting = Setting(defects=Defects(holds=holds))
    return record(6, travel_mm=200.0, setting=setting)[0]


def lengthened(path, rng, rows=6):
    low, high = path.position.min(axis=0), path.position.max(axis=0)
    more = rng.uniform(low, high, (rows, len(low)))
    columns = path.feed_mm_min, path.dwell_s
    longer = (np.append(column, np.full(rows, column[-1])) for column in columns)
    return Path(path.axes, np.vstack([path.position, more]), *longer)


def ended_at(run, rows, share):
    """The same recording, of a path that ends so far on the way to its last row."""
    path = select_rows(run.commanded, slice(rows))
    position = path.position.copy()
    position[-1] = position[-2] + share * (position[-1] - position[-2])
    return replace(run, commanded=replace(path, position=position))


@pytest.mark.parametrize("seed", [6, 7])
def test_of_a_path_that_was_driven_as_commanded_nothing_is_said(record, seed):
    run, _ = record(seed)
    assert said_of(run).reasons == ()


@pytest.mark.parametrize("share", [0.5, 0.9, 1.2])
def test_an_override_is_told_in_percent_and_names_its_lines(record, share):
    run, _ = record(6)
    values = values_of(said_of(at_feed(run, share)))["other-feed"]
    percents = [values["lowest_percent"], values["highest_percent"]]
    assert percents == pytest.approx([100 * share] * 2, abs=1.0)
    some = np.ones(len(run.commanded))
    some[8:11] = share
    lines = values_of(said_of(at_feed(run, some)))["other-feed"]["lines"].split(", ")
    assert set(lines) <= {"8", "9", "10"}


def test_an_early_stop_and_a_late_begin_say_how_much_is_missing(record, rng):
    run, _ = record(6)
    planned = lengthened(run.commanded, rng)
    values = values_of(said_of(replace(run, commanded=planned)))["path-not-whole"]
    assert values == {"first": 1, "last": 23, "lines": 29}
    late = Setting(defects=Defects(late_start_s=15.0))
    values = values_of(said_of(record(6, setting=late)[0]))["path-not-whole"]
    assert values["first"] > 1
    assert values["last"] == values["lines"] == 23


@pytest.mark.parametrize(
    ("first", "last", "is_told"),
    [(0, 6, False), (1, 6, False), (2, 6, True), (1, 5, True)],
)
def test_one_line_that_is_missing_at_either_end_is_told(first, last, is_told):
    said = assess_driving([Driving(first, last, 7, {}, ())], ["run"]).reasons
    told = {"first": first, "last": last, "lines": 6}
    assert [reason.values for reason in said] == [told] * is_told


@pytest.mark.parametrize(("driven", "missing"), [(6, False), (4, True)])
def test_lines_that_a_further_run_has_are_not_missing(record, rng, driven, missing):
    run, _ = record(6)
    planned = lengthened(run.commanded, rng)
    first = replace(run, commanded=planned)
    rest = replace(run, commanded=select_rows(planned, slice(23, None)))
    seen = align(first)
    driving = Driving(0, driven, 7, {}, ())
    further = replace(seen, row=seen.row.clip(max=driven), driving=driving)
    found = drop_measured_elsewhere([first, rest], [seen, further])
    said = assess_driving([found[0].driving, None], ["first", "rest"]).reasons
    told = {"first": 1, "last": 23 + driven, "lines": 29}
    assert [reason.values for reason in said] == [told] * missing


@pytest.mark.fault_row(21)
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_what_is_driven_beyond_the_last_row_is_taken_for_no_line(
    record, share, measured
):
    """It goes on to further places, or through the last one without a stop."""
    run, _ = record(6)
    whole = {each.row: each for each in align(run).passes}
    begun = {each.row: each for each in align(ended_at(run, 18, share)).passes}
    last = 17 if share == 1.0 else 16
    measured(f"{len(begun)} of {len(whole)} lines taken, {last} driven")
    assert sorted(begun) == list(range(1, last + 1))
    for row, each in begun.items():
        assert (each.first, each.last) == (whole[row].first, whole[row].last)


@pytest.mark.parametrize("other", [7, 8])
@pytest.mark.fault_row(21)
def test_another_program_is_refused(record, other):
    run, _ = record(6)
    wrong, _ = record(other)
    with pytest.raises(AlignmentError, match="recording belongs to this path"):
        align(replace(run, commanded=wrong.commanded))


def test_pauses_are_counted_and_the_verdict_of_an_analysis_says_them(record):
    stood = held(record)
    values = values_of(said_of(stood))["held-on-the-way"]
    assert (values["times"], values["lines"]) == (2, "5, 12")
    assert values["longest_s"] == pytest.approx(2.0, abs=0.3)
    verdict = analysis.analyse(at_feed(stood, 0.8)).verdict
    assert {"held-on-the-way", "other-feed"} <= values_of(verdict).keys()
    assert verdict.state == "usable"  # all the same
    text = " ".join(map(str, verdict.reasons))
    assert "stopped in the middle of lines: 2 times" in text
    assert "80.0 % of the feed of the path" in text


def judge(machine, change):
    q = make_grid(machine.axes, 5, 3)
    place = make_standstill(machine, q).point_mm
    driven = make_standstill(machine, change(q)).point_mm
    error_um = 1e3 * (driven - place)
    none = VolumetricError(q, error_um, error_um, np.zeros(2), None, None)
    reasons = result_assessment.assess_program(machine, none).reasons
    return {(one.kind, one.values["axes"]): one.values["by"] for one in reasons}


def add(axis, by):
    return lambda q: q + by * np.eye(q.shape[1])[axis]


def lengthen(axis, factor):
    return lambda q: q + (factor - 1.0) * q * np.eye(q.shape[1])[axis]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lengthen(0, 1.001), {("axis-scaled", "X"): "+1000 ppm"}),
        (lengthen(2, 0.9995), {("axis-scaled", "Z"): "-500 ppm"}),
        (lambda q: q @ LEAN, {("axes-leaning", "X Y"): "+2000 ppm"}),
        (add(1, 20.0), {}),  # the same as another place of the tracker
        (lengthen(0, 1.0003), {}),
    ],
)
def test_a_changed_program_of_straight_axes_is_named(mill, change, said):
    assert judge(mill, change) == said


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (add(1, 1.0), ("axis-shifted", "Y")),
        (add(3, 0.5), ("axis-shifted", "A")),
        (lengthen(4, 0.999), ("axis-scaled", "C")),
    ],
)
def test_a_changed_program_of_rotary_axes_is_named(trunnion, change, kind):
    assert kind in judge(trunnion, change)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lines", "points", "rotary-points", "rotary-lines"])
def test_no_wrong_program_gives_a_wrong_table_in_silence(kind, monkeypatch):
    monkeypatch.syspath_prepend(str(VALIDATION))
    import recordings
    import target_seats
    import wrong_programs

    for module in (recordings, target_seats):  # a tracker's errors hide a program's
        monkeypatch.setattr(module, "draw_specification", lambda seed: {})
    draw = wrong_programs.random_content  # machines of straight axes
    smaller = "random_content", lambda seed: shorten(draw(seed))
    monkeypatch.setattr(wrong_programs, *smaller)
    plan, wrongs = wrong_programs.KINDS[kind]
    # All of them are tried by `make validation`, on machines of usual size.
    for seed, name in enumerate(sorted(wrongs)[::3], start=700):
        if name in wrong_programs.RIGID and not kind.startswith("rotary"):
            continue
        found = wrong_programs.try_wrong(plan(seed), wrongs[name], seed)
        assert not wrong_programs.is_wrong(found), (name, seed, found)
