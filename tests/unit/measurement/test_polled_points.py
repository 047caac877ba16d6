"""Standstill points by a tracker that is polled, on devices in this process."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from measurement_fixtures import NOISE_MM, PLACE_MM, QUICK, draw_rows, standing_at
from truepath.alignment.align import align
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.run import summarize_run
from truepath.measurement import messages, time_limits
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import BeamLost, ConnectionLost, DeviceError
from truepath_drivers.interfaces.tracker_records import TrackerEvent, TrackerEventKind

pytestmark = pytest.mark.usefixtures("clock")


@pytest.fixture
def order(order):
    return standing_at(order, draw_rows(4), 0.03)


def test_each_point_is_one_mean_of_its_row_and_goes_to_the_live_estimate(
    measure, order, polled, motion, journal, tmp_path
):
    moved = []
    polled.before = lambda _: moved.append(motion.status().state == "running")
    state, run = measure(replace(order, live=True))
    assert (state, moved) == ("finished", [False] * 4)
    assert run.points.row.tolist() == list(range(4))
    assert (run.points.count >= 3).all()
    off = run.tracker.position_mm - PLACE_MM - order.commanded.position
    assert np.abs(off).max() < 5 * NOISE_MM
    spread = np.sqrt(np.einsum("nii->ni", run.points.covariance_mm2)).mean()
    assert spread == pytest.approx(NOISE_MM, rel=0.4)
    assert run.temperature.celsius[:, 0].tolist() == [21.5] * 4
    assert journal.of(messages.RunClosed)[-1].samples == 4
    blocks = [event.block for event in journal.of(messages.BlockRecorded)]
    assert [block.points.row.tolist() for block in blocks] == [[0], [1], [2], [3]]
    told = [block.samples.position_mm[0].tolist() for block in blocks]
    assert told == run.tracker.position_mm.tolist()
    assert sum(len(event.tracker_mm) for event in journal.of(messages.LivePoints)) == 4
    # A bundle keeps rows, shots and covariances.
    write_bundle(run, tmp_path / "bundle")
    again = read_bundle(tmp_path / "bundle")
    for name in ("row", "count", "covariance_mm2"):
        kept, put = getattr(again.points, name), getattr(run.points, name)
        np.testing.assert_allclose(kept, put, rtol=1e-6)
    assert again.tracker.position_mm.tolist() == run.tracker.position_mm.tolist()
    first, second = align(run), align(again)
    assert first.row.tolist() == second.row.tolist() == list(range(4))
    assert first.scatter == pytest.approx(second.scatter)


def test_a_lost_target_holds_until_resumed_and_is_measured(measure, polled, journal):
    def lose(asked):
        if asked == 3:
            verb = (messages.CellVerb.RESUME,)
            threading.Timer(0.3, measure.running.obey, verb).start()
            raise BeamLost("no prism in the field of view")

    polled.before = lose
    state, run = measure()
    assert state == "finished"
    assert "beam-lost" in journal.faults
    assert "paused" in journal.states
    assert run.points.row.tolist() == list(range(4))


def test_a_link_that_is_lost_is_connected_anew(measure, polled):
    def pull(asked):
        if asked == 2:
            raise ConnectionLost("the cable was pulled")

    polled.before = pull
    state, run = measure()
    assert (state, polled.connects) == ("finished", 2)
    assert run.points.row.tolist() == list(range(4))


@pytest.mark.parametrize("error", [ConnectionLost("gone"), DeviceError("broken"), None])
def test_what_stays_away_or_never_ends_is_a_fault(measure, polled, journal, error):
    def fail(asked):
        if asked > 1 and error:
            raise error
        if asked == 2:
            host_clock.wait(polled.stopped, 20.0)

    polled.before = fail
    timeouts = time_limits.StreamTimeouts(point_s=0.3)
    state, run = measure(settings=replace(QUICK, timeouts=timeouts))
    assert (state, run.points.row.tolist()) == ("faulted", [0])
    assert error or journal.faults == ["tracker-silent"]


def test_a_machine_that_is_moved_meanwhile_is_measured_anew(measure, polled, motion):
    def jog(asked):
        if asked == 2:
            here = motion.here.copy()
            motion.here = here + 5.0
            threading.Timer(0.1, setattr, (motion, "here", here)).start()

    polled.before = jog
    state, run = measure()
    assert (state, run.points.row.tolist()) == ("finished", list(range(4)))
    off = run.tracker.position_mm - PLACE_MM - run.commanded.position
    assert np.abs(off).max() < 5 * NOISE_MM


def test_abort_ends_a_point_under_way_and_keeps_the_others(measure, polled):
    def abort(asked):
        if asked == 4:
            measure.running.obey(messages.CellVerb.ABORT)

    polled.before = abort
    state, run = measure()
    assert (state, run.points.row.tolist()) == ("aborted", [0, 1, 2])


def test_a_path_is_refused_before_anything_moves(measure, order, square, motion):
    state, _ = measure(replace(order, commanded=square))
    assert state == "failed"
    assert "move_to" not in motion.calls


@pytest.mark.fault_row(10)
def test_warnings_of_trackers_are_told_and_recorded(measure, polled, journal, measured):
    warning = TrackerEvent(TrackerEventKind.WARNING, "battery low", "plug it in")
    polled.before = lambda asked: polled.events.append(warning) if asked == 2 else None
    state, run = measure()
    assert state == "finished"
    assert journal.of(messages.FaultReported)[0].text == "battery low"
    assert ("tracker-warning", "battery low") in [(e.kind, e.text) for e in run.events]
    assert summarize_run(run).told == ("battery low",)
    measured("1 of 1 told, in the Run and in its result")


def test_events_of_controllers_are_recorded_and_told(measure, motion):
    motion.events = [TrackerEvent(TrackerEventKind.UNEVEN, "stood within a row")]
    _, run = measure()
    told = [(event.kind, event.text) for event in run.events]
    assert ("motion-uneven", "stood within a row") in told
    assert summarize_run(run).told == ("stood within a row",)
