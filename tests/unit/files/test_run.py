"""Runs: what a result says of one, when they were, how a recording is known again."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.calibration_report import describe_interruptions
from truepath.errors import BadInput, BundleError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.one_machine import TimedRun, order_in_time
from truepath.files.bundle.run import (
    Run,
    RunEvent,
    digest_run,
    share_samples,
    sketch_samples,
    summarize_run,
)
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples
from truepath_simulators.machine_file import load_machine


@pytest.fixture
def run(mill, rng):
    n = 1000
    time_s, position_mm = 5.0 + np.arange(n) / 500.0, rng.normal(size=(n, 3))
    stream = TrackerSamples(np.arange(n), time_s, position_mm, np.zeros(n, int))
    places, feeds = rng.uniform(20.0, 300.0, (4, 3)), [500.0, 2500.0, 800.0, 1000.0]
    path = Path(("X", "Y", "Z"), places, np.array(feeds), np.full(4, 0.5))
    celsius = np.array([[20, 21], [22, 19]])
    warm = TemperatureSamples(("X", "air"), np.arange(2.0), celsius)
    return Run("monday", mill, path, stream, warm, provenance={"source": "a"})


def test_a_path_of_four_rows_has_three_lines(run):
    summary = summarize_run(run)
    assert (summary.mode, summary.lines) == ("otf", 3)
    assert summary.feed_mm_min == (500.0, 2500.0)
    assert summary.measured_s == pytest.approx(999 / 500)
    assert summary.samples == 1000
    assert summary.temperature_degc == {"X": (20.0, 22.0), "air": (19.0, 21.0)}
    assert summary.source == {"source": "a"}


def test_standstill_points_have_no_feed_and_an_empty_stream_took_no_time(run):
    stood = stand_at(run, np.full(4, 1.0))
    summary = summarize_run(replace(run, **stood, temperature=None))
    assert (summary.mode, summary.lines) == ("standstill", 4)
    assert summary.feed_mm_min is None
    assert summary.temperature_degc == {}
    assert summarize_run(replace(run, tracker=TrackerSamples.empty())).measured_s == 0.0


def test_the_digest_is_of_the_numbers_and_not_of_their_storage(run):
    status = run.tracker.status.astype(np.int32)
    position = np.asfortranarray(run.tracker.position_mm)
    stored = replace(run.tracker, status=status, position_mm=position)
    again = replace(run, name="tuesday", tracker=stored, provenance={})
    assert digest_run(again) == digest_run(run)


def move_sample(run):
    position = run.tracker.position_mm.copy()
    position[500, 1] = np.nextafter(position[500, 1], 9.0)
    return {"tracker": replace(run.tracker, position_mm=position)}


def stand_at(run, dwell_s):
    places = run.commanded.position
    return {"commanded": Configurations(("X", "Y", "Z"), places, dwell_s)}


@pytest.mark.parametrize(
    "change",
    [
        move_sample,
        lambda run: {"commanded": replace(run.commanded, feed_mm_min=np.full(4, 501))},
        lambda run: {"machine": replace(run.machine, name="other")},
        lambda run: stand_at(run, run.commanded.dwell_s),
    ],
)
def test_another_input_has_another_digest(run, change):
    assert digest_run(replace(run, **change(run))) != digest_run(run)


def test_broken_beams_lost_samples_and_lines_driven_twice_are_told(run):
    status = np.zeros(1000, int)
    status[100:150] = 1  # 0.1 s
    status[990:] = 3  # up to the end
    sequence = np.arange(1000) + 7 * (np.arange(1000) >= 600)
    stream = replace(run.tracker, status=status, sequence=sequence)
    events = (RunEvent(1, "again", "from row 4 on"), RunEvent(2, "start", ""))
    summary = summarize_run(replace(run, tracker=stream, events=events))
    found = summary.interruptions
    assert (found.breaks, found.gaps, found.lost_samples) == (2, 1, 7)
    assert found.broken_s == pytest.approx(0.12, rel=1e-3)
    assert describe_interruptions(summary) == (
        "the beam was broken 2 times, 0.1 s in all; 7 samples lost in one place; "
        "driven twice: from row 4 on"
    )
    assert describe_interruptions(summarize_run(run)) == ""


MACHINE = machine_from_json({**load_machine("demo")}, file="machine.json")


def timed(name, span_s, started_s=None, machine=MACHINE, digest=None):
    return TimedRun(name, machine, digest or name, started_s, span_s)


def test_the_computers_clock_counts_where_every_run_has_it_else_the_trackers():
    runs = [timed("a", (0.0, 10.0)), timed("b", (100.0, 120.0), 5000.0)]
    assert order_in_time(runs, None).time_s == (5.0, 110.0)
    runs = [timed("a", (0.0, 10.0), 1000.0), timed("b", (0.0, 20.0), 5000.0)]
    assert order_in_time(runs, None).time_s == (1005.0, 5010.0)
    runs[1] = replace(runs[1], started_s=None)
    with pytest.raises(BadInput, match=r"begun anew between a and b.*--at, at_h"):
        order_in_time(runs, None)
    assert order_in_time(runs, [3.0, 4.0]).time_s == (3.0, 4.0)


def test_the_same_run_twice_is_named_with_its_digest():
    runs = [timed("a", (0.0, 1.0), digest="ab" * 32), timed("b", (5.0, 6.0))]
    runs.append(timed("c", (9.0, 10.0), digest="ab" * 32))
    with pytest.raises(BadInput, match=r"a and c are the same Run.*abababab"):
        order_in_time(runs, [0.0, 1.0, 2.0])


def test_runs_of_other_machines_tools_or_no_time_are_refused():
    run, spans = timed("a", (0.0, 1.0)), (5.0, 6.0)
    lathe = replace(MACHINE, name="lathe")
    with pytest.raises(BundleError, match="name is lathe"):
        order_in_time([run, timed("b", spans, machine=lathe)], None)
    moved = replace(MACHINE.targets[0], offset_mm=(0.0, 0.0, -1.0))
    other = replace(MACHINE, targets=(moved,))
    with pytest.raises(BadInput, match="b has other targets"):
        order_in_time([run, timed("b", spans, machine=other)], None)
    for times in ([0.0, 0.0], [1.0, 0.0], [0.0, float("nan")], [0.0, float("inf")]):
        with pytest.raises(BadInput, match="do not increase from a to b"):
            order_in_time([run, timed("b", spans)], times)
    with pytest.raises(BadInput, match="two at least"):
        order_in_time([run], [0.0])


N = 60_000


def stream(position_mm, status=None):
    n = len(position_mm)
    status = np.zeros(n, int) if status is None else status
    return TrackerSamples(np.arange(n), np.arange(n) / 500.0, position_mm, status)


def place(rng, noise_mm, step_mm=0.0):
    """Stand at twenty places, the same in every recording; read by steps."""
    stands = np.repeat(np.random.default_rng(7).uniform(-900, 900, (20, 3)), N // 20, 0)
    seen = stands + rng.normal(size=(N, 3)) * noise_mm
    return np.round(seen / step_mm) * step_mm if step_mm else seen


@pytest.fixture
def recorded(rng):
    return place(rng, 0.002)


@pytest.mark.parametrize("part", [slice(200, N), slice(N // 2), slice(20_000, 22_400)])
def test_a_part_is_known_whatever_its_clock_and_its_losses_say(recorded, rng, part):
    whole = sketch_samples(stream(recorded))
    cut = recorded[part]
    lost = rng.uniform(size=len(cut)) < 0.01
    cut = np.where(lost[:, None], np.nan, cut)
    assert share_samples(whole, sketch_samples(stream(cut, lost.astype(int))))


def test_recordings_that_overlap_are_known_from_either(recorded):
    parts = recorded[:40_000], recorded[10_000:50_000]
    one, other = (sketch_samples(stream(part)) for part in parts)
    assert share_samples(one, other)
    assert share_samples(other, one)


def test_a_beginning_that_a_simulated_tracker_repeats_is_no_sign(recorded, rng):
    again = place(rng, 0.002)
    again[: N // 10] = recorded[: N // 10]
    one, other = (sketch_samples(stream(each)) for each in (recorded, again))
    assert not share_samples(one, other)


@pytest.mark.parametrize("step_mm", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("noise_mm", [0.0005, 0.01])
def test_another_recording_of_the_same_places_has_nothing_of_it(rng, noise_mm, step_mm):
    seen = (place(rng, noise_mm, step_mm) for _ in range(2))
    one, other = (sketch_samples(stream(each)) for each in seen)
    assert not share_samples(one, other)


def test_one_value_all_the_time_and_few_samples_are_no_sign_of_anything(recorded):
    still = stream(np.full((N, 3), 1.5))
    assert not share_samples(sketch_samples(still), sketch_samples(still))
    for short in (still, stream(recorded[:11]), TrackerSamples.empty()):
        assert sketch_samples(short) == ""


def test_a_zero_has_no_sign(rng):
    position_mm = rng.normal(size=(50, 3)).round()
    negative_mm = np.where(position_mm == 0.0, -0.0, position_mm)
    one, other = (sketch_samples(stream(p)) for p in (position_mm, negative_mm))
    assert one == other
