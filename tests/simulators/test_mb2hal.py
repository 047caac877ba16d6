"""The simulated CNC under LinuxCNC's Modbus master, mb2hal, over TCP and over RTU.

mb2hal reads and writes all its registers over and over, as a PLC does.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from truepath_drivers.cnc.modbus.registers import BY_NAME, Command, Result
from truepath_simulators.bench.bench import Bench
from truepath_simulators.linuxcnc.rig import explain_absence

ABSENT = explain_absence() or ("" if shutil.which("mb2hal") else "mb2hal is absent")
pytestmark = pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")

FINISHED = 4
READS = "fnct_03_read_holding_registers"
# Transaction: pins, first register, number of registers, function.
TRANSACTIONS = (
    ("identity", "magic", 5, READS),
    ("status", "state", 24, READS),
    ("watchdog", "watchdog", 1, "fnct_06_write_single_register"),
    ("order", "command_sequence", 22, "fnct_16_write_multiple_registers"),
)
# HAL's shared memory and its programs are gone with the namespaces.
ALONE = "unshare --ipc --mount --pid --fork --kill-child --mount-proc"


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench(seed=1, tracker="tcp") as running:
        yield running


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that LinuxCNC's programs may enter, whoever runs them."""
    with tempfile.TemporaryDirectory(prefix="mb2hal-", dir="/var/tmp") as name:
        Path(name).chmod(0o755)
        (Path(name) / "run").mkdir()
        (Path(name) / "run").chmod(0o1777)
        yield Path(name)


def write_transaction(number: int, link: dict[str, str], entry: tuple) -> str:
    pins, register, count, function = entry
    keys = link | {
        "MB_SLAVE_ID": "1",
        "FIRST_ELEMENT": str(BY_NAME[register].address),
        "NELEMENTS": str(count),
        "MAX_UPDATE_RATE": "0.0",
        "MB_TX_CODE": function,
        "MB_RESPONSE_TIMEOUT_MS": "500",
        "MB_BYTE_TIMEOUT_MS": "500",
        "HAL_TX_NAME": pins,
        "DEBUG": "1",
    }
    lines = [f"{key}={value}" for key, value in keys.items()]
    return "\n".join([f"[TRANSACTION_{number:02d}]", *lines]) + "\n"


def describe_link(bench: Bench, link: str) -> dict[str, str]:
    if link == "tcp":
        where = bench.motion_options
        end = {"TCP_IP": where["host"], "TCP_PORT": str(where["port"])}
        return {"LINK_TYPE": "tcp", **end}
    where = bench.motion_options_rtu
    line = {"BITS": "8", "PARITY": "none", "STOP": "1", "DELAY_MS": "0"}
    return {
        "LINK_TYPE": "serial",
        "SERIAL_PORT": str(Path(where["serial_port"]).resolve()),  # 32 characters fit
        "SERIAL_BAUD": str(where["baudrate"]),
        **{f"SERIAL_{key}": value for key, value in line.items()},
    }


def run_mb2hal(folder: Path, link: dict[str, str], orders: list[str]) -> dict[str, int]:
    """Poll with the orders given to its pins; return what the pins show then."""
    head = f"[MB2HAL_INIT]\nINIT_DEBUG=1\nTOTAL_TRANSACTIONS={len(TRANSACTIONS)}\n"
    head += "SLOWDOWN=0.0\nHAL_MODULE_NAME=mb2hal\n"
    entries = [write_transaction(i, link, t) for i, t in enumerate(TRANSACTIONS)]
    (folder / "mb2hal.ini").write_text(head + "".join(entries))
    lines = ["loadusr -W mb2hal config=mb2hal.ini", *orders, "show pin mb2hal"]
    (folder / "poll.hal").write_text("\n".join(lines) + "\n")
    environment = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": str(folder),
        "RTAPI_UID": "65534",
        "RTAPI_FIFO_PATH": str(folder / "run" / "fifo"),
    }
    done = subprocess.run(
        [*ALONE.split(), "halrun", "-f", "poll.hal"],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="ascii",
        errors="replace",  # it prints bytes of replies
        timeout=30,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    shown = re.findall(r"(\S+)  mb2hal\.(\S+)$", done.stdout, re.MULTILINE)
    return {pin: int(float(v)) for v, pin in shown if "0x" not in v} | {
        pin: int(v, 16) for v, pin in shown if "0x" in v
    }


@pytest.mark.parametrize("link", ["tcp", "rtu"])
def test_it_polls_and_moves_the_machine_once(
    bench: Bench, folder: Path, link: str
) -> None:
    where = describe_link(bench, link)
    target = {"tcp": 40_000, "rtu": 55_000}[link]  # 0.1 µm
    number = {"tcp": 1, "rtu": 2}[link]
    feed = 6_000_000
    row = [target, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, feed >> 16, feed & 0xFFFF, 0, 0]
    words = [int(Command.MOVE_TO), 0, 1, 0, 0, 0, *row]
    orders = ["setp mb2hal.watchdog.00 900"]
    orders += [f"setp mb2hal.order.{i:02d} {w}" for i, w in enumerate(words, 1)]
    orders += [f"setp mb2hal.order.00 {number}", "loadusr -w sleep 1"]

    pins = run_mb2hal(folder, where, orders)

    identity = [pins[f"identity.{i:02d}.int"] for i in range(5)]
    assert identity == [0x5450, 0x4331, 0x0102, 0x0304, 2]
    status = [pins[f"status.{i:02d}.int"] for i in range(24)]
    assert status[0] == FINISHED
    assert (status[5], status[6]) == (number, Result.DONE)
    assert status[12] << 16 | status[13] == target
    assert not any(count for pin, count in pins.items() if pin.endswith("num_errors"))
