"""The Modbus driver against a CNC on libmodbus, over TCP and over RTU by socat.

The C program beside this file was written from the page of the register map; its wire
is libmodbus's. Debian: apt-get install gcc libc6-dev libmodbus-dev socat.
"""

import shutil
import subprocess
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path as FilePath

import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.conformance import motion
from truepath_drivers.interfaces import errors, records

CHECKS = motion.MOTION_CHECKS
SLOW = (motion.hold_and_resume_are_absolute,)
SOURCE = FilePath(__file__).with_name("register_map_server.c")


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """Compile the server; fails, naming the packages, where that is not possible."""
    if not FilePath("/usr/include/modbus/modbus.h").exists() or not shutil.which("cc"):
        pytest.fail("libmodbus is absent: apt-get install gcc libc6-dev libmodbus-dev")
    built = tmp_path_factory.mktemp("libmodbus") / "register_map_server"
    command = ["cc", "-O1", "-Wall", "-Werror", "-o", built, SOURCE, "-lmodbus", "-lm"]
    subprocess.run(command, check=True, timeout=60)
    return built


class Server:
    """A running server; `tell` gives it a line and waits until it has taken it."""

    def __init__(self, process, options):
        self.process, self.options = process, options

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"


@contextmanager
def start(*command):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True) as process:
        try:
            yield process, process.stdout.readline().split()
        finally:
            process.kill()


@contextmanager
def serve_tcp(program, order="abcd", clients=4):
    with start(program, "tcp", str(clients), order) as (process, said):
        yield Server(process, {"host": "127.0.0.1", "port": int(said[1])})


@contextmanager
def serve_rtu(program, folder, until):
    if shutil.which("socat") is None:
        pytest.fail("socat is absent: apt-get install socat")
    ends = [folder / "device", folder / "host"]
    pair = [f"PTY,raw,echo=0,link={end}" for end in ends]
    with subprocess.Popen(["socat", *pair]) as socat:
        try:
            until(lambda: all(end.exists() for end in ends))
            with start(program, "rtu", ends[0], "115200") as (process, said):
                assert said == ["ready"]
                yield Server(process, {"serial_port": str(ends[1])})
        finally:
            socat.terminate()


@pytest.fixture
def server(request, program, tmp_path, until):

    is_tcp = getattr(request, "param", "tcp") == "tcp"
    over_rtu = serve_rtu(program, tmp_path, until)
    with serve_tcp(program) if is_tcp else over_rtu as server:
        yield server


@pytest.fixture
def controller(server):
    with ModbusController(**server.options) as controller:
        yield controller


@pytest.mark.parametrize(
    "check",
    [pytest.param(c, marks=pytest.mark.long) if c in SLOW else c for c in CHECKS],
)
def test_the_driver_keeps_its_promises_on_it(check, server):
    check(lambda: ModbusController(**server.options))


@pytest.mark.parametrize("order", ["libmodbus", "badc", "cdab", "dcba"])
@pytest.mark.fault_row(18)
def test_what_libmodbus_calls_an_order_is_taken_or_told(program, order):
    """Its `abcd` swaps bytes on x86 in 3.1.6, and its `badc` does not."""
    with serve_tcp(program, order) as server:
        shown = read_raw(server, 2, 2)
        controller = ModbusController(**server.options)
        if shown == [0x0102, 0x0304]:
            assert controller.connect().maker == "libmodbus"
            controller.close()
            return
        told = {
            (0x0201, 0x0403): "low byte first; set it to high byte first",
            (0x0304, 0x0102): "low word first; set it to high word first",
            (0x0403, 0x0201): "words and bytes swapped; set it to big-endian",
        }
        with pytest.raises(errors.WrongDevice, match=told[tuple(shown)]):
            controller.connect()


def read_raw(server, address, count):
    if shutil.which("mbpoll") is None:
        pytest.fail("mbpoll is absent: apt-get install mbpoll")
    device = f"mbpoll -m tcp -p {server.options['port']} -a 1 -0 -t 4:hex"
    words = f"{device} -r {address} -c {count} -1 127.0.0.1".split()
    done = subprocess.run(words, capture_output=True, text=True, timeout=10)
    lines = [line for line in done.stdout.splitlines() if line.startswith("[")]
    assert len(lines) == count, done.stdout + done.stderr
    return [int(line.split()[-1], 16) for line in lines]


@pytest.mark.parametrize("server", ["tcp", "rtu"], indirect=True)
def test_a_slow_gateway_is_waited_for_and_one_too_slow_told_in_time(server, controller):
    controller.connect()
    server.tell("delay 120")
    controller.move_to([1, 1, -1], 6000)
    assert controller.wait(5.0).position == pytest.approx((1, 1, -1))
    server.tell("delay 450")
    began_s = time.monotonic()
    with pytest.raises(errors.DeviceTimeout, match=r"no valid reply in 0\.\d s"):
        controller.status()
    assert time.monotonic() - began_s < 0.9  # no second reply is waited for
    server.tell("delay 0")  # taken once all that was late has gone out
    controller.move_to([2, 1, -1], 6000)
    assert controller.wait(5.0).position == pytest.approx((2, 1, -1))


def test_a_second_master_reads_while_the_first_drives(server, controller):
    controller.move_to([10, 1, -1], 900)
    assert read_raw(server, 100, 1) == [2]
    assert controller.wait(5.0).state is records.MotionState.FINISHED


def test_a_device_for_one_master_at_a_time_says_so_by_silence(program, until):
    with ExitStack() as stack:
        server = stack.enter_context(serve_tcp(program, clients=1))
        first = stack.enter_context(ModbusController(**server.options))
        first.connect()
        second = ModbusController(**server.options)
        with pytest.raises(errors.DeviceTimeout, match="no valid reply"):
            second.connect()
        first.close()
        until(lambda: connects(second))
        second.close()


def connects(controller):
    with suppress(errors.DeviceTimeout):
        return controller.connect().maker == "libmodbus"
