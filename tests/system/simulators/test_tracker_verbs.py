"""Simulated trackers: what they are asked; the link that serves one host at a time."""

import os
import socket
import time
from contextlib import closing

import numpy as np
import pytest

from processes import until
from truepath_drivers.interfaces import records, tracker_records
from truepath_drivers.interfaces.errors import BeamLost, NotHomed, Refused
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.errors import SimulatorError
from truepath_simulators.links.links import TcpPort
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.followed_positions import FollowedPositions, open_source

APART_MM = 150.0


@pytest.fixture(scope="module")
def bench():
    """The demonstration machine with two targets."""
    content = load_machine("demo")
    x, y, z = content.pop("tool_offset_mm")
    first, second = ({"on": "tool", "offset_mm": [x + d, y, z]} for d in (0, APART_MM))
    content["targets"] = {"T1": first, "T2": second}
    with Bench(content, seed=3) as running:
        yield running


@pytest.fixture(scope="module")
def tracker(bench):
    with StreamingTracker(**bench.tracker_options) as connected:
        connected.start(500.0)
        yield connected


def read_valid(tracker):
    for _ in range(2):
        tracker.read(0.0)
        time.sleep(0.1)
    samples = tracker.read(1.0)
    return samples.position_mm[samples.status == 0]


def test_it_measures_the_target_that_was_selected_in_the_air_that_was_pushed(tracker):
    tracker.select_target("T1")
    first = read_valid(tracker).mean(axis=0)
    tracker.select_target("T2")
    second = read_valid(tracker).mean(axis=0)
    assert np.linalg.norm(second - first) == pytest.approx(APART_MM, abs=1.0)
    with pytest.raises(Refused, match="knows T1, T2"):
        tracker.select_target("T9")
    assert np.linalg.norm(read_valid(tracker).mean(axis=0) - second) < 0.1
    tracker.push_air(tracker_records.Air(21.5, 990.0, 40.0))
    assert tracker.read_air() == tracker_records.Air(21.5, 990.0, 40.0)


def test_it_finds_the_target_near_the_beam_and_none_elsewhere(tracker):
    tracker.select_target("T2")
    x, y, z = place = read_valid(tracker).mean(axis=0)
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    tracker.aim(azimuth + 0.002, elevation)
    assert not len(read_valid(tracker))
    tracker.search()
    np.testing.assert_allclose(read_valid(tracker).mean(axis=0), place, atol=0.1)
    tracker.aim(azimuth + np.pi, elevation)
    with pytest.raises(BeamLost, match="no target near the beam"):
        tracker.search()
    tracker.select_target("T1")


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
    file = tmp_path / "moves.txt"
    file.write_text("0.5 1 2\n")
    with socket.create_server(("127.0.0.1", 0)) as server:
        remote = open_source(f"127.0.0.1:{server.getsockname()[1]}")
        with server.accept()[0] as peer:
            peer.sendall(b"0.5 1 2\n")
        for source in (open_source(str(file)), remote):
            with closing(FollowedPositions(source, 2)) as followed:
                assert until(followed.timeline).origin.tolist() == [[1.0, 2.0]]
    with pytest.raises(SimulatorError, match="no-such"):
        open_source(str(tmp_path / "no-such"))


@pytest.mark.long
def test_the_tracker_streams_what_it_follows():
    read, write = os.pipe()
    blocks = []
    with (
        Bench(error_scale=0.0, source=read, source_unit_s=1e-3) as bench,
        StreamingTracker(**bench.tracker_options) as tracker,
    ):
        with pytest.raises(SimulatorError, match="no simulated cnc"):
            bench.inject("cnc:alarm")
        tracker.start(500.0)
        for begin_ms in range(0, 1000, 10):
            x = 100 if begin_ms < 500 else 300
            lines = [f"{begin_ms + k} {x} 50 20\n" for k in range(10)]
            os.write(write, "".join(lines).encode())
            blocks.append(tracker.read(1.0))
    os.close(read)
    os.close(write)
    seen = records.TrackerSamples.join(blocks)
    assert len(seen) > 450
    assert (np.diff(seen.sequence) == 1).all()
    np.testing.assert_allclose(np.diff(seen.device_time_s), 2e-3, atol=2e-6)
    way_mm = seen.position_mm[-20:].mean(axis=0) - seen.position_mm[:20].mean(axis=0)
    assert np.linalg.norm(way_mm) == pytest.approx(200.0, abs=0.02)


@pytest.fixture
def port():
    with closing(TcpPort("127.0.0.1", 0)) as port:
        yield port


def connect(port):
    return socket.create_connection((port.address["host"], port.address["port"]), 5.0)


def receive(port, wanted):
    deadline = time.monotonic() + 5.0
    while (data := port.receive()) != wanted:
        assert time.monotonic() < deadline, data
    return data


class SpeaksMeanwhile:
    """A listener at which one host is taken while another one says a word."""

    def __init__(self, listener, other, *, leaves):
        self._listener, self._other, self._leaves = listener, other, leaves

    def accept(self):
        fresh = self._listener.accept()
        self._other.sendall(b"STOP")
        if self._leaves:
            self._other.close()
        return fresh

    def close(self):
        self._listener.close()


def test_a_host_that_leaves_with_a_last_word_makes_room_for_the_next(port):
    first = connect(port)
    assert receive(port, None) is None
    with connect(port) as second:
        second.sendall(b"START")
        port._listener = SpeaksMeanwhile(port._listener, first, leaves=True)
        assert receive(port, None) is None
        assert receive(port, b"START") == b"START"


def test_while_a_host_is_there_others_are_turned_away_and_its_words_are_kept(port):
    with connect(port) as first, connect(port) as second:
        assert receive(port, None) is None
        port._listener = SpeaksMeanwhile(port._listener, first, leaves=False)
        assert port.receive() == b"STOP"
        assert second.recv(1) == b""
        first.sendall(b"ON")
        assert receive(port, b"ON") == b"ON"
