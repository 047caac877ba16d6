"""The machines that the service controls, each with the cell that holds its devices."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass

from truepath.catalogue.errors import NoMachine, UnnamedMachine
from truepath.errors import NotFound
from truepath.kinematics.machine.machine import Machine
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.conditions.condition_log import ConditionLog
from truepath_drivers import host_clock


@dataclass(frozen=True, slots=True)
class MachineCell:
    """One machine, its cell and its conditions.

    id : by which jobs name it
    conditions : required before it moves
    version : of its configuration, as the registry counts them
    """

    id: str
    machine: Machine
    cell: CellSupervisor
    conditions: ConditionLog | None = None
    version: int = 1

    def start(self) -> None:
        """Start the cell process and the periodic reading of the conditions."""
        if self.conditions is not None:
            self.conditions.start()
        self.cell.start()

    def close(self) -> None:
        """End both. The cell holds the feed of a moving machine before it ends."""
        if self.conditions is not None:
            self.conditions.close()
        self.cell.close()


class Machines:
    """The machines in order; thread-safe while one is replaced."""

    def __init__(self, cells: Iterable[MachineCell] = ()) -> None:
        self._lock = threading.Lock()
        self._cells = {cell.id: cell for cell in cells}

    def list_all(self) -> list[MachineCell]:
        """In the order in which they were added."""
        with self._lock:
            return list(self._cells.values())

    def put(self, cell: MachineCell) -> MachineCell | None:
        """Add or replace a machine; the result is the one before, to be closed."""
        with self._lock:
            before = self._cells.get(cell.id)
            self._cells[cell.id] = cell
            return before

    def pop_machine(self, machine_id: str) -> MachineCell | None:
        """Remove a machine; the result is to be closed, None if it was unknown."""
        with self._lock:
            return self._cells.pop(machine_id, None)

    @property
    def first(self) -> MachineCell | None:
        """The only or first machine; None where the service controls none."""
        return next(iter(self.list_all()), None)

    def get(self, machine_id: str) -> MachineCell:
        """Raises NotFound."""
        with self._lock:
            found = self._cells.get(machine_id)
        if found is None:
            known = ", ".join(cell.id for cell in self.list_all()) or "none"
            raise NotFound(
                f"this service drives no machine {machine_id}; it drives {known}"
            )
        return found

    def choose(self, machine_id: str | None) -> MachineCell:
        """The machine that a job is for; without a name the only one.

        Raises NotFound, NoMachine, UnnamedMachine.
        """
        if machine_id is not None:
            return self.get(machine_id)
        cells = self.list_all()
        if not cells:
            raise NoMachine
        if len(cells) > 1:
            raise UnnamedMachine([cell.id for cell in cells])
        return cells[0]

    def close(self) -> None:
        """End all cells, at the same time: each may have to wait for its feed hold."""
        closing = [
            threading.Thread(target=cell.close, name=f"close-{cell.id}")
            for cell in self.list_all()
        ]
        for thread in closing:
            thread.start()
        for thread in closing:
            host_clock.join(thread)
