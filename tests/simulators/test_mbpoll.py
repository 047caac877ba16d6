"""The simulated CNC in the hands of a Modbus master that is not ours: mbpoll."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from truepath_drivers.cnc.modbus.registers import BY_NAME, Command, Result
from truepath_simulators.bench.bench import Bench

Poll = Callable[..., str]


@pytest.fixture(scope="module")
def mbpoll() -> str:
    found = shutil.which("mbpoll")
    if found is None:
        pytest.fail(
            "mbpoll is not installed; it proves the Modbus map from outside: "
            "apt-get install mbpoll"
        )
    return found


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench(seed=1, tracker="tcp") as running:
        yield running


@pytest.fixture(params=["tcp", "rtu"])
def poll(request: pytest.FixtureRequest, mbpoll: str, bench: Bench) -> Poll:
    """Call mbpoll once with options, on the register of a name."""
    if request.param == "tcp":
        where = bench.motion_options
        link = ["-m", "tcp", "-p", str(where["port"])]
        end = [where["host"]]
    else:
        where = bench.motion_options_rtu
        link = ["-m", "rtu", "-b", str(where["baudrate"]), "-P", "none"]
        end = [where["serial_port"]]

    def polled(name: str, *options: str, values: tuple[int, ...] = ()) -> str:
        address = str(BY_NAME[name].address)
        once = [] if values else ["-1"]
        done = subprocess.run(
            [mbpoll, *link, "-a", "1", "-0", "-r", address, *options, *once, *end]
            + [str(v) for v in values],
            capture_output=True,
            text=True,
            timeout=10,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return polled


def numbers(text: str) -> list[int]:
    """Return the values of lines such as `[100]:  0x5450` or `[112]:  1000 (…)`."""
    return [int(v, 0) for v in re.findall(r"^\[\d+\]:\s+(\S+)", text, re.MULTILINE)]


def next_number(poll: Poll) -> int:
    return numbers(poll("command_ack", "-t", "4", "-c", "1"))[0] + 1


def order(poll: Poll, verb: Command, *arguments: int) -> Result:
    """Give a command as one does by hand: one write, then a look at the result."""
    number = next_number(poll)
    poll("command_sequence", "-t", "4", values=(number, int(verb), *arguments))
    ack, result = numbers(poll("command_ack", "-t", "4", "-c", "2"))
    assert ack == number
    return Result(result)


def test_it_reads_the_identity(poll: Poll) -> None:
    assert numbers(poll("magic", "-t", "4:hex", "-c", "5")) == [
        0x5450,
        0x4331,
        0x0102,
        0x0304,
        2,
    ]


def test_it_reads_positions_and_travel(poll: Poll) -> None:
    assert len(numbers(poll("position", "-t", "4:int", "-B", "-c", "3"))) == 3
    travel = numbers(poll("travel_max", "-t", "4:int", "-B", "-c", "3"))
    assert travel == [5_000_000, 4_000_000, 3_000_000]


def test_it_writes_what_it_reads_back(poll: Poll) -> None:
    poll("watchdog", "-t", "4", values=(750,))
    assert numbers(poll("watchdog", "-t", "4", "-c", "1")) == [750]
    poll("watchdog", "-t", "4", values=(1000,))
    poll("heartbeat", "-t", "4", values=(77,))
    assert numbers(poll("heartbeat", "-t", "4", "-c", "1")) == [77]


def test_it_gives_commands(poll: Poll) -> None:
    assert order(poll, Command.RESUME) is Result.DONE
    assert order(poll, Command.START, 0, 0, 0, 0) is Result.NO_PATH
    assert order(poll, Command.PUT_ROWS, 0, 0, 0, 0) is Result.BAD_ARGUMENT
    assert order(poll, Command.RESET) is Result.DONE


def test_it_moves_an_axis(poll: Poll, bench: Bench) -> None:
    here = numbers(poll("position", "-t", "4:int", "-B", "-c", "1"))[0]
    x = here + 20_000  # 2 mm
    feed = 6_000_000  # 6000 mm/min
    row = [x >> 16, x & 0xFFFF, *[0] * 10, feed >> 16, feed & 0xFFFF, 0, 0]
    assert order(poll, Command.MOVE_TO, 0, 0, 0, 0, *row) is Result.DONE
    deadline_s = time.monotonic() + 5.0
    while here != x and time.monotonic() < deadline_s:
        here = numbers(poll("position", "-t", "4:int", "-B", "-c", "1"))[0]
    assert here == x


def test_what_is_not_there_is_an_exception(mbpoll: str, bench: Bench) -> None:
    where = bench.motion_options
    done = subprocess.run(
        f"{mbpoll} -m tcp -p {where['port']} -0 -t 4 -r 900 -1 {where['host']}".split(),
        capture_output=True,
        text=True,
        timeout=10,
    )
    assert "Illegal data address" in done.stdout + done.stderr
