"""Rigs worked by their control socket, and the fixtures that stand on it."""

import json
import socket
import stat
from pathlib import Path

import numpy as np
import pytest

from processes import until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.command import main
from truepath_simulators.bench.control import ControlSocket
from truepath_simulators.bench.rig import Rig, running_rig
from truepath_simulators.errors import SimulatorError

PLACE = np.array([[60.0, 20.0, 10.0]])


@pytest.fixture(scope="module")
def rig():
    with running_rig({"seed": 4, "speed": 5.0, "tracker": "tcp"}) as started:
        yield started


def find_target(tracker):
    return tracker.read(2.0).position_mm.mean(axis=0)


def test_state_follows_the_devices_and_a_table_moves_the_measured_point(rig, tmp_path):
    table = tmp_path / "shift-X.tbl"
    table.write_text("0 0.05 0.05\n500 500.05 500.05\n")  # 50 µm too far everywhere
    with (
        StreamingTracker(**rig.tracker_options) as tracker,
        ModbusController(**rig.motion_options) as motion,
    ):
        assert not rig.read_state()["tracker"]["streaming"]
        tracker.start(500.0)
        motion.move_to((60.0, 20.0, 10.0), 3000.0)
        assert motion.wait(10.0).state is MotionState.FINISHED
        state = rig.read_state()
        assert state["tracker"]["rate_hz"] == 500.0
        assert state["cnc"]["state"] == "finished"
        assert state["cnc"]["position"] == pytest.approx([60.0, 20.0, 10.0])
        before, seen = rig.read_position(), find_target(tracker)
        assert rig.load_compensation([table]) == ["shift-X.tbl"]
        after, error_um = rig.read_position(), rig.truth_at(PLACE)
        shift = np.subtract(after["target_mm"], before["target_mm"])[0]
        np.testing.assert_allclose(shift, [-0.05, 0.0, 0.0], atol=1e-4)
        assert after["position"] == before["position"]  # as commanded
        far = 0.04
        until(lambda: np.linalg.norm(find_target(tracker) - seen) > far)
        assert rig.read_state()["cnc"]["compensation"] == ["shift-X.tbl"]
        motion.move_to((400.0, 20.0, 10.0), 1000.0)
        with pytest.raises(SimulatorError, match="axes move"):
            rig.load_compensation([])
        motion.abort()
        motion.wait(10.0)
    until(lambda: rig.read_state()["cnc"]["state"] != "running")
    assert rig.load_compensation([]) == []
    more_um = rig.truth_at(PLACE) - error_um
    np.testing.assert_allclose(more_um, [[50.0, 0.0, 0.0]], atol=0.1)
    with pytest.raises(SimulatorError, match=r"nowhere\.tbl"):
        rig.load_compensation([tmp_path / "nowhere.tbl"])


def test_the_measured_point_is_the_true_one_seen_from_the_pose(rig):
    truth = rig.read_truth()
    pose = truth["pose"]
    with StreamingTracker(**rig.tracker_options) as tracker:
        tracker.start(200.0)
        measured = find_target(tracker)
    true = np.array(rig.read_position()["target_mm"][0])
    seen = (true - pose["position_mm"]) @ np.array(pose["rotation"])
    assert np.linalg.norm(measured - seen) < 0.05
    grid = np.array(truth["points_mm"])[:5]
    np.testing.assert_allclose(rig.truth_at(grid), truth["deviation_um"][:5], atol=1e-3)
    now_s = rig.read_position()["time_s"][0]
    times = [now_s - 2.0, now_s - 1.0, now_s]
    first, second = rig.read_position(times), rig.read_position(times)
    assert first == second  # positions of the past are the same again
    assert np.shape(first["target_mm"]) == (3, 3)


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (b"nonsense", "Expecting value"),
        (b"[]", "expected an object"),
        (b'{"do": "explode"}', "known are links, state"),
        (b'{"do": "inject"}', "fault is missing"),
        (b'{"do": "inject", "fault": "tracker:explode"}', "unknown"),
        (b'{"do": "truth", "points": [[1, 2]]}', "rows of axis positions"),
        (b'{"do": "position", "time_s": [NaN]}', "seconds"),
        (b'{"do": "position", "target": "nobody"}', "nobody"),
        (b'{"do": "move-tracker", "place_mm": [1]}', "in mm"),
    ],
)
def test_what_is_not_understood_is_said_and_the_rig_lives(rig, order, said):
    rig._socket.sendall(order + b"\n")
    answer = json.loads(rig._lines.readline())
    assert not answer["ok"]
    assert said in answer["error"]
    assert rig.read_state()


def test_the_page_shows_the_example_that_is_a_test():
    here = Path(__file__)
    example = here.with_name("test_rig_example.py").read_text()
    page = here.parents[3] / "docs" / "test-rigs.md"
    assert f"```python\n{example}```" in page.read_text()


def test_only_its_user_opens_it_and_what_is_not_its_own_is_never_taken(tmp_path):
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    control = ControlSocket(path, dict)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    with pytest.raises(SimulatorError, match="in use"):
        ControlSocket(path, dict)
    control.close()
    assert not path.exists()
    path.write_text("a letter")
    with pytest.raises(SimulatorError, match="give another path"):
        ControlSocket(path, dict)
    assert path.read_text() == "a letter"
    with pytest.raises(SimulatorError, match="no rig answers"):
        Rig(tmp_path / "nowhere")


@pytest.mark.long
def test_a_control_path_that_cannot_be_is_a_clear_line(tmp_path, capsys):
    assert main(["--control", str(tmp_path / "no" / "folder")]) == 2
    assert "control socket" in capsys.readouterr().err


def test_other_suites_use_a_rig_that_runs(rig, request, monkeypatch):
    """Their fixture, with the option `--truepath-control`."""
    control = rig._socket.getpeername()
    monkeypatch.setattr(request.config.option, "truepath_control", control)
    assert request.getfixturevalue("truepath_bench").links == rig.links
