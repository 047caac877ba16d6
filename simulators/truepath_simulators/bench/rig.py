"""Client of a running `truepath simulate`, over its control socket."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from truepath_simulators.errors import SimulatorError

_ANSWER_TIMEOUT_S = 10.0
_END_TIMEOUT_S = 10.0


class Rig:
    """One connection to a rig. Raises SimulatorError if the rig refuses an order.

    control : path of its socket, as given to `--control`
    """

    def __init__(self, control: Path | str) -> None:
        self.control = Path(control)
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(_ANSWER_TIMEOUT_S)
        try:
            self._socket.connect(str(control))
        except OSError as error:
            self._socket.close()
            raise SimulatorError(f"no rig answers at {control} ({error})") from error
        self._lines = self._socket.makefile("rb")
        self.links: dict[str, Any] = self.order("links")

    @property
    def tracker_options(self) -> dict[str, Any]:
        """Options for the factory of the tracker driver."""
        return self.links["tracker"]

    @property
    def motion_options(self) -> dict[str, Any]:
        """Options for the factory of the motion driver, over Modbus TCP."""
        return self.links["modbus_tcp"]

    def order(self, verb: str, **arguments: Any) -> dict[str, Any]:
        """Send any order; gives its answer."""
        line = json.dumps({"do": verb, **arguments})
        try:
            self._socket.sendall(line.encode() + b"\n")
            told = self._lines.readline()
        except OSError as error:
            raise SimulatorError(f"the rig does not answer ({error})") from error
        if not told:
            raise SimulatorError("the rig has ended")
        answer = json.loads(told)
        if not answer.pop("ok"):
            raise SimulatorError(answer["error"])
        return answer

    def inject(self, fault: str) -> None:
        self.order("inject", fault=fault)

    def move_tracker(self, place_mm: Sequence[float], number: int = 1) -> None:
        """Move the tracker to a position, with a new orientation by the number."""
        self.order("move-tracker", place_mm=list(place_mm), number=number)

    def load_compensation(
        self, files: Sequence[Path | str], **rules: str | bool | float
    ) -> list[str]:
        """Replace the controller's tables while its axes stand; gives their names.

        files : none removes its tables
        rules : `backlash_reading`, `reversed_sign`, `tool_length_mm`,
            `measuring_system` of `truepath_simulators.compensation.correction.Rules`
        """
        paths = [str(Path(file).absolute()) for file in files]
        return self.order("compensate", files=paths, **rules)["files"]

    def read_state(self) -> dict[str, Any]:
        """States that `tracker` and `cnc` report."""
        return self.order("state")

    def read_position(
        self, time_s: Sequence[float] | None = None, target: str = ""
    ) -> dict[str, Any]:
        """True axes and target: now, or at machine times."""
        when = {} if time_s is None else {"time_s": list(time_s)}
        return self.order("position", target=target, **when)

    def read_truth(self) -> dict[str, Any]:
        """Volumetric error on a grid, hidden effects, squareness, pose."""
        return self.order("truth")

    def truth_at(self, points: np.ndarray, direction: float = 1.0) -> np.ndarray:
        """True volumetric error, µm, at axis positions, (n, 3).

        With the loaded tables, all axes arriving in the direction.
        """
        rows = np.asarray(points, float).tolist()
        told = self.order("truth", points=rows, direction=direction)
        return np.array(told["deviation_um"])

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


@contextlib.contextmanager
def running_rig(options: Mapping[str, Any]) -> Iterator[Rig]:
    """A fresh rig that ends with the block, or with this process.

    options : those of `truepath simulate` without their dashes, `_` for `-`; True for
        one without a value, a list for one that may be given several times
    """
    with tempfile.TemporaryDirectory(prefix="truepath-rig-") as folder:
        control = Path(folder) / "control"
        process = subprocess.Popen(  # noqa: S603, our own module
            [
                *(sys.executable, "-m", "truepath_simulators.bench.command", "--json"),
                *("--control", str(control), "--links", folder),
                *spell(options),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )
        try:
            with contextlib.closing(_own(process, control)) as rig:
                yield rig
        finally:
            _end(process)


def spell(options: Mapping[str, Any]) -> list[str]:
    """Options as words of a command line."""
    words: list[str] = []
    for name, value in options.items():
        flag = "--" + name.replace("_", "-")
        values = value if isinstance(value, list | tuple) else [value]
        for one in values:
            words += [flag] if one is True else [flag, str(one)]
    return words


def _own(process: subprocess.Popen[bytes], control: Path) -> Rig:
    if process.stdout is None or not process.stdout.readline():
        raise SimulatorError("the rig did not start; why is on standard error")
    rig = Rig(control)
    rig.order("own")
    return rig


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
