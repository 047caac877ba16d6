"""The commands that the page of the register map prints work as printed."""

import shutil
import subprocess
from pathlib import Path

import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.bench.bench import Bench

PAGE = Path(__file__).parents[3] / "docs" / "modbus-register-map.md"
COMMANDS = [
    line.split("#")[0].strip()
    for line in PAGE.read_text().splitlines()
    if line.startswith("mbpoll ")
]


@pytest.fixture(scope="module")
def bench():
    if shutil.which("mbpoll") is None:
        pytest.fail("mbpoll is not installed: apt-get install mbpoll")
    with Bench(tracker="tcp") as bench:
        yield bench


def by_hand(bench: Bench, link: str, command: str) -> str:
    """Run a printed command on the link of the bench; return the numbers it shows."""
    if link == "tcp":
        port = str(bench.motion_options["port"])
        words = command.replace("1502", port).split()
    else:
        over_rtu = command.replace("-m tcp -p 1502", "-m rtu -b 115200 -P none")
        tty = bench.motion_options_rtu["serial_port"]
        words = over_rtu.replace("127.0.0.1", tty).split()
    done = subprocess.run(words, capture_output=True, text=True, timeout=10)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("link", ["tcp", "rtu"])
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_of_the_page_work(bench, link, command):
    shown = by_hand(bench, link, command)
    assert "Written" in shown or "]: " in shown


def test_the_identity_reads_as_the_page_says(bench):
    shown = by_hand(bench, "tcp", COMMANDS[0])
    values = [line.split()[-1] for line in shown.splitlines() if line.startswith("[")]
    assert values == ["0x5450", "0x4331", "0x0102", "0x0304", "0x0002"]


def test_a_hold_by_hand_holds_and_the_driver_goes_on(bench):
    with ModbusController(**bench.motion_options_rtu) as controller:
        controller.move_to([100.0, 100.0, 100.0], 600)
        ack = by_hand(bench, "tcp", COMMANDS[1].replace("-r 100 -c 8", "-r 105 -c 1"))
        number = int(ack.split()[-1]) + 1
        by_hand(bench, "tcp", COMMANDS[3].replace("17 5", f"{number} 5"))
        status = controller.wait(5.0)
        assert (status.state, status.hold_reason) == (MotionState.HELD, "command")
        controller.abort()
        assert controller.wait(5.0).state is MotionState.ABORTED
