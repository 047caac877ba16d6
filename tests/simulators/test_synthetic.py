from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truepath.files.bundle.bundle import read_bundle
from truepath_simulators.hidden.setup import SetupStep
from truepath_simulators.machine.tracker_head import (
    Air,
    SampleNoise,
    measure_polar,
    random_clock,
    random_pose,
    to_cartesian,
    to_spherical,
)
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.bundle_files import write_bundle_files
from truepath_simulators.worlds.recording import Recording
from truepath_simulators.worlds.synthetic import Defects, Setting, record

Recorder = Callable[..., Recording]


@pytest.fixture
def recorded(demo: dict[str, Any], machine: MachineFile) -> Recorder:
    def recorder(seed: int = 4, rows: int = 8, **setting: Any) -> Recording:
        program = paths.chord_path(machine, seed, rows, 5000.0)
        return record(demo, program, seed, setting=Setting(**setting))

    return recorder


def test_cartesian_and_spherical_are_the_same_place(rng: np.random.Generator) -> None:
    points = rng.normal(0.0, 800.0, (500, 3))
    np.testing.assert_allclose(to_cartesian(to_spherical(points)), points, atol=1e-9)


def test_noise_has_the_stated_size_along_and_across_the_beam(
    machine: MachineFile, rng: np.random.Generator
) -> None:
    point = rng.normal(0.0, 900.0, 3)
    noise = rng.standard_normal((20_000, 3))
    seen = to_cartesian(
        measure_polar(np.tile(point, (20_000, 1)), noise, machine.tracker)
    )
    r = float(np.linalg.norm(point))
    beam = point / r
    off = seen - point
    along = off @ beam
    across = off - np.outer(along, beam)
    assert along.std() == pytest.approx(1e-3 * 1.0 + 1e-6 * 0.3 * r, rel=0.02)
    stated = np.hypot(3e-6 * r, 4e-3)
    assert np.sqrt((across**2).sum(1).mean() / 2) == pytest.approx(stated, rel=0.02)


def test_part_of_the_noise_is_correlated_in_time() -> None:
    noise = SampleNoise(1, 500.0, Air(share=0.5, tau_s=0.2)).draw(400_000)
    assert noise.std() == pytest.approx(1.0, rel=0.02)
    for lag_s in (0.02, 0.2, 0.4):
        lag = int(500 * lag_s)
        shared = np.mean(noise[lag:] * noise[:-lag])
        assert shared == pytest.approx(0.25 * np.exp(-lag_s / 0.2), abs=0.02)


def test_noise_does_not_depend_on_how_it_is_drawn(rng: np.random.Generator) -> None:
    whole = SampleNoise(1, 500.0, Air()).draw(3000)
    parts = SampleNoise(1, 500.0, Air())
    cuts = rng.multinomial(3000, np.full(40, 1 / 40))
    np.testing.assert_allclose(
        np.vstack([parts.draw(int(n)) for n in cuts]), whole, atol=1e-12
    )


def test_the_tracker_stands_outside_the_travel(machine: MachineFile) -> None:
    for seed in range(50):
        pose = random_pose(machine, seed)
        spot = pose.position_mm - machine.reflector().offset_mm
        beside = (spot < machine.low_mm - 50.0) | (spot > machine.high_mm + 50.0)
        assert beside[:2].any()
        np.testing.assert_allclose(
            pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12
        )


def test_a_device_clock_knows_its_own_times() -> None:
    clock = random_clock(3)
    assert clock.true_s(np.array([clock.device_s(12.5)]))[0] == pytest.approx(12.5)
    assert 0.0 < abs(clock.drift) <= 2e-5


def test_a_seed_says_the_whole_recording(recorded: Recorder) -> None:
    first, again, other = recorded(seed=4), recorded(seed=4), recorded(seed=5)
    np.testing.assert_array_equal(first.position_mm, again.position_mm)
    np.testing.assert_array_equal(first.time_s, again.time_s)
    assert first.time_s[0] != other.time_s[0]


def test_the_stream_is_the_truth_seen_from_the_tracker(recorded: Recorder) -> None:
    recording = recorded(noise_scale=0.0)
    table_mm = (
        recording.position_mm @ recording.pose.rotation.T + recording.pose.position_mm
    )
    nominal = recording.commanded_mm + recording.truth.machine.reflector().offset_mm
    deviation = recording.truth.deviation_mm(recording.commanded_mm)
    np.testing.assert_allclose(table_mm, nominal + deviation, atol=1e-8)
    assert np.abs(deviation).max() > 5e-3


def test_the_stream_begins_before_the_motion_and_ends_after(recorded: Recorder) -> None:
    recording = recorded(lead_in_s=1.5, lead_out_s=2.0)
    moving = np.linalg.norm(np.diff(recording.commanded_mm, axis=0), axis=1) > 0
    first, last = np.flatnonzero(moving)[[0, -1]]
    # The first row is where the machine stands: its dwell comes first.
    assert recording.time_s[first] - recording.time_s[0] == pytest.approx(1.9, abs=0.01)
    assert recording.time_s[-1] - recording.time_s[last] == pytest.approx(2.4, abs=0.01)
    np.testing.assert_allclose(np.diff(recording.time_s), 0.002, atol=1.1e-6)
    assert not recording.status.any()


def test_rows_follow_the_path(recorded: Recorder) -> None:
    recording = recorded(rows=8)
    assert np.all(np.diff(recording.row) >= 0)
    assert set(recording.row) == set(range(8))


def test_lost_frames_leave_steps_in_time(recorded: Recorder) -> None:
    whole, holey = recorded(), recorded(defects=Defects(dropped_share=0.05))
    assert 0.03 < 1.0 - len(holey) / len(whole) < 0.07
    steps = np.diff(holey.time_s) / 0.002
    np.testing.assert_allclose(steps, np.round(steps), atol=2e-3)
    assert steps.max() > 1.5


def test_silence_leaves_a_gap(recorded: Recorder) -> None:
    recording = recorded(defects=Defects(gaps=((5.0, 2.0),)))
    assert np.diff(recording.time_s).max() == pytest.approx(2.002, abs=0.003)


def test_a_broken_beam_is_told_by_the_status(recorded: Recorder) -> None:
    recording = recorded(defects=Defects(beam_breaks=((3.0, 0.5),)))
    assert abs(np.count_nonzero(recording.status) - 250) <= 1


def test_spikes_are_valid_samples_far_off(recorded: Recorder) -> None:
    clean = recorded()
    spiky = recorded(defects=Defects(spikes=7, spike_mm=0.8))
    off = np.linalg.norm(spiky.position_mm - clean.position_mm, axis=1)
    assert np.count_nonzero(off > 1e-9) == 7
    np.testing.assert_allclose(off[off > 1e-9], 0.8)
    assert not spiky.status.any()


def test_duplicated_frames_repeat_time_and_place(recorded: Recorder) -> None:
    recording = recorded(defects=Defects(duplicated_share=0.02))
    twice = np.diff(recording.time_s) == 0.0
    assert twice.sum() > 50
    again = np.flatnonzero(twice)
    np.testing.assert_array_equal(
        recording.position_mm[again], recording.position_mm[again + 1]
    )


def test_a_late_start_misses_the_first_motion(recorded: Recorder) -> None:
    recording = recorded(defects=Defects(late_start_s=4.0))
    assert recording.row[0] > 0 or np.any(np.diff(recording.commanded_mm[:5], axis=0))


def test_a_hold_stands_in_mid_line(recorded: Recorder) -> None:
    recording = recorded(defects=Defects(holds=((4.0, 3.0),)))
    free = recorded()
    assert len(recording) - len(free) == pytest.approx(3.0 * 500, rel=0.1)
    still = np.linalg.norm(np.diff(recording.commanded_mm, axis=0), axis=1) == 0.0
    t = recording.time_s[1:] - recording.time_s[0]
    assert still[(t > 4.3) & (t < 6.9)].all()
    np.testing.assert_allclose(recording.commanded_mm[-1], free.commanded_mm[-1])


def test_a_knock_moves_everything_after_it(recorded: Recorder) -> None:
    clean = recorded()
    knocked = recorded(hidden=(SetupStep(6.0, (50.0, 0.0, 0.0)),))
    off = np.linalg.norm(knocked.position_mm - clean.position_mm, axis=1)
    t = clean.time_s - clean.time_s[0]
    assert off[t < 5.9].max() < 1e-9
    np.testing.assert_allclose(off[t > 6.1], 0.05, atol=5e-4)


@pytest.mark.parametrize("csv", [False, True])
def test_an_on_the_fly_bundle_is_read_by_the_service(
    recorded: Recorder, tmp_path: Path, csv: bool
) -> None:
    recording = recorded(rows=4)
    write_bundle_files(tmp_path / "run", recording, csv=csv)
    run = read_bundle(tmp_path / "run")
    assert run.mode == "otf"
    np.testing.assert_allclose(run.commanded.position, recording.program.position)
    np.testing.assert_allclose(
        run.tracker.position_mm, recording.position_mm, atol=1e-6
    )
    assert run.temperature is not None


def test_a_standstill_bundle_is_read_by_the_service(
    demo: dict[str, Any], machine: MachineFile, tmp_path: Path
) -> None:
    program = paths.standstill_points(machine, 1, random=3, dwell_s=0.5)
    recording = record(demo, program, 1, "standstill")
    write_bundle_files(tmp_path / "run", recording)
    run = read_bundle(tmp_path / "run")
    assert run.mode == "standstill"
    assert len(run.commanded) == 11


def test_the_truth_lies_beside_the_bundle(recorded: Recorder, tmp_path: Path) -> None:
    recording = recorded(rows=3)
    write_bundle_files(tmp_path / "run", recording)
    truth = json.loads((tmp_path / "run" / "truth.json").read_text())
    points = np.array(truth["points_mm"])
    np.testing.assert_allclose(
        truth["deviation_um"], 1e3 * recording.truth.deviation_mm(points), atol=1e-3
    )


def test_a_corner_path_has_every_line_between_corners(machine: MachineFile) -> None:
    program = paths.corner_path(machine, 5000.0)
    corners = [tuple(p) for p in program.position]
    lines = {frozenset(pair) for pair in itertools.pairwise(corners)}
    assert len({c for line in lines for c in line}) == 8
    assert len(lines) == 28


def test_chords_stay_in_the_travel_and_are_lines(machine: MachineFile) -> None:
    position = paths.chord_path(machine, 2, 200, 5000.0).position
    assert np.all(position >= machine.low_mm)
    assert np.all(position <= machine.high_mm)
    assert np.linalg.norm(np.diff(position, axis=0), axis=1).min() > 1.0


def test_the_command_writes_a_bundle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert synthetic.main([str(out), "--rows", "3", "--rough", "--csv"]) == 0
    assert "samples" in capsys.readouterr().err
    assert {p.name for p in out.iterdir()} == {
        "machine.json",
        "path.csv",
        "tracker.csv",
        "environment.csv",
        "truth.json",
    }


def test_the_command_names_a_machine_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert synthetic.main([str(tmp_path), "--machine", "nowhere.json"]) == 2
    assert "nowhere.json" in capsys.readouterr().err
