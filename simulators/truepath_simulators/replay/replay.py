"""The devices of any recorded Run."""

from __future__ import annotations

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
        super().__init__(
            workdir,
            tracker=tracker,
            host=host,
            tracker_port=tracker_port,
            modbus_port=modbus_port,
            rtu=rtu,
        )
        if speed <= 0.0:
            raise SimulatorError(f"speed: {speed} is not above zero")
        self._run, self._speed = run, speed
        self._content: Mapping[str, Any] = {}

    @property
    def machine(self) -> Mapping[str, Any]:
        """Content of machine.json, known after `start`."""
        return self._content

    def start(self) -> Self:
        """Read the Run and listen. Raises SimulatorError if it cannot be repeated."""
        links = {f"{name}_link": link for name, link in self._place_links().items()}
        orders = {"run": str(self._run), "speed": self._speed, **links}
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
