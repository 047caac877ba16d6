"""Rigs by their control socket, and the simulated CNC in the hands of other masters."""

import json
import re
import shutil
import socket
import stat
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from processes import until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.cnc.modbus.registers import BY_NAME, Command, Result
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command import main
from truepath_simulators.bench.control import ControlSocket
from truepath_simulators.bench.rig import Rig, running_rig
from truepath_simulators.errors import SimulatorError
from truepath_simulators.linuxcnc.rig import explain_absence

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


PAGE = Path(__file__).parents[3] / "docs" / "modbus-register-map.md"
PRINTED = re.findall(r"^(mbpoll [^#]*?) *(?:#.*)?$", PAGE.read_text(), re.MULTILINE)
HERE = "mbpoll -m tcp -p 1502 -a 1 -0"  # the device, as the page has it
IDENTITY = [0x5450, 0x4331, 0x0102, 0x0304, 2]


@pytest.fixture(scope="module")
def bench():
    assert shutil.which("mbpoll"), "it proves the map from outside: apt install mbpoll"
    with Bench(seed=1, tracker="tcp") as running:
        yield running


@pytest.fixture(params=["tcp", "rtu"])
def poll(request, bench):
    tty, port = bench.motion_options_rtu["serial_port"], bench.motion_options["port"]

    def run(command):
        if request.param == "rtu":
            command = command.replace("-m tcp -p 1502", "-m rtu -b 115200 -P none")
            command = command.replace("127.0.0.1", tty)
        words = command.replace("1502", str(port)).split()
        done = subprocess.run(words, capture_output=True, text=True, timeout=10)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def read(poll, name, count, kind="4"):
    """Return the values of lines such as `[100]:  0x5450` or `[112]:  1000 (…)`."""
    where = f"-t {kind} -r {BY_NAME[name].address} -c {count}"
    shown = poll(f"{HERE} {where} -1 127.0.0.1")
    values = re.findall(r"^\[\d+\]:\s+(\S+)", shown, re.MULTILINE)
    return [int(value, 0) for value in values]


def write(poll, name, *values):
    words = " ".join(map(str, values))
    poll(f"{HERE} -t 4 -r {BY_NAME[name].address} 127.0.0.1 {words}")


def order(poll, verb, *arguments):
    """Give a command as one does by hand: one write, then a look at the result."""
    number = read(poll, "command_ack", 1)[0] + 1
    write(poll, "command_sequence", number, int(verb), *arguments)
    ack, result = read(poll, "command_ack", 2)
    assert ack == number
    return Result(result)


def test_commands_of_the_page_work_as_printed(poll):
    assert len(PRINTED) == 5
    for command in PRINTED:
        shown = poll(command)
        assert "Written" in shown or "]: " in shown


def test_it_reads_identity_positions_and_travel_and_what_it_writes(poll):
    assert read(poll, "magic", 5, "4:hex") == IDENTITY
    assert len(read(poll, "position", 3, "4:int -B")) == 3
    travel = read(poll, "travel_max", 3, "4:int -B")
    assert travel == [5_000_000, 4_000_000, 3_000_000]
    for name, value in (("watchdog", 750), ("watchdog", 1000), ("heartbeat", 77)):
        write(poll, name, value)
        assert read(poll, name, 1) == [value]


def test_it_gives_commands_and_moves_an_axis(poll):
    assert order(poll, Command.RESUME) is Result.DONE
    assert order(poll, Command.START, 0, 0, 0, 0) is Result.NO_PATH
    assert order(poll, Command.PUT_ROWS, 0, 0, 0, 0) is Result.BAD_ARGUMENT
    assert order(poll, Command.RESET) is Result.DONE
    here = read(poll, "position", 1, "4:int -B")[0]
    x = here + 20_000  # 2 mm
    feed = 6_000_000  # 6000 mm/min
    row = [x >> 16, x & 0xFFFF, *[0] * 10, feed >> 16, feed & 0xFFFF, 0, 0]
    assert order(poll, Command.MOVE_TO, 0, 0, 0, 0, *row) is Result.DONE
    deadline_s = time.monotonic() + 5.0
    while here != x and time.monotonic() < deadline_s:
        here = read(poll, "position", 1, "4:int -B")[0]
    assert here == x


@pytest.mark.parametrize("poll", ["tcp"], indirect=True)
def test_a_hold_by_hand_holds_and_the_driver_goes_on(poll, bench):
    with ModbusController(**bench.motion_options_rtu) as controller:
        controller.move_to([100.0, 100.0, 100.0], 600)
        assert order(poll, Command.HOLD) is Result.DONE
        status = controller.wait(5.0)
        assert (status.state, status.hold_reason) == (MotionState.HELD, "command")
        controller.abort()
        assert controller.wait(5.0).state is MotionState.ABORTED


ABSENT = explain_absence() or ("" if shutil.which("mb2hal") else "mb2hal is absent")
FINISHED = 4
READS = "fnct_03_read_holding_registers"
# Transaction: pins, first register, number of registers, function.
TRANSACTIONS = (
    ("identity", "magic", 5, READS),
    ("status", "state", 24, READS),
    ("watchdog", "watchdog", 1, "fnct_06_write_single_register"),
    ("order", "command_sequence", 22, "fnct_16_write_multiple_registers"),
)
EACH = ("MB_SLAVE_ID=1", "MAX_UPDATE_RATE=0.0", "DEBUG=1")
EACH += ("MB_RESPONSE_TIMEOUT_MS=500", "MB_BYTE_TIMEOUT_MS=500")
# HAL's shared memory and its programs are gone with the namespaces.
ALONE = "unshare --ipc --mount --pid --fork --kill-child --mount-proc"


@pytest.fixture
def folder():
    """A folder that LinuxCNC's programs may enter, whoever runs them."""
    with tempfile.TemporaryDirectory(prefix="mb2hal-", dir="/var/tmp") as name:
        Path(name).chmod(0o755)
        (Path(name) / "run").mkdir()
        (Path(name) / "run").chmod(0o1777)
        yield Path(name)


def write_transaction(number, link, pins, register, count, function):
    lines = [f"[TRANSACTION_{number:02d}]", *link, *EACH, f"MB_TX_CODE={function}"]
    lines += [f"FIRST_ELEMENT={BY_NAME[register].address}", f"NELEMENTS={count}"]
    return "\n".join([*lines, f"HAL_TX_NAME={pins}", ""])


def describe_link(bench, link):
    if link == "tcp":
        where = bench.motion_options
        return ["LINK_TYPE=tcp", f"TCP_IP={where['host']}", f"TCP_PORT={where['port']}"]
    where = bench.motion_options_rtu
    line = ["BITS=8", "PARITY=none", "STOP=1", "DELAY_MS=0"]
    port = Path(where["serial_port"]).resolve()  # 32 characters fit
    line += [f"BAUD={where['baudrate']}", f"PORT={port}"]
    return ["LINK_TYPE=serial", *(f"SERIAL_{word}" for word in line)]


def run_mb2hal(folder, link, orders):
    head = f"[MB2HAL_INIT]\nINIT_DEBUG=1\nTOTAL_TRANSACTIONS={len(TRANSACTIONS)}\n"
    head += "SLOWDOWN=0.0\nHAL_MODULE_NAME=mb2hal\n"
    entries = [write_transaction(i, link, *t) for i, t in enumerate(TRANSACTIONS)]
    (folder / "mb2hal.ini").write_text(head + "".join(entries))
    lines = ["loadusr -W mb2hal config=mb2hal.ini", *orders, "show pin mb2hal"]
    (folder / "poll.hal").write_text("\n".join(lines) + "\n")
    environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": str(folder)}
    fifo = str(folder / "run" / "fifo")
    environment |= {"RTAPI_UID": "65534", "RTAPI_FIFO_PATH": fifo}
    how = {"cwd": folder, "env": environment, "stdin": subprocess.DEVNULL}
    read = {"capture_output": True, "encoding": "ascii", "errors": "replace"}
    words = [*ALONE.split(), "halrun", "-f", "poll.hal"]  # it prints bytes of replies
    done = subprocess.run(words, **how, **read, timeout=30)
    assert done.returncode == 0, done.stdout + done.stderr
    shown = re.findall(r"(\S+)  mb2hal\.(\S+)$", done.stdout, re.MULTILINE)
    return {pin: int(v, 16) if "0x" in v else int(float(v)) for v, pin in shown}


@pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")
@pytest.mark.parametrize("link", ["tcp", "rtu"])
def test_mb2hal_polls_and_moves_the_machine_once(bench, folder, link):
    where = describe_link(bench, link)
    number, target = {"tcp": (1, 40_000), "rtu": (2, 55_000)}[link]  # 0.1 µm
    feed = 6_000_000
    row = [target, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, feed >> 16, feed & 0xFFFF, 0, 0]
    words = [int(Command.MOVE_TO), 0, 1, 0, 0, 0, *row]
    orders = ["setp mb2hal.watchdog.00 900"]
    orders += [f"setp mb2hal.order.{i:02d} {w}" for i, w in enumerate(words, 1)]
    orders += [f"setp mb2hal.order.00 {number}", "loadusr -w sleep 1"]

    pins = run_mb2hal(folder, where, orders)

    identity = [pins[f"identity.{i:02d}.int"] for i in range(5)]
    assert identity == IDENTITY
    status = [pins[f"status.{i:02d}.int"] for i in range(24)]
    assert status[0] == FINISHED
    assert (status[5], status[6]) == (number, Result.DONE)
    assert status[12] << 16 | status[13] == target
    assert not any(count for pin, count in pins.items() if pin.endswith("num_errors"))
