"""Whole recordings without wire and without waiting, as a bench would record them.

Motion, truth, noise and clock are those of the simulators, evaluated at once.

    python -m truepath_simulators.worlds.synthetic OUT --seed 3 --mode otf --feed 2500
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden.effect import (
    HiddenEffect,
    apply_reading_errors,
    locate_target_mm,
)
from truepath_simulators.hidden.effects_by_name import parse_hidden
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine import tracker_head
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import (
    Air,
    TrackerBody,
    TrackerClock,
    TrackerPose,
)
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import MachineFile, load_machine, parse_machine
from truepath_simulators.motion import paths, planner
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.randomness import generator
from truepath_simulators.timeline import Timeline
from truepath_simulators.worlds.recording import (
    Recording,
    Temperatures,
    write_bundle_files,
)

BEAM_BROKEN = 1


@dataclass(frozen=True, slots=True)
class Defects:
    """Defects of a recording.

    dropped_share : share of the frames that are missing, one by one
    gaps : (begin_s, duration_s) of silence, since the begin of the stream
    beam_breaks : (begin_s, duration_s) in which samples are there but not valid; after
        each, a tracker with a specification has another range offset
    spikes, spike_mm : number of valid samples, and their error
    duplicated_share : share of the frames that come twice, as no good driver lets them
    late_start_s : delay of the stream's begin after the motion
    holds : (begin_s, duration_s) of feed holds, wherever the machine is then
    """

    dropped_share: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    beam_breaks: tuple[tuple[float, float], ...] = ()
    spikes: int = 0
    spike_mm: float = 0.5
    duplicated_share: float = 0.0
    late_start_s: float = 0.0
    holds: tuple[tuple[float, float], ...] = ()


ROUGH = Defects(
    dropped_share=0.002,
    gaps=((20.0, 3.0),),
    beam_breaks=((35.0, 1.5),),
    spikes=20,
    holds=((12.0, 2.0),),
)


@dataclass(frozen=True, slots=True)
class Setting:
    """Settings of a recording, in addition to machine, program and seed.

    machine_seed : which machine, where it is not that of the recording's seed: so that
        several recordings of one machine differ in noise, clock and tracker pose
    truth : the machine, where it is not random
    hidden : effects outside of a rigid-body model
    sensors : whether the scales have temperature sensors
    compensation : tables of the controller
    """

    machine_seed: int | None = None
    rate_hz: float | None = None
    lead_in_s: float = 1.0
    lead_out_s: float = 1.0
    error_scale: float = 1.0
    limits: Limits = field(default_factory=Limits)
    air: Air = field(default_factory=Air)
    noise_scale: float = 1.0
    pose: TrackerPose | None = None
    clock: TrackerClock | None = None
    defects: Defects = field(default_factory=Defects)
    truth: TruthMachine | None = None
    hidden: tuple[HiddenEffect, ...] = ()
    sensors: bool = True
    compensation: LoadedTables = field(default_factory=LoadedTables)


def record(
    content: Mapping[str, Any],
    program: Program,
    seed: int,
    mode: str = "otf",
    setting: Setting | None = None,
) -> Recording:
    """Run a program on a random machine and record it.

    content : the content of machine.json; mode : `otf` or `standstill`, for the files
    """
    setting = setting or Setting()
    machine = parse_machine(content)
    which = seed if setting.machine_seed is None else setting.machine_seed
    truth = setting.truth or random_machine(machine, which, scale=setting.error_scale)
    pose = setting.pose or tracker_head.random_pose(machine, seed)
    timeline = _motion(program, setting)
    device_s, true_s = _sample_times(machine, timeline, seed, setting)
    clock = _clock(seed, setting)
    row = timeline.rows(true_s)
    table_mm = locate_target_mm(
        truth,
        Motion(machine, timeline, setting.compensation.correct(machine)),
        true_s,
        [program.target[k] for k in row] if program.target else [""] * len(row),
        setting.hidden,
    )
    seen_mm = pose.from_table(table_mm)
    if machine.tracker.specification:
        locks_s = sorted(begin + lasts for begin, lasts in setting.defects.beam_breaks)
        stated = machine.tracker.specification
        body = TrackerBody.draw(stated, which, seed, 1 + len(locks_s))
        seen_mm = body.read(seen_mm, true_s, locks_s, machine.tracker.face)
    stream = _observe(machine, seen_mm, seed, setting)
    status = np.zeros(len(true_s), np.int64)
    for begin, duration in setting.defects.beam_breaks:
        status[_within(true_s, begin, duration)] = BEAM_BROKEN
    keep = _sample_arrivals(true_s, seed, setting.defects)
    return Recording(
        content,
        mode,
        program,
        truth,
        pose,
        device_s[keep],
        _with_spikes(stream, seed, setting.defects)[keep],
        status[keep],
        timeline.positions(true_s[keep]),
        row[keep],
        timeline,
        clock,
        setting.hidden,
        read_sensors(machine, device_s, clock, seed, setting.hidden)
        if setting.sensors
        else None,
    )


def _clock(seed: int, setting: Setting) -> TrackerClock:
    return setting.clock or tracker_head.random_clock(seed)


def _motion(program: Program, setting: Setting) -> Timeline:
    begin = setting.lead_in_s
    timeline = make_program_timeline(
        program, program.position[0], begin, setting.limits
    )
    for time_s, duration_s in setting.defects.holds:
        left = planner.find_rest(timeline, program, time_s)
        timeline = planner.hold_motion(timeline, time_s, setting.limits)
        timeline = planner.resume_motion(
            timeline,
            left,
            max(time_s + duration_s, timeline.end_s),
            setting.limits,
        )
    return timeline


def _sample_times(
    machine: MachineFile, timeline: Timeline, seed: int, setting: Setting
) -> tuple[np.ndarray, np.ndarray]:
    rate_hz = setting.rate_hz or machine.tracker.rate_hz
    clock = _clock(seed, setting)
    begin = setting.defects.late_start_s
    if begin:
        begin += setting.lead_in_s
    count = int((timeline.end_s + setting.lead_out_s - begin) * rate_hz)
    device_s = clock.device_s(begin) + np.arange(count) / rate_hz
    return device_s.round(6), clock.true_s(device_s)


def _observe(
    machine: MachineFile, point_mm: np.ndarray, seed: int, setting: Setting
) -> np.ndarray:
    rate_hz = setting.rate_hz or machine.tracker.rate_hz
    noise = tracker_head.SampleNoise(seed, rate_hz, setting.air).draw(len(point_mm))
    if setting.hidden:
        polar = apply_reading_errors(
            tracker_head.to_spherical(point_mm), setting.hidden
        )
        point_mm = tracker_head.to_cartesian(polar)
    polar = tracker_head.measure_polar(
        point_mm, setting.noise_scale * noise, machine.tracker
    )
    return tracker_head.to_cartesian(polar)


def _with_spikes(stream: np.ndarray, seed: int, defects: Defects) -> np.ndarray:
    rng = generator(seed, "defects: spikes")
    struck = rng.choice(len(stream), min(defects.spikes, len(stream)), replace=False)
    direction = rng.normal(size=(len(struck), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    stream = stream.copy()
    stream[struck] += defects.spike_mm * direction
    return stream


def _sample_arrivals(true_s: np.ndarray, seed: int, defects: Defects) -> np.ndarray:
    rng = generator(seed, "defects: frames")
    arrives = rng.uniform(size=len(true_s)) >= defects.dropped_share
    for begin, duration in defects.gaps:
        arrives &= ~_within(true_s, begin, duration)
    twice = rng.uniform(size=len(true_s)) < defects.duplicated_share
    return np.repeat(np.arange(len(true_s)), np.where(arrives, 1 + twice, 0))


def _within(time_s: np.ndarray, begin_s: float, duration_s: float) -> np.ndarray:
    return (time_s >= begin_s) & (time_s < begin_s + duration_s)


def main(argv: Sequence[str] | None = None) -> int:
    """Write a measurement bundle; exit status 2 on a bad machine file."""
    options = _options().parse_args(argv)
    begin = time.perf_counter()
    try:
        content = load_machine(options.machine)
        machine = parse_machine(content)
        recording = record(
            content,
            _program(machine, options),
            options.seed,
            options.mode,
            Setting(
                machine_seed=options.machine_seed,
                rate_hz=options.rate,
                error_scale=options.error_scale,
                defects=ROUGH if options.rough else Defects(),
                hidden=tuple(
                    parse_hidden(text, options.seed, machine) for text in options.hide
                ),
            ),
        )
    except SimulatorError as error:
        print(f"synthetic: {error}", file=sys.stderr)
        return 2
    write_bundle_files(options.out, recording, csv=options.csv)
    print(
        f"{options.out}: {len(recording)} samples, {recording.timeline.end_s:.0f} s of "
        f"motion, written in {time.perf_counter() - begin:.1f} s",
        file=sys.stderr,
    )
    return 0


def _program(machine: MachineFile, options: argparse.Namespace) -> Program:
    if machine.rotary_axes and options.mode == "standstill":
        return paths.turning_points(machine, options.seed, options.points)
    if machine.rotary_axes:
        return paths.turning_path(machine, options.seed, options.rows, options.feed)
    if options.mode == "standstill":
        return paths.standstill_points(machine, options.seed, options.points)
    if options.corners:
        return paths.corner_path(machine, options.feed)
    return paths.chord_path(machine, options.seed, options.rows, options.feed)


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m truepath_simulators.worlds.synthetic", description=main.__doc__
    )
    parser.add_argument("out", type=Path, help="folder of the bundle")
    parser.add_argument(
        "--machine", default="demo", help="machine.json, or bundled name"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--machine-seed", type=int, help="which machine, if not that of --seed"
    )
    parser.add_argument("--mode", choices=["otf", "standstill"], default="otf")
    parser.add_argument("--feed", type=float, default=5000.0, help="mm/min")
    parser.add_argument("--rows", type=int, default=60, help="waypoints of the path")
    parser.add_argument("--points", type=int, default=150, help="random standstills")
    parser.add_argument("--corners", action="store_true", help="corner-to-corner path")
    parser.add_argument("--rate", type=float, default=None, help="Hz")
    parser.add_argument("--error-scale", type=float, default=1.0)
    parser.add_argument("--rough", action="store_true", help="with losses and holds")
    parser.add_argument(
        "--hide",
        action="append",
        default=[],
        metavar="EFFECT[*SIZE_UM]",
        help="an effect that no rigid-body model knows, drawn by the seed",
    )
    parser.add_argument("--csv", action="store_true", help="tracker.csv, not parquet")
    return parser


_TYPICAL_DEGC = 20.0
_SIGMA_K = 0.02
_PERIOD_S = 1.0


def read_sensors(
    machine: MachineFile,
    device_s: np.ndarray,
    clock: TrackerClock,
    seed: int,
    hidden: Sequence[HiddenEffect],
) -> Temperatures:
    """Readings of the sensors: constant apart from noise and effects."""
    rng = generator(seed, "environment")
    names = tuple(axis.name for axis in machine.linear_axes)
    time_s = np.arange(device_s[0], device_s[-1], _PERIOD_S)
    celsius = _TYPICAL_DEGC + rng.normal(0.0, _SIGMA_K, (len(time_s), len(names)))
    for effect in hidden:
        for column, name in enumerate(names):
            celsius[:, column] += effect.warming_degc(name, clock.true_s(time_s))
    return Temperatures(names, time_s, celsius)


if __name__ == "__main__":
    sys.exit(main())
