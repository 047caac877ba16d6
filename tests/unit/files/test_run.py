"""What a result says about its Run."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.calibration_report import describe_interruptions
from truepath.files.bundle.run import Run, RunEvent, digest_run, summarize_run
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples


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
