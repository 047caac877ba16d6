"""Simulated devices as separate processes: both ends of their life line, and clocks.

The parent writes one line of JSON to standard input and reads one line of JSON with the
addresses from standard output. Every further line of input is a fault to inject, or a
request for the device's state, which is answered by one line of JSON. The process ends
when the input does: a parent that dies, by whatever signal, closes it.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from truepath_simulators.errors import SimulatorError

_BLOCK = 4096


def is_question(line: str) -> bool:
    """Whether a line of input requests the state."""
    return line.startswith('{"ask"')


class LifeLine:
    """Standard input of a simulator process."""

    def __init__(self) -> None:
        # Ctrl-C reaches the whole group; the parent decides what it means.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._end)
        self._parent = os.getppid()
        self._rest = b""
        self._ended = False
        self.descriptor = sys.stdin.fileno()

    @property
    def ended(self) -> bool:
        """Whether the parent has gone: end of input, SIGTERM, or another parent."""
        return self._ended or os.getppid() != self._parent

    def orders(self) -> dict[str, Any]:
        """First line of input; waits for it."""
        while b"\n" not in self._rest and not self._ended:
            self._read()
        line, _, self._rest = self._rest.partition(b"\n")
        os.set_blocking(self.descriptor, False)
        return json.loads(line or b"{}")

    def lines(self) -> list[str]:
        """Lines that have arrived since; never waits."""
        with contextlib.suppress(BlockingIOError):
            self._read()
        *lines, self._rest = self._rest.split(b"\n")
        return [line.decode() for line in lines]

    def report_failure(self, error: Exception) -> None:
        """Report to the parent why the device cannot listen."""
        self.report({"error": str(error)})

    def report(self, content: dict[str, Any]) -> None:
        """Report to the parent where the device listens, or its state."""
        sys.stdout.write(json.dumps(content) + "\n")
        sys.stdout.flush()

    def _read(self) -> None:
        data = os.read(self.descriptor, _BLOCK)
        self._ended = self._ended or not data
        self._rest += data

    def _end(self, _number: int, _frame: object) -> None:
        self._ended = True


@dataclass(frozen=True, slots=True)
class MachineClock:
    """Machine seconds since an epoch: the host's monotonic clock, sped up.

    The same in every process of the host.
    """

    epoch_ns: int
    speed: float

    def now_s(self) -> float:
        return (time.monotonic_ns() - self.epoch_ns) * 1e-9 * self.speed


class AwakeClock:
    """Wall seconds in which the process of a simulated device has run.

    A real device is never late, a simulated one may be suspended or starved with its
    host. While it did not run, no time limit of it ran either: a longer step between
    two readings counts as `late_s`.
    """

    def __init__(
        self, late_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._late_s, self._clock = late_s, clock
        self._read_s = self._now_s = clock()

    def __call__(self) -> float:
        """Seconds, counted at each call."""
        read_s = self._clock()
        self._now_s += min(read_s - self._read_s, self._late_s)
        self._read_s = read_s
        return self._now_s


_START_TIMEOUT_S = 20.0
_STOP_TIMEOUT_S = 3.0
_ANSWER_TIMEOUT_S = 3.0


class DeviceProcess:
    """One simulator process and its life line.

    module : module of `truepath_simulators` that it runs
    descriptors : inherited by it
    """

    def __init__(
        self, module: str, orders: Mapping[str, Any], descriptors: Sequence[int] = ()
    ) -> None:
        self._name = module.rpartition(".")[2].removesuffix("_process")
        # Many small matrices: threads of a BLAS would only fight for the cores.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(  # noqa: S603, our own module
            [sys.executable, "-m", f"truepath_simulators.{module}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            pass_fds=descriptors,
            env=environment,
        )
        self._rest = b""
        self.tell(json.dumps(orders))

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def tell(self, line: str) -> None:
        """Send a line. Raises SimulatorError if the process has ended."""
        if self._process.stdin is None:
            raise SimulatorError(f"the simulated {self._name} is closed")
        try:
            self._process.stdin.write(line.encode() + b"\n")
        except (BrokenPipeError, ValueError) as error:
            raise SimulatorError(f"the simulated {self._name} has ended") from error

    def listening(self) -> dict[str, Any]:
        """Address of the device; waits until it listens. Raises SimulatorError."""
        report = self._read_report(_START_TIMEOUT_S)
        if "error" in report:
            raise SimulatorError(f"the simulated {self._name}: {report['error']}")
        return report

    def query_state(self) -> dict[str, Any]:
        """State that the device reports."""
        self.tell(json.dumps({"ask": "state"}))
        return self._read_report(_ANSWER_TIMEOUT_S)

    def release(self) -> None:
        """Close the life line, so that the process ends."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    def end(self) -> None:
        """Wait for the end; kill the process if it takes longer."""
        try:
            self._process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read_report(self, timeout_s: float) -> dict[str, Any]:
        stdout = self._process.stdout
        if stdout is None:
            raise SimulatorError(f"the simulated {self._name} is closed")
        deadline_s = time.monotonic() + timeout_s
        while b"\n" not in self._rest:
            left_s = max(deadline_s - time.monotonic(), 0.0)
            ready, _, _ = select.select([stdout], [], [], left_s)
            part = os.read(stdout.fileno(), 4096) if ready else b""
            if not part:
                raise SimulatorError(
                    f"the simulated {self._name} does not answer; "
                    f"its last words are on standard error"
                )
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\n")
        return json.loads(line)


class DeviceProcesses:
    """The processes of a rig, each behind its links, from `start` to `close`.

    workdir : holds the links `tracker` and `modbus-rtu` to the terminals

    Deriving classes fill `_processes` and `_addresses` in `start`.
    """

    has_rtu = False

    def __init__(
        self,
        workdir: Path | None,
        *,
        tracker: str,
        host: str,
        tracker_port: int,
        modbus_port: int,
        rtu: bool,
    ) -> None:
        self._workdir = workdir
        self._own_workdir: tempfile.TemporaryDirectory[str] | None = None
        self._tracker_link = {"kind": tracker, "host": host, "port": tracker_port}
        self._cnc_link = {"host": host, "port": modbus_port, "rtu": rtu}
        self._processes: dict[str, DeviceProcess] = {}
        self._addresses: dict[str, dict[str, Any]] = {}

    def start(self) -> Self:
        """Start all; blocks until they listen. Raises SimulatorError if one fails."""
        raise NotImplementedError

    @property
    def machine(self) -> Mapping[str, Any]:
        """Content of machine.json."""
        raise NotImplementedError

    @property
    def has_motion(self) -> bool:
        """Whether there is a CNC."""
        return "tcp" in self._addresses.get("cnc", {})

    @property
    def tracker_options(self) -> dict[str, Any]:
        """Options for the factory of the tracker driver."""
        return dict(self._addresses["tracker"])

    @property
    def motion_options(self) -> dict[str, Any]:
        """Options for the factory of the motion driver, over Modbus TCP."""
        return {**self._addresses["cnc"]["tcp"], "unit": 1}

    @property
    def motion_options_rtu(self) -> dict[str, Any]:
        """Options for the factory of the motion driver, over Modbus RTU."""
        return {**self._addresses["cnc"]["rtu"], "baudrate": 115_200, "unit": 1}

    @property
    def thermometer_options(self) -> dict[str, Any]:
        """Options for the factory of the driver of thermometers; empty without any."""
        return dict(self._addresses.get("cnc", {}).get("thermometers", {}))

    @property
    def process_ids(self) -> dict[str, int]:
        return {name: process.process_id for name, process in self._processes.items()}

    @property
    def alive(self) -> bool:
        return bool(self._processes) and all(
            process.alive for process in self._processes.values()
        )

    def read_state(self) -> dict[str, Any]:
        """State of every device by name."""
        return {
            name: process.query_state() for name, process in self._processes.items()
        }

    def describe(self) -> dict[str, Any]:
        """Addresses of the devices, name of the machine, process identifiers."""
        where: dict[str, Any] = {"tracker": self.tracker_options}
        if self.has_motion:
            where["modbus_tcp"] = self.motion_options
        if self.has_rtu:
            where["modbus_rtu"] = self.motion_options_rtu
        if self.thermometer_options:
            where["thermometers"] = self.thermometer_options
        return where | {
            "machine": self.machine.get("name", ""),
            "pids": self.process_ids,
        }

    def close(self) -> None:
        """End all processes and wait for them. Idempotent."""
        for process in self._processes.values():
            process.release()
        for process in self._processes.values():
            process.end()
        self._processes = {}
        if self._own_workdir is not None:
            self._own_workdir.cleanup()
            self._own_workdir = None

    def _place_links(self) -> dict[str, dict[str, Any]]:
        """Links of both devices, in `workdir` or a folder of their own."""
        folder = self._workdir
        if folder is None:
            name = type(self).__name__.lower()
            self._own_workdir = tempfile.TemporaryDirectory(prefix=f"truepath-{name}-")
            folder = Path(self._own_workdir.name)
        folder.mkdir(parents=True, exist_ok=True)
        return {
            "cnc": self._cnc_link | {"rtu_symlink": str(folder / "modbus-rtu")},
            "tracker": self._tracker_link | {"symlink": str(folder / "tracker")},
        }

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()
