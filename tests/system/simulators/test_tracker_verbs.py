"""A tracker that aims, seeks and chooses its target, and one that follows positions."""

import os
import socket
import threading
import time

import numpy as np
import pytest

from processes import until
from truepath_drivers.interfaces.errors import BeamLost, NotHomed, Refused
from truepath_drivers.interfaces.tracker_records import Air
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.errors import SimulatorError
from truepath_simulators.motion.followed_positions import FollowedPositions, open_source
from truepath_simulators.scenario import load_machine

APART_MM = 150.0


@pytest.fixture(scope="module")
def bench():
    """The demonstration machine with two targets."""
    content = load_machine("demo")
    x, y, z = content.pop("tool_offset_mm")
    offsets = {"T1": [x, y, z], "T2": [x + APART_MM, y, z]}
    content["targets"] = {
        name: {"on": "tool", "offset_mm": offset} for name, offset in offsets.items()
    }
    with Bench(content, seed=3) as running:
        yield running


@pytest.fixture(scope="module")
def tracker(bench):
    with StreamingTracker(**bench.tracker_options) as connected:
        connected.start(500.0)
        yield connected


def read_valid(tracker):
    """Return where the target is, by samples that were taken after the call."""
    for _ in range(2):
        tracker.read(0.0)
        time.sleep(0.1)
    samples = tracker.read(1.0)
    return samples.position_mm[samples.status == 0]


def to_direction(place_mm):
    x, y, z = place_mm
    return float(np.arctan2(y, x)), float(np.arctan2(z, np.hypot(x, y)))


def test_it_measures_the_target_that_was_selected_and_stays_at_it(tracker):
    tracker.select_target("T1")
    first = read_valid(tracker).mean(axis=0)
    tracker.select_target("T2")
    second = read_valid(tracker).mean(axis=0)
    assert np.linalg.norm(second - first) == pytest.approx(APART_MM, abs=1.0)
    with pytest.raises(Refused, match="knows T1, T2"):
        tracker.select_target("T9")
    after = read_valid(tracker).mean(axis=0)
    assert np.linalg.norm(after - second) < 0.1


def test_it_finds_the_target_near_the_beam_and_none_elsewhere(tracker):
    tracker.select_target("T2")
    place = read_valid(tracker).mean(axis=0)
    azimuth, elevation = to_direction(place)
    tracker.aim(azimuth + 0.002, elevation)
    assert not len(read_valid(tracker))
    tracker.search()
    np.testing.assert_allclose(read_valid(tracker).mean(axis=0), place, atol=0.1)
    tracker.aim(azimuth + np.pi, elevation)
    with pytest.raises(BeamLost, match="no target near the beam"):
        tracker.search()
    tracker.select_target("T1")


def test_the_air_that_is_pushed_is_the_air_in_use(tracker):
    tracker.push_air(Air(21.5, 990.0, 40.0))
    assert tracker.read_air() == Air(21.5, 990.0, 40.0)


def test_one_that_is_not_initialised_measures_once_it_is_homed(bench, tracker):
    bench.inject("tracker:unhomed")
    tracker.stop()
    until(lambda: is_refused(tracker))
    with pytest.raises(NotHomed, match="not initialised"):
        tracker.select_target("T1")
    tracker.home()
    tracker.select_target("T1")
    tracker.start(500.0)
    assert len(read_valid(tracker))


def is_refused(tracker):
    try:
        tracker.start(500.0)
    except NotHomed as refusal:
        return "not initialised" in str(refusal)
    tracker.stop()
    return False


def test_a_source_is_a_file_or_a_socket(tmp_path):
    (tmp_path / "moves.txt").write_text("0.5 1 2\n")
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"

        def send():
            with server.accept()[0] as peer:
                peer.sendall(b"0.5 1 2\n")

        sender = threading.Thread(target=send)
        sender.start()
        for name in (str(tmp_path / "moves.txt"), address):
            followed = FollowedPositions(open_source(name), 2)
            deadline = time.monotonic() + 5.0
            while (seen := followed.timeline()) is None:
                assert time.monotonic() < deadline
            assert seen.origin.tolist() == [[1.0, 2.0]]
            followed.close()
        sender.join()
    with pytest.raises(SimulatorError, match="no-such"):
        open_source(str(tmp_path / "no-such"))


def read_until(tracker, is_enough):
    blocks, deadline = [], time.monotonic() + 30.0
    names = ("sequence", "device_time_s", "position_mm")
    while not blocks or not is_enough(np.vstack([b.position_mm for b in blocks])):
        assert time.monotonic() < deadline, "what was waited for was not seen"
        blocks.append(tracker.read(1.0))
    return [np.concatenate([getattr(b, name) for b in blocks]) for name in names]


@pytest.mark.long
def test_the_tracker_streams_what_it_follows():
    read, write = os.pipe()
    ended, stepped = threading.Event(), threading.Event()

    def drive():
        number = 0
        while not ended.wait(0.01):
            x = 300.0 if stepped.is_set() else 100.0
            lines = (f"{number + k} {x} 50 20\n" for k in range(10))
            os.write(write, "".join(lines).encode())
            number += 10

    thread = threading.Thread(target=drive)
    try:
        with (
            Bench(error_scale=0.0, source=read, source_unit_s=1e-3) as bench,
            StreamingTracker(**bench.tracker_options) as tracker,
        ):
            with pytest.raises(SimulatorError, match="no simulated cnc"):
                bench.inject("cnc:alarm")
            # Not before: what waits in the pipe would all be streamed at once.
            thread.start()
            tracker.start(500.0)
            before = read_until(tracker, lambda seen: len(seen) >= 50)
            stepped.set()
            stood = before[2][:20].mean(0)
            after = read_until(
                tracker,
                lambda seen: (
                    len(seen) >= 20
                    and (np.linalg.norm(seen[-20:] - stood, axis=1) > 10.0).all()
                ),
            )
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
        os.close(read)
        os.close(write)
    sequence, time_s, position = map(np.concatenate, zip(before, after, strict=True))
    assert (np.diff(sequence) == 1).all()
    np.testing.assert_allclose(np.diff(time_s), 2e-3, atol=2e-6)
    assert np.linalg.norm(position[-20:].mean(0) - stood) == pytest.approx(
        200.0, abs=0.02
    )
