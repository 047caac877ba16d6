"""Compensation files in the controls of simulated machines, and of no others.

Tables are loaded into a real control at that control, by a person who watches the
effect. A simulated one can be loaded here, so that the way from as found to as left can
be tested from end to end.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from truepath.catalogue.errors import NotSimulated
from truepath.compensation.stored_files import find_file, read_account
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine


class SimulatedControl(Protocol):
    """A simulated control that takes tables while its axes are at rest."""

    def load_compensation(
        self, compensation: Sequence[Path | str], rules: Mapping[str, Any] | None = None
    ) -> None:
        """Replace all files; rules : settings of the control for them.

        Raises ValueError where it refuses them.
        """
        ...


@dataclass(frozen=True, slots=True)
class LoadedFiles:
    """What a simulated control has from this service; nothing at first.

    job_id, compensation_id : the result and the files that were made of it
    """

    job_id: str | None = None
    compensation_id: str | None = None
    files: tuple[str, ...] = ()
    files_sha256: Mapping[str, str] = field(default_factory=dict[str, str])


class SimulatedControls:
    """By machine; thread-safe."""

    def __init__(self, controls: Mapping[str, SimulatedControl] | None = None) -> None:
        self._lock = threading.Lock()
        self._controls = dict(controls or {})
        self._loaded: dict[str, LoadedFiles] = {}

    def read(self, machine_id: str) -> LoadedFiles:
        """Empty for a real control."""
        with self._lock:
            return self._loaded.get(machine_id, LoadedFiles())

    def is_simulated(self, machine_id: str) -> bool:
        """Whether the control of a machine is a simulated one."""
        return machine_id in self._controls

    def require(self, machine_id: str) -> SimulatedControl:
        """Raises NotSimulated."""
        if machine_id not in self._controls:
            raise NotSimulated(machine_id)
        return self._controls[machine_id]

    def load(
        self,
        machine_id: str,
        machine: Machine,
        folder: Path,
        job_id: str,
        compensation_id: str,
    ) -> LoadedFiles:
        """Load stored files into the control in place of the present ones.

        folder : of the files that are stored with the result of the job

        Raises NotSimulated, NotFound, BadInput where they are of another machine or the
        control refuses them.
        """
        control = self.require(machine_id)
        account = read_account(folder, compensation_id)
        if account["machine"] != machine.name:
            raise BadInput(
                f"compensation {compensation_id} is of machine {account['machine']}, "
                f"not of {machine.name}; name files of a result of this machine"
            )
        places = [find_file(folder, compensation_id, n) for n in account["files"]]
        digests = account.get("files_sha256", {})
        loaded = LoadedFiles(job_id, compensation_id, tuple(account["files"]), digests)
        self._give(control, machine_id, places, _choose_rules(account), loaded)
        return loaded

    def clear(self, machine_id: str) -> None:
        """Remove the tables of a control. Raises NotSimulated, BadInput."""
        control = self.require(machine_id)
        self._give(control, machine_id, [], {}, LoadedFiles())

    def _give(
        self,
        control: SimulatedControl,
        machine_id: str,
        places: Sequence[Path],
        rules: Mapping[str, Any],
        loaded: LoadedFiles,
    ) -> None:
        with self._lock:
            try:
                control.load_compensation(places, rules)
            except ValueError as error:
                raise BadInput(f"the simulated control refuses: {error}") from error
            self._loaded[machine_id] = loaded


def _choose_rules(account: Mapping[str, Any]) -> dict[str, str | float | int]:
    choices, rules = account["choices"], dict[str, str | float | int]()
    if "backlash_reading" in choices:
        rules["backlash_reading"] = choices["backlash_reading"]
    if "measuring_system" in choices:
        rules["measuring_system"] = choices["measuring_system"]
    if choices.get("tool_length") == "followed":
        rules["tool_length_mm"] = abs(float(account["holds_for"]["offset_mm"][2]))
    return rules
