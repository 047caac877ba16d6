"""The devices of any recorded Run."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

from truepath_simulators.errors import SimulatorError
from truepath_simulators.processes import DeviceProcess, DeviceProcesses


class Replay(DeviceProcesses):
    """The devices of a Run behind real links: the same bytes, the same motions.

    run : file of a closed Run that was recorded with bytes of the tracker's link
    speed : seconds of the recording per wall second
    workdir : holds the links `tracker` and `modbus-rtu` to the terminals
    """

    def __init__(
        self,
        run: Path,
        speed: float = 1.0,
        workdir: Path | None = None,
        *,
        tracker: Literal["pty", "tcp"] = "pty",
        host: str = "127.0.0.1",
        tracker_port: int = 0,
        modbus_port: int = 0,
        rtu: bool = True,
    ) -> None:
        super().__init__()
        if speed <= 0.0:
            raise SimulatorError(f"speed: {speed} is not above zero")
        self._run, self._speed, self._workdir = run, speed, workdir
        self._tracker_link = {"kind": tracker, "host": host, "port": tracker_port}
        self._cnc_link = {"host": host, "port": modbus_port, "rtu": rtu}
        self._own_workdir: tempfile.TemporaryDirectory[str] | None = None
        self._content: Mapping[str, Any] = {}

    @property
    def machine(self) -> Mapping[str, Any]:
        """Content of machine.json, known after `start`."""
        return self._content

    def start(self) -> Self:
        """Read the Run and listen. Raises SimulatorError if it cannot be repeated."""
        folder = self._folder()
        tracker_link = self._tracker_link | {"symlink": str(folder / "tracker")}
        cnc_link = self._cnc_link | {"rtu_symlink": str(folder / "modbus-rtu")}
        orders = {
            "run": str(self._run),
            "speed": self._speed,
            "tracker_link": tracker_link,
            "cnc_link": cnc_link,
        }
        try:
            process = DeviceProcess("replay.replay_process", orders)
            self._processes["replay"] = process
            told = process.listening()
        except BaseException:
            self.close()
            raise
        self._addresses = {"tracker": told["tracker"], "cnc": told["cnc"]}
        self._content, self._told = told["machine"], told["run"]
        self.has_rtu = "rtu" in told["cnc"]
        return self

    def describe(self) -> dict[str, Any]:
        """Addresses of the devices, and properties of the replay."""
        return {**super().describe(), "replay": self._told}

    def close(self) -> None:
        super().close()
        if self._own_workdir is not None:
            self._own_workdir.cleanup()
            self._own_workdir = None

    def _folder(self) -> Path:
        if self._workdir is not None:
            self._workdir.mkdir(parents=True, exist_ok=True)
            return self._workdir
        self._own_workdir = tempfile.TemporaryDirectory(prefix="truepath-replay-")
        return Path(self._own_workdir.name)
