"""One LinuxCNC from start to end, in separate namespaces.

It has its own network, shared memory, processes and /tmp, so several may run at once
and nothing is left behind. From outside it is reached through ports of this computer
that are connected to its ports.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from truepath_drivers.cnc import linuxcnc
from truepath_simulators.errors import SimulatorError
from truepath_simulators.linuxcnc.files import LinuxCncMachine

RSH_PORT, WATCHDOG_PORT, GATEWAY_PORT = 5007, 5017, 5020
_BESIDE_DRIVER = Path(linuxcnc.__file__).parent
_START_S = 30.0
_STOP_S = 10.0
_NAMESPACES = "unshare --net --ipc --mount --pid --fork --kill-child --mount-proc"
# $1 is kept of a /tmp that is empty otherwise: the project, where it lies there.
_ISOLATED = """
set -e
kept=$1; shift
mount --make-rprivate /
if [ -n "$kept" ]; then mkdir kept; mount --bind "$kept" kept; fi
mount -t tmpfs -o mode=1777 tmpfs /tmp
if [ -n "$kept" ]; then mkdir -p "$kept"; mount --bind kept "$kept"; fi
ip link set lo up
exec "$@"
"""
_PROJECT = Path(__file__).resolve().parents[3]


def explain_absence() -> str:
    """Reason why no LinuxCNC can be started here; empty if one can."""
    if shutil.which("linuxcnc") is None:
        return "Debian's linuxcnc-uspace is not installed"
    probe = [*_NAMESPACES.split(), "true"]
    if os.getuid() or subprocess.run(probe, capture_output=True).returncode:  # noqa: S603
        return "a LinuxCNC of its own needs root and namespaces"
    return ""


class LinuxCncRig:
    """A running LinuxCNC, from `start` to `close`.

    watchdog : whether the watchdog of Truepath's driver is loaded
    samples : whether `positions` gives sample number, motor and commanded positions of
        all joints, a line per millisecond
    gateway : machine file whose travel the register map over Modbus TCP offers; it
        needs the watchdog
    """

    def __init__(
        self,
        machine: LinuxCncMachine,
        *,
        watchdog: bool = True,
        samples: bool = False,
        gateway: Mapping[str, Any] | None = None,
    ) -> None:
        self._machine, self._watchdog, self._samples = machine, watchdog, samples
        self._gateway = gateway
        self._ports = [RSH_PORT, *[WATCHDOG_PORT] * watchdog]
        self._ports += [GATEWAY_PORT] * (gateway is not None)
        self._process: subprocess.Popen[str] | None = None
        self._addresses: dict[int, int] = {}
        self.positions = -1
        self.folder = Path()

    def start(self) -> Self:
        """Start it; blocks until its ports answer. Raises SimulatorError if none do."""
        # Not below /tmp, which is empty for what runs inside.
        self.folder = Path(tempfile.mkdtemp(prefix="linuxcnc-", dir="/var/tmp"))
        try:
            self._write_files()
            self._start_process()
            self._wait_until_ready()
        except BaseException:
            self.close()
            raise
        return self

    def address(self, port: int = RSH_PORT) -> tuple[str, int]:
        """Host and port that are connected to a port inside."""
        return "127.0.0.1", self._addresses[port]

    @property
    def motion_options(self) -> dict[str, Any]:
        """Options for the factory of the motion driver."""
        host, port = self.address()
        options: dict[str, Any] = {
            "host": host,
            "port": port,
            "program_folder": str(self.folder / "programs"),
        }
        if self._watchdog:
            options["watchdog_port"] = self.address(WATCHDOG_PORT)[1]
        return options

    @property
    def modbus_options(self) -> dict[str, Any]:
        """Options of the driver `modbus` for the gateway."""
        return dict(zip(("host", "port"), self.address(GATEWAY_PORT), strict=True))

    @property
    def log(self) -> str:
        """Output of LinuxCNC; empty before the start."""
        file = self.folder / "run.log"
        return file.read_text(errors="replace") if file.exists() else ""

    def close(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            process.stdin.close()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        if self.positions >= 0:
            os.close(self.positions)
            self.positions = -1
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write_files(self) -> None:
        self.folder.chmod(0o755)
        for name in ("run", "programs"):
            (self.folder / name).mkdir()
        (self.folder / "run").chmod(0o1777)
        for name, text in self._machine.write_files(watchdog=self._watchdog).items():
            (self.folder / name).write_text(text)
        copied = [Path(__file__).with_name("inside.py")]
        if self._watchdog:
            beside = ("truepath.hal", "truepath_watchdog.py")
            copied += [_BESIDE_DRIVER / name for name in beside]
        for file in copied:
            shutil.copy(file, self.folder)

    def _start_process(self) -> None:
        servers = [socket.create_server(("127.0.0.1", 0)) for _ in self._ports]
        self._addresses = {
            port: server.getsockname()[1]
            for port, server in zip(self._ports, servers, strict=True)
        }
        given = [server.fileno() for server in servers]
        orders = {
            "ports": list(zip(given, self._ports, strict=True)),
            "positions": None,
        }
        if self._gateway is not None:
            folder = str(self.folder / "programs")
            asked = {"machine": dict(self._gateway), "folder": folder}
            module = "truepath_simulators.linuxcnc.gateway"
            orders["gateway_port"] = GATEWAY_PORT
            orders["gateway"] = [sys.executable, "-m", module, json.dumps(asked)]
        written = -1
        if self._samples:
            self.positions, written = os.pipe()
            orders["positions"] = written
            given.append(written)
        kept = str(_PROJECT) if _PROJECT.is_relative_to("/tmp") else ""  # noqa: S108
        command = [*_NAMESPACES.split(), "sh", "-c", _ISOLATED, "sh", kept]
        fifo = self.folder / "run" / "fifo"
        self._process = subprocess.Popen(  # noqa: S603, our own script
            [*command, "/usr/bin/python3", "inside.py", json.dumps(orders)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=given,
            cwd=self.folder,
            env={
                "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
                "HOME": str(self.folder),
                "RTAPI_UID": "65534",
                "RTAPI_FIFO_PATH": str(fifo),
            },
            text=True,
        )
        for server in servers:
            server.close()
        if written >= 0:
            os.close(written)

    def _wait_until_ready(self) -> None:
        stdout = self._process.stdout if self._process else None
        if stdout is None:
            raise SimulatorError("LinuxCNC was not started")
        ready, _, _ = select.select([stdout], [], [], _START_S)
        answer = stdout.readline().strip() if ready else ""
        if answer != "ready":
            raise SimulatorError(
                f"LinuxCNC did not start: {answer or 'no answer'}\n{self.log[-2000:]}"
            )
