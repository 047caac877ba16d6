import itertools
import json

import numpy as np
import pytest

from truepath.files.bundle.bundle import read_bundle
from truepath_simulators import machine_file
from truepath_simulators.machine import tracker_head
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import write_bundle_files
from truepath_simulators.worlds.synthetic import Defects, Setting, record

CONTENT = machine_file.load_machine("demo")
MACHINE = machine_file.parse_machine(CONTENT)


def recorded(seed=4, rows=8, **setting):
    program = paths.chord_path(MACHINE, seed, rows, 5000.0)
    return record(CONTENT, program, seed, setting=Setting(**setting))


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
    holey = recorded(defects=Defects(dropped_share=0.05))
    assert 0.03 < 1.0 - len(holey) / len(clean) < 0.07
    steps = np.diff(holey.time_s) / 0.002
    np.testing.assert_allclose(steps, np.round(steps), atol=2e-3)
    assert steps.max() > 1.5
    doubled = recorded(defects=Defects(duplicated_share=0.02))
    again = np.flatnonzero(np.diff(doubled.time_s) == 0.0)
    assert len(again) > 50
    place = doubled.position_mm
    np.testing.assert_array_equal(place[again], place[again + 1])
    silent = recorded(defects=Defects(gaps=((5.0, 2.0),)))
    assert np.diff(silent.time_s).max() == pytest.approx(2.002, abs=0.003)
    late = recorded(defects=Defects(late_start_s=4.0))
    assert late.row[0] > 0 or np.any(np.diff(late.commanded_mm[:5], axis=0))


def test_a_broken_beam_is_told_spikes_are_valid_and_a_hold_stands_in_mid_line(clean):
    broken = recorded(defects=Defects(beam_breaks=((3.0, 0.5),)))
    assert abs(np.count_nonzero(broken.status) - 250) <= 1
    spiky = recorded(defects=Defects(spikes=7, spike_mm=0.8))
    off = np.linalg.norm(spiky.position_mm - clean.position_mm, axis=1)
    assert np.count_nonzero(off > 1e-9) == 7
    np.testing.assert_allclose(off[off > 1e-9], 0.8)
    assert not spiky.status.any()
    recording = recorded(defects=Defects(holds=((4.0, 3.0),)))
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
    standing = record(CONTENT, program, 1, "standstill")
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


def test_the_command_writes_a_bundle_and_names_an_absent_machine(tmp_path, capsys):
    out = tmp_path / "run"
    assert synthetic.main([str(out), "--rows", "3", "--rough", "--csv"]) == 0
    assert "samples" in capsys.readouterr().err
    files = {"machine.json", "path.csv", "tracker.csv", "environment.csv", "truth.json"}
    assert {p.name for p in out.iterdir()} == files
    assert synthetic.main([str(tmp_path), "--machine", "nowhere.json"]) == 2
    assert "nowhere.json" in capsys.readouterr().err
