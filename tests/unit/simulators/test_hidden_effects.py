"""Synthetic recordings, and the effects that are hidden in machines."""

import itertools
import json
from functools import cache

import numpy as np
import pytest

from plugin_site import install
from truepath.files.bundle.bundle import read_bundle
from truepath_simulators import machine_file
from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command import make_parser
from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden import drives, setup, structure
from truepath_simulators.hidden import effects_by_name as named
from truepath_simulators.hidden.effect import Occasion, error_motion
from truepath_simulators.hidden.motion import Motion, continue_from
from truepath_simulators.machine import tracker_head
from truepath_simulators.motion import paths, profile
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import write_bundle_files

FEED_MM_S = 100.0
CLOCK = tracker_head.TrackerClock(100.0, 0.0)
CONTENT = machine_file.load_machine("demo")
MACHINE = machine_file.parse_machine(CONTENT)
QUIET = {"error_scale": 0.0, "noise_scale": 0.0, "clock": CLOCK}


def program(rows):
    n = len(rows)
    return Program(np.array(rows), np.full(n, FEED_MM_S), np.full(n, 0.2))


ENDS = (50, 50, 50), (250, 50, 50), (50, 50, 50), (50, 200, 50), (150, 200, 50)
THERE_AND_BACK = program(ENDS)
CHORDS = paths.chord_path(MACHINE, 2, 12, 60.0 * FEED_MM_S)


@cache
def spoil(is_long, *hidden):
    way, rate_hz = (CHORDS, 100.0) if is_long else (THERE_AND_BACK, 500.0)
    setting = synthetic.Setting(**QUIET, hidden=hidden, rate_hz=rate_hz)
    return synthetic.record(CONTENT, way, 1, setting=setting)


def moved_um(effect, *, is_long=False):
    """How far a perfect machine's target is from where it would be without."""
    plain, spoilt = spoil(is_long), spoil(is_long, effect)
    off = spoilt.position_mm - plain.position_mm
    return 1e3 * off @ plain.pose.rotation.T, spoilt


def test_a_bench_without_positions_says_why():
    for source, said in ((None, "not started"), ("positions", "come from outside")):
        with pytest.raises(SimulatorError, match=said):
            Bench(source=source).follow(np.zeros(1))


def test_error_motions_of_one_axis_are_added():
    one, two = np.ones(3), np.full(3, 2.0)
    both = error_motion("EXX", one) | error_motion("EAX", two)
    both |= error_motion("EXX", two) | error_motion("EYY", one)
    assert list(both) == ["X", "Y"]
    np.testing.assert_array_equal(both["X"], np.tile([3.0, 0, 0, 2.0, 0, 0], (3, 1)))


def middle_of(recording, row):
    """The samples in the middle half of the way to a row."""
    at = np.flatnonzero(recording.row == row)
    return slice(int(at[len(at) // 4]), int(at[3 * len(at) // 4]))


def test_lost_motion_stays_half_a_width_behind():
    off, recording = moved_um(drives.Backlash("X", 8.0))
    there, back = (off[middle_of(recording, row), 0] for row in (1, 2))
    np.testing.assert_allclose(there, -4.0, atol=1e-6)
    np.testing.assert_allclose(back, 4.0, atol=1e-6)
    # What crosses the play first is the first hundredths of a second of the motion.
    np.testing.assert_allclose(off[middle_of(recording, 3), 0], 4.0, atol=1e-6)
    assert np.abs(off[:, 1:]).max() < 1e-6


def test_play_has_a_memory_and_does_not_depend_on_when_it_is_asked():
    begin, end = THERE_AND_BACK.position[[0, -1]]
    timeline = make_program_timeline(THERE_AND_BACK, begin, 0.0, profile.Limits())
    motion = Motion(MACHINE, timeline)
    time_s = np.linspace(0.0, timeline.end_s + 1.0, 40_001)
    table = motion.play_mm("X", 0.5, time_s)
    stepped, state = np.empty(len(time_s)), 50.0
    for k, screw in enumerate(motion.position_mm("X", time_s)):
        state = min(max(state, screw - 0.5), screw + 0.5)
        stepped[k] = state
    np.testing.assert_allclose(table, stepped, atol=1e-9)
    some = np.sort(np.random.default_rng(1).choice(len(time_s), 50))
    np.testing.assert_array_equal(motion.play_mm("X", 0.5, time_s[some]), table[some])
    later = timeline.end_s + 5.0
    way = make_program_timeline(program([(150, 200, 90)]), end, later, profile.Limits())
    new = timeline.since(later).cut(later).then(way)
    time_s = np.linspace(later, later + 1.0, 50)
    forgot, knows = (Motion(MACHINE, m) for m in (new, continue_from(timeline, new)))
    assert forgot.play_mm("X", 0.5, time_s)[-1] == pytest.approx(150.0)
    assert knows.play_mm("X", 0.5, time_s)[-1] == pytest.approx(149.5)
    assert knows.since_reversal_mm("X", time_s)[0][-1] == pytest.approx(100.0)
    z_mm = (one.position_mm("Z", time_s) for one in (knows, forgot))
    np.testing.assert_allclose(*z_mm)


def test_a_carriage_leans_to_the_side_it_comes_from_and_about_an_axis_by_the_arm():
    off, recording = moved_um(drives.LateralBacklash("X", "EYX", 3.0))
    np.testing.assert_allclose(off[middle_of(recording, 1), 1], 3.0, atol=1e-6)
    np.testing.assert_allclose(off[middle_of(recording, 2), 1], -3.0, atol=1e-6)
    off, recording = moved_um(drives.LateralBacklash("X", "EAX", 10.0))
    _, y, z = MACHINE.reflector().offset_mm
    there = middle_of(recording, 1)
    arm = np.array([0.0, -(50.0 + z), 50.0 + y])  # w-X-b-Y-Z-t: Y and Z are beyond X
    np.testing.assert_allclose(off[there].mean(axis=0), 10e-3 * arm, atol=1e-4)


SINE = drives.ScrewCyclic("X", 10.0, 3.0, 0.5)
GROWTH = structure.ThermalGrowth("X", 10.0, 2.0, 10.0, 5.0)
SAG = structure.ElasticSag("X", "Y", "Z", 12.0)
LAWS = [  # of position in mm and time in s
    (SINE, 0, lambda x, y, t: 3.0 * np.sin(0.2 * np.pi * x + 0.5)),
    (GROWTH, 0, lambda x, y, t: -0.02 * np.expm1(-t / 10.0) * x),
    (setup.TableDrift((0.1, 0.0, 0.0)), 0, lambda x, y, t: 0.1 * t),
    (setup.TableDrift((0.0, 0.0, -0.2)), 2, lambda x, y, t: -0.2 * t),
    (setup.SetupStep(4.0, (0.0, 2.0, 0.0)), 1, lambda x, y, t: 2.0 * (t >= 4.0)),
    (structure.SpindleGrowth(10.0, 5.0), 2, lambda x, y, t: -10.0 * np.expm1(-t / 5.0)),
    (SAG, 2, lambda x, y, t: -48.0 * x * (500.0 - x) / 500.0**2 * y / 400.0),
    (structure.Squareness("C0Y", 50.0), 0, lambda x, y, t: -50e-3 * y),
]


@pytest.mark.parametrize(("effect", "axis", "law"), LAWS)
def test_a_hidden_effect_moves_the_target_by_its_law(effect, axis, law):
    off, recording = moved_um(effect)
    x, y, _ = recording.commanded_mm.T
    expected = law(x, y, CLOCK.true_s(recording.time_s))
    is_turn = isinstance(effect, structure.Squareness)  # which is exact to second order
    np.testing.assert_allclose(off[:, axis], expected, atol=1e-5 if is_turn else 2e-9)
    assert np.abs(np.delete(off, axis, 1)).max() < (1e-3 if is_turn else 1e-9)


def test_a_vibration_keeps_its_frequency_on_the_trackers_clock():
    off, recording = moved_um(drives.Vibration("Y", 12.5, 2.0))
    time_s = recording.time_s - recording.time_s[0]
    share = np.exp(-2j * np.pi * 12.5 * time_s) @ off[:, 1] / len(time_s)
    assert 2.0 * abs(share) == pytest.approx(2.0, rel=0.01)


def test_the_sensor_of_a_scale_that_warms_lags():
    _, recording = moved_um(GROWTH)
    told = recording.temperatures
    assert told is not None
    rise = told.celsius[:, 0] - 20.0
    np.testing.assert_allclose(told.celsius[:, 1:], 20.0, atol=0.1)
    steps = np.linspace(0.0, 20.0, 20_001)
    scale = -2.0 * np.expm1(-steps / 10.0)
    sensor = np.zeros(len(steps))
    for k in range(1, len(steps)):
        sensor[k] = sensor[k - 1] + 1e-3 / 5.0 * (scale[k - 1] - sensor[k - 1])
    at = CLOCK.true_s(told.time_s)
    assert np.abs(rise - np.interp(at, steps, sensor))[at < 20.0].max() < 0.1


def test_a_slow_servo_lags_by_its_speed_in_ramps_too():
    effect = drives.ServoMismatch("X", 1.0)
    off, recording = moved_um(effect)
    np.testing.assert_allclose(off[middle_of(recording, 1), 0], -100.0, atol=1e-3)
    np.testing.assert_allclose(off[middle_of(recording, 2), 0], 100.0, atol=1e-3)
    motion = Motion(MACHINE, recording.timeline)
    time_s = np.arange(0.9, 4.5, 5e-5)
    command = motion.position_mm("X", time_s)
    servo = np.empty(len(time_s))
    servo[0] = command[0]
    for k in range(1, len(time_s)):
        mean = 0.5 * (command[k] + command[k - 1])
        servo[k] = mean + (servo[k - 1] - mean) * np.exp(-5e-5 / 1e-3)
    found = effect.added_error_motions(motion, time_s)["X"][:, 0]
    np.testing.assert_allclose(found, servo - command, atol=5e-5)


def test_a_spike_fades_with_the_travel_since_the_reversal():
    off, recording = moved_um(drives.ReversalSpike("X", "Z", 5.0, 20.0))
    assert np.abs(off[recording.row <= 1]).max() < 1e-9
    back = recording.row == 2
    gone = 250.0 - recording.commanded_mm[back, 0]
    moving = gone > 0.0
    expected = -5.0 * np.exp(-gone / 20.0)
    np.testing.assert_allclose(off[back, 2][moving], expected[moving], atol=1e-6)


def test_the_tracker_misreads_what_its_circles_and_home_distance_say():
    off, recording = moved_um(setup.TrackerRangeOffset(30.0))
    distance = np.linalg.norm(recording.position_mm, axis=1)
    beam = recording.position_mm @ recording.pose.rotation.T / distance[:, None]
    np.testing.assert_allclose(off, 30.0 * beam, atol=0.01)
    off, _ = moved_um(setup.RangeCycle(20.0, 3.0, 0.4))
    wave = 3.0 * np.sin(2.0 * np.pi * (distance - 0.03) / 20.0 + 0.4)
    np.testing.assert_allclose(off, wave[:, None] * beam, atol=0.01)
    off, recording = moved_um(setup.TrackerEccentricity("azimuth", 20.0, 0.3))
    x, y, _ = recording.position_mm.T
    turn = 20e-6 * np.sin(np.arctan2(y, x) + 0.3)
    expected, found = 1e3 * turn * np.hypot(x, y), np.linalg.norm(off, axis=1)
    np.testing.assert_allclose(found, np.abs(expected), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("name", named.EFFECTS)
def test_every_effect_is_drawn_alike_by_its_seed_and_travels_as_text(name):
    occasion = Occasion(MACHINE, 3.0, 60.0, FEED_MM_S, 700.0)
    effect = named.draw(name, 4, occasion)
    assert named.draw(name, 4, occasion) == effect
    assert named.from_json(json.loads(json.dumps(named.as_json(effect)))) == effect
    assert any(named.draw(name, seed, occasion) != effect for seed in range(5, 9))
    truth = effect.truth(CLOCK)
    assert truth["name"] == name
    assert all("value" in entry for entry in truth["parameters"].values())
    off, _ = moved_um(effect, is_long=True)
    off -= off.mean(axis=0)
    assert 0.3 < np.linalg.norm(off, axis=1).max() < 40.0


def test_an_effect_is_given_by_name_and_size_or_by_its_numbers():
    twice = named.parse_hidden("backlash*2", 1, MACHINE)
    assert twice.parameters(CLOCK) == {"width_um": 4.0}
    text = json.dumps(named.as_json(drives.ServoMismatch("X", 0.06)))
    assert named.parse_hidden(text, 1, MACHINE) == drives.ServoMismatch("X", 0.06)
    knock = setup.SetupStep(4.0, (3.0, 2.0, 1.0))
    assert knock.truth(CLOCK)["parameters"]["t_s"]["value"] == 104.0
    step = '{"name": "setup-step", "time_s": 3, "step_um": [1, 2, 3]}'
    assert named.parse_hidden(step, 1, MACHINE) == setup.SetupStep(3.0, (1.0, 2.0, 3.0))
    assert len(named.CATALOGUED) == 14
    assert "squareness" not in named.CATALOGUED  # every fitted model has it


def named_json(name, axis="X", **numbers):
    return json.dumps({"name": name, "axis": axis, **numbers})


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("backlsh", "backlsh"),
        ("backlash*big", "size_um"),
        ('{"name": "backlash", "depth": 3}', "depth"),
        ('{"name": "backlash"', "not JSON"),
        (named_json("backlash", "Q", width_um=8), "demo cannot have it"),
        (named_json("backlash", width_um="big"), "big"),
        ('{"name": "squareness", "symbol": "D0Y", "value_urad": 8}', "D0Y"),
        (named_json("lateral-backlash", motion="EYC", half_width=5), "no axis C"),
    ],
)
def test_an_effect_that_the_machine_cannot_have_is_refused(text, names):
    with pytest.raises(SimulatorError, match=names):
        named.parse_hidden(text, 1, MACHINE)


OTHERS = """
from dataclasses import dataclass

from truepath_simulators.hidden.effect import HiddenEffect


@dataclass(frozen=True, slots=True)
class Leaning(HiddenEffect):
    name = "leaning-wall"
    in_catalogue = False
    width_um: float = 2.0

    @classmethod
    def draw(cls, rng, occasion):
        return cls(occasion.size_um)
"""


def test_an_effect_of_another_distribution_can_be_hidden(tmp_path, monkeypatch):
    points = {"hidden_effects": {"leaning-wall": "other_effects:Leaning"}}
    site = install(tmp_path / "site", points, other_effects=OTHERS)
    monkeypatch.syspath_prepend(site)
    hidden = named.parse_hidden("leaning-wall*3", 1, MACHINE)
    assert named.as_json(hidden) == {"name": "leaning-wall", "width_um": 3.0}
    assert named.from_json(named.as_json(hidden)) == hidden
    assert named.list_names()[-1] == "leaning-wall"
    assert "leaning-wall" in make_parser().format_help()


def test_a_bench_tells_what_was_hidden():
    bench = Bench(seed=5, hidden=(drives.Backlash("Y", 6.0), "table-drift*3"))
    names = [e["name"] for e in bench.hidden_truth()]
    assert names == ["backlash", "table-drift"]
    assert bench.hidden[1] == named.parse_hidden("table-drift*3", 5, MACHINE)
    wrong = {"hidden": (["poltergeist"], "poltergeist"), "speed": (0.0, "speed")}
    for option, (value, said) in wrong.items():
        with pytest.raises(SimulatorError, match=said):
            Bench(**{option: value})


def recorded(seed=4, rows=8, **setting):
    program = paths.chord_path(MACHINE, seed, rows, 5000.0)
    return synthetic.record(
        CONTENT, program, seed, setting=synthetic.Setting(**setting)
    )


@pytest.fixture(scope="module")
def clean():
    return recorded()


def draw_noise(**air):
    return tracker_head.SampleNoise(1, 500.0, tracker_head.Air(**air))


def test_noise_has_the_stated_size_and_part_of_it_is_correlated_in_time(rng):
    point = rng.normal(0.0, 900.0, 3)
    noise = rng.standard_normal((20_000, 3))
    places = np.tile(point, (20_000, 1))
    polar = tracker_head.measure_polar(places, noise, MACHINE.tracker)
    r = float(np.linalg.norm(point))
    beam = point / r
    off = tracker_head.to_cartesian(polar) - point
    along = off @ beam
    across = off - np.outer(along, beam)
    assert along.std() == pytest.approx(1e-3 * 1.0 + 1e-6 * 0.3 * r, rel=0.02)
    stated = np.hypot(3e-6 * r, 4e-3)
    assert np.sqrt((across**2).sum(1).mean() / 2) == pytest.approx(stated, rel=0.02)
    noise = draw_noise(share=0.5, tau_s=0.2).draw(400_000)
    assert noise.std() == pytest.approx(1.0, rel=0.02)
    for lag_s in (0.02, 0.2, 0.4):
        lag = int(500 * lag_s)
        shared = np.mean(noise[lag:] * noise[:-lag])
        assert shared == pytest.approx(0.25 * np.exp(-lag_s / 0.2), abs=0.02)
    whole, parts = draw_noise().draw(3000), draw_noise()
    cuts = rng.multinomial(3000, np.full(40, 1 / 40))
    drawn = np.vstack([parts.draw(int(n)) for n in cuts])
    np.testing.assert_allclose(drawn, whole, atol=1e-12)


def test_the_tracker_stands_outside_the_travel():
    for seed in range(50):
        pose = tracker_head.random_pose(MACHINE, seed)
        spot = pose.position_mm - MACHINE.reflector().offset_mm
        beside = (spot < MACHINE.low_mm - 50.0) | (spot > MACHINE.high_mm + 50.0)
        assert beside[:2].any()
        turned = pose.rotation @ pose.rotation.T
        np.testing.assert_allclose(turned, np.eye(3), atol=1e-12)


def test_a_seed_says_the_whole_recording_and_a_clock_of_its_own(clean):
    again, other = recorded(seed=4), recorded(seed=5)
    np.testing.assert_array_equal(clean.position_mm, again.position_mm)
    np.testing.assert_array_equal(clean.time_s, again.time_s)
    assert clean.time_s[0] != other.time_s[0]
    clock = tracker_head.random_clock(3)
    assert clock.true_s(np.array([clock.device_s(12.5)]))[0] == pytest.approx(12.5)
    assert 0.0 < abs(clock.drift) <= 2e-5


def test_the_stream_is_the_truth_seen_from_before_the_motion_to_after_it():
    recording = recorded(noise_scale=0.0)
    pose = recording.pose
    table_mm = recording.position_mm @ pose.rotation.T + pose.position_mm
    nominal = recording.commanded_mm + recording.truth.machine.reflector().offset_mm
    deviation = recording.truth.deviation_mm(recording.commanded_mm)
    np.testing.assert_allclose(table_mm, nominal + deviation, atol=1e-8)
    assert np.abs(deviation).max() > 5e-3
    recording = recorded(lead_in_s=1.5, lead_out_s=2.0)
    moving = np.linalg.norm(np.diff(recording.commanded_mm, axis=0), axis=1) > 0
    first, last = np.flatnonzero(moving)[[0, -1]]
    # The first row is where the machine stands: its dwell comes first.
    assert recording.time_s[first] - recording.time_s[0] == pytest.approx(1.9, abs=0.01)
    assert recording.time_s[-1] - recording.time_s[last] == pytest.approx(2.4, abs=0.01)
    np.testing.assert_allclose(np.diff(recording.time_s), 0.002, atol=1.1e-6)
    assert not recording.status.any()
    assert np.all(np.diff(recording.row) >= 0)
    assert set(recording.row) == set(range(8))


def test_lost_and_doubled_frames_silence_and_a_late_start_are_in_the_times(clean):
    holey = recorded(defects=synthetic.Defects(dropped_share=0.05))
    assert 0.03 < 1.0 - len(holey) / len(clean) < 0.07
    steps = np.diff(holey.time_s) / 0.002
    np.testing.assert_allclose(steps, np.round(steps), atol=2e-3)
    assert steps.max() > 1.5
    doubled = recorded(defects=synthetic.Defects(duplicated_share=0.02))
    again = np.flatnonzero(np.diff(doubled.time_s) == 0.0)
    assert len(again) > 50
    place = doubled.position_mm
    np.testing.assert_array_equal(place[again], place[again + 1])
    silent = recorded(defects=synthetic.Defects(gaps=((5.0, 2.0),)))
    assert np.diff(silent.time_s).max() == pytest.approx(2.002, abs=0.003)
    late = recorded(defects=synthetic.Defects(late_start_s=4.0))
    assert late.row[0] > 0 or np.any(np.diff(late.commanded_mm[:5], axis=0))


def test_a_broken_beam_is_told_spikes_are_valid_and_a_hold_stands_in_mid_line(clean):
    broken = recorded(defects=synthetic.Defects(beam_breaks=((3.0, 0.5),)))
    assert abs(np.count_nonzero(broken.status) - 250) <= 1
    spiky = recorded(defects=synthetic.Defects(spikes=7, spike_mm=0.8))
    off = np.linalg.norm(spiky.position_mm - clean.position_mm, axis=1)
    assert np.count_nonzero(off > 1e-9) == 7
    np.testing.assert_allclose(off[off > 1e-9], 0.8)
    assert not spiky.status.any()
    recording = recorded(defects=synthetic.Defects(holds=((4.0, 3.0),)))
    assert len(recording) - len(clean) == pytest.approx(3.0 * 500, rel=0.1)
    still = np.linalg.norm(np.diff(recording.commanded_mm, axis=0), axis=1) == 0.0
    t = recording.time_s[1:] - recording.time_s[0]
    assert still[(t > 4.3) & (t < 6.9)].all()
    np.testing.assert_allclose(recording.commanded_mm[-1], clean.commanded_mm[-1])


@pytest.mark.parametrize("csv", [False, True])
def test_a_bundle_is_read_by_the_service_and_the_truth_lies_beside_it(tmp_path, csv):
    recording = recorded(rows=4)
    write_bundle_files(tmp_path / "run", recording, csv=csv)
    run = read_bundle(tmp_path / "run")
    assert run.mode == "otf"
    np.testing.assert_allclose(run.commanded.position, recording.program.position)
    place = recording.position_mm
    np.testing.assert_allclose(run.tracker.position_mm, place, atol=1e-6)
    assert run.temperature is not None
    truth = json.loads((tmp_path / "run" / "truth.json").read_text())
    error_um = 1e3 * recording.truth.deviation_mm(np.array(truth["points_mm"]))
    np.testing.assert_allclose(truth["deviation_um"], error_um, atol=1e-3)
    program = paths.standstill_points(MACHINE, 1, random=3, dwell_s=0.5)
    standing = synthetic.record(CONTENT, program, 1, "standstill")
    write_bundle_files(tmp_path / "standing", standing, csv=csv)
    run = read_bundle(tmp_path / "standing")
    assert (run.mode, len(run.commanded)) == ("standstill", 11)


def test_corners_are_all_joined_and_chords_are_lines_in_the_travel():
    corners = [tuple(p) for p in paths.corner_path(MACHINE, 5000.0).position]
    lines = {frozenset(pair) for pair in itertools.pairwise(corners)}
    assert (len({c for line in lines for c in line}), len(lines)) == (8, 28)
    position = paths.chord_path(MACHINE, 2, 200, 5000.0).position
    assert np.all(position >= MACHINE.low_mm)
    assert np.all(position <= MACHINE.high_mm)
    assert np.linalg.norm(np.diff(position, axis=0), axis=1).min() > 1.0


def test_the_command_writes_a_bundle_and_names_what_is_absent(tmp_path, capsys):
    out = tmp_path / "run"
    options = ["--rows", "3", "--rough", "--csv", "--seed", "2"]
    hidden = ["--hide", "backlash*3", "--hide", "table-drift"]
    assert synthetic.main([str(out), *options, *hidden]) == 0
    assert "samples" in capsys.readouterr().err
    effects = json.loads((out / "truth.json").read_text())["effects"]
    assert [e["name"] for e in effects] == ["backlash", "table-drift"]
    assert effects[0]["parameters"]["width_um"]["value"] == 6.0
    assert synthetic.main([str(out), "--hide", "nothing-known"]) == 2
    files = {"machine.json", "path.csv", "tracker.csv", "environment.csv", "truth.json"}
    assert {p.name for p in out.iterdir()} == files
    assert synthetic.main([str(tmp_path), "--machine", "nowhere.json"]) == 2
    assert "nowhere.json" in capsys.readouterr().err
