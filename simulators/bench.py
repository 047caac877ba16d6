"""Tracker and CNC as processes, ready to be driven by demonstrations and tests."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from simulators.board import new_board
from simulators.errors import SimulatorError
from simulators.faults import parse_fault
from simulators.hidden.drawing import as_json, parse_hidden
from simulators.hidden.effect import HiddenEffect
from simulators.machine_file import parse_machine
from simulators.profile import Limits
from simulators.random_machine import random_machine
from simulators.scenario import load_machine
from simulators.tracker_head import random_clock
from simulators.truth_machine import TruthMachine

_START_TIMEOUT_S = 20.0
_STOP_TIMEOUT_S = 3.0


class Bench:
    """A simulated machine with its tracker, behind real links.

    machine : content of machine.json; the bundled demonstration machine without it
    speed : device clocks run so many times faster than the wall clock; the patience of
        links (keep-alive, watchdog) stays in wall seconds
    faults : see `simulators.faults`; `inject` adds more while it runs
    workdir : holds the links `tracker` and `modbus-rtu` to the terminals
    tracker : link of the tracker, `pty` or `tcp`
    hidden : effects that no rigid-body model knows, or `name[*size_um]`, drawn by the
        seed; their time begins with the bench
    """

    def __init__(
        self,
        machine: Mapping[str, Any] | None = None,
        seed: int = 1,
        speed: float = 1.0,
        faults: Sequence[str] = (),
        workdir: Path | None = None,
        *,
        tracker: Literal["pty", "tcp"] = "pty",
        host: str = "127.0.0.1",
        tracker_port: int = 0,
        modbus_port: int = 0,
        error_scale: float = 1.0,
        limits: Limits | None = None,
        rtu: bool = True,
        hidden: Sequence[HiddenEffect | str] = (),
    ) -> None:
        if speed <= 0.0:
            raise SimulatorError(f"speed: {speed} is not above zero")
        self.machine = dict(machine) if machine is not None else load_machine("demo")
        nominal = parse_machine(self.machine)
        self.truth: TruthMachine = random_machine(nominal, seed, scale=error_scale)
        self.hidden = tuple(
            parse_hidden(one, seed, nominal) if isinstance(one, str) else one
            for one in hidden
        )
        self._clock = random_clock(seed)
        self._faults = [(parse_fault(text).device, text) for text in faults]
        self._workdir = workdir
        self._own_workdir: tempfile.TemporaryDirectory[str] | None = None
        self._tracker_link = {"kind": tracker, "host": host, "port": tracker_port}
        self._cnc_link = {"host": host, "port": modbus_port, "rtu": rtu}
        self.has_rtu = rtu
        self._common = {
            "machine": self.machine,
            "seed": seed,
            "speed": speed,
            "error_scale": error_scale,
            "limits": asdict(limits or Limits()),
            "hidden": [as_json(effect) for effect in self.hidden],
        }
        self._children: dict[str, _Child] = {}
        self._addresses: dict[str, dict[str, Any]] = {}

    def start(self) -> Self:
        """Start both processes; returns when both listen.

        Raises SimulatorError if one does not come up.
        """
        folder = self._folder()
        board = new_board()
        self._common |= {"epoch_ns": time.monotonic_ns(), "board": board}
        tracker_link = self._tracker_link | {"symlink": str(folder / "tracker")}
        cnc_link = self._cnc_link | {
            "rtu_symlink": str(folder / "modbus-rtu"),
        }
        try:
            for device, link in (("cnc", cnc_link), ("tracker", tracker_link)):
                faults = [text for name, text in self._faults if name == device]
                orders = self._common | {"link": link, "faults": faults}
                self._children[device] = _Child(device, orders, board)
            for device, child in self._children.items():
                self._addresses[device] = child.listening()
        except BaseException:
            self.close()
            raise
        finally:
            os.close(board)
        return self

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
    def process_ids(self) -> dict[str, int]:
        """Process identifiers of `tracker` and `cnc`."""
        return {device: child.process_id for device, child in self._children.items()}

    @property
    def alive(self) -> bool:
        """Whether both processes run."""
        return len(self._children) == 2 and all(
            child.alive for child in self._children.values()
        )

    def inject(self, fault: str) -> None:
        """Let a fault begin now, or as long after now as it says."""
        self._children[parse_fault(fault).device].tell(fault)

    def move_tracker(self, place_mm: Sequence[float], number: int = 1) -> None:
        """Set the tracker down at a place, turned and tilted anew by the number."""
        place = [float(v) for v in place_mm]
        self._children["tracker"].tell(json.dumps({"place": place, "number": number}))

    def truth_at(self, points_mm: np.ndarray) -> np.ndarray:
        """Return the true volumetric error in µm at axis positions, (n, 3)."""
        return 1e3 * self.truth.deviation_mm(np.asarray(points_mm, float))

    def hidden_truth(self) -> list[dict[str, Any]]:
        """Return the hidden effects in the form of `discovery.json`."""
        return [effect.truth(self._clock) for effect in self.hidden]

    def close(self) -> None:
        """End both processes and wait for them. Idempotent."""
        for child in self._children.values():
            child.release()
        for child in self._children.values():
            child.end(_STOP_TIMEOUT_S)
        self._children = {}
        if self._own_workdir is not None:
            self._own_workdir.cleanup()
            self._own_workdir = None

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _folder(self) -> Path:
        if self._workdir is not None:
            self._workdir.mkdir(parents=True, exist_ok=True)
            return self._workdir
        self._own_workdir = tempfile.TemporaryDirectory(prefix="truepath-bench-")
        return Path(self._own_workdir.name)


class _Child:
    """One simulator process and its life line."""

    def __init__(self, device: str, orders: Mapping[str, Any], board: int) -> None:
        self._device = device
        # Many small matrices: threads of a BLAS would only fight for the cores.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(  # noqa: S603, our own module
            [sys.executable, "-m", f"simulators.{device}_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            pass_fds=[board],
            env=environment,
        )
        self.tell(json.dumps(orders))

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def tell(self, line: str) -> None:
        if self._process.stdin is None:
            raise SimulatorError(f"the simulated {self._device} is closed")
        try:
            self._process.stdin.write(line.encode() + b"\n")
        except BrokenPipeError as error:
            raise SimulatorError(f"the simulated {self._device} has ended") from error

    def listening(self) -> dict[str, Any]:
        """Wait until the process listens; return where."""
        stdout = self._process.stdout
        if stdout is None:
            raise SimulatorError(f"the simulated {self._device} is closed")
        deadline_s = time.monotonic() + _START_TIMEOUT_S
        line = b""
        while not line.endswith(b"\n"):
            left_s = max(deadline_s - time.monotonic(), 0.0)
            ready, _, _ = select.select([stdout], [], [], left_s)
            part = os.read(stdout.fileno(), 4096) if ready else b""
            if not part:
                raise SimulatorError(
                    f"the simulated {self._device} did not start; "
                    f"its last words are on standard error"
                )
            line += part
        report = json.loads(line)
        if "error" in report:
            raise SimulatorError(f"the simulated {self._device}: {report['error']}")
        return report

    def release(self) -> None:
        """Let go of the life line; the process ends by itself."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    def end(self, timeout_s: float) -> None:
        """Wait for the end, with force if it takes longer."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
