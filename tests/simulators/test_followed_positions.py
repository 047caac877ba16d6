"""A tracker that follows axis positions from outside."""

from __future__ import annotations

import os
import socket
import threading
import time

import numpy as np
import pytest

from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.errors import SimulatorError
from truepath_simulators.motion.followed_positions import FollowedPositions, open_source


@pytest.fixture
def source():
    """Positions of two axes in milliseconds, and where to write them."""
    read, write = os.pipe()
    followed = FollowedPositions(read, 2, 1e-3)
    yield followed, lambda text: os.write(write, text.encode())
    followed.close()
    os.close(write)


def test_positions_are_those_of_the_source_at_its_own_times(source):
    followed, write = source
    assert followed.timeline() is None
    assert followed.now_s() == 0.0
    write("1000 10.0 5.0\n1001 10.2 5.0\n1002 10.4 5.1 99 98\n1003 10.4 ")
    at = followed.timeline().positions(np.array([1.0, 1.0005, 1.0015, 1.002, 7.0]))
    np.testing.assert_allclose(
        at, [[10.0, 5.0], [10.1, 5.0], [10.3, 5.05], [10.4, 5.1], [10.4, 5.1]]
    )
    assert followed.now_s() == pytest.approx(1.002)
    write("5.1\n")
    assert followed.timeline().end_s == pytest.approx(1.003)


def test_what_is_no_position_and_time_that_goes_back_are_left_out(source):
    followed, write = source
    write(
        "1000, 1.0, 2.0\noverrun\n1001 nan 2.0\n999 7.0 7.0\n1000 8.0 8.0\n1002 3 4\n"
    )
    timeline = followed.timeline()
    np.testing.assert_allclose(timeline.start_s, [1.0, 1.002])
    np.testing.assert_allclose(timeline.origin, [[1.0, 2.0], [3.0, 4.0]])


def test_only_the_last_seconds_are_kept(source):
    followed, write = source
    for begin in range(0, 30_000, 1000):
        write("".join(f"{t} {t} 0\n" for t in range(begin, begin + 1000, 10)))
        timeline = followed.timeline()
    assert timeline.start_s[0] == pytest.approx(19.99, abs=0.011)


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
    """Return numbers, times and positions of samples, read until they are enough."""
    blocks, deadline = [], time.monotonic() + 30.0
    names = ("sequence", "device_time_s", "position_mm")
    while not blocks or not is_enough(np.vstack([b.position_mm for b in blocks])):
        assert time.monotonic() < deadline, "what was waited for was not seen"
        blocks.append(tracker.read(1.0))
    return [np.concatenate([getattr(b, name) for b in blocks]) for name in names]


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
