"""Machines that err by a millimetre and 2 mrad: lines are where they were driven."""

from dataclasses import replace

import numpy as np

from truepath.alignment.align import align
from truepath_simulators.worlds.synthetic import Setting

FAR_OFF = Setting(error_scale=40.0)


def test_all_lines_of_a_machine_that_is_far_off_are_used_whole(record):
    run, truth = record(5, setting=FAR_OFF)
    position = truth.recording.commanded_mm
    assert np.abs(truth.deviation_mm(position[::500])).max() > 1.0
    seen = align(run)
    assert seen.measured_rows == set(range(1, len(run.commanded)))
    assert "off-line" not in {each.cause for each in seen.left_out}


def test_a_machine_that_errs_by_millimetres_is_recognised(record):
    run, _ = record(5, setting=Setting(error_scale=80.0))
    assert align(run).measured_rows == set(range(1, len(run.commanded)))


def test_a_stream_that_loses_its_frame_half_way_is_said_to_be_astray(record):
    run, _ = record(6)
    position = run.tracker.position_mm.copy()
    half = 6 * len(position) // 10
    position[half:, 1] *= -1.0
    seen = align(replace(run, tracker=replace(run.tracker, position_mm=position)))
    astray = [each for each in seen.left_out if each.cause == "astray"]
    assert len(astray) == 1
    assert astray[0].begin_s > run.tracker.device_time_s[half]
    assert astray[0].samples > 0.5 * half
    assert astray[0].off_mm > 10.0
