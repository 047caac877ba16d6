"""The machines that the service controls, each with the cell that holds its devices."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.errors import NoMachine, UnnamedMachine
from truepath.catalogue.job import JobEvent
from truepath.device_options import DEVICES, list_options
from truepath.errors import BadInput, NotFound
from truepath.kinematics.machine.machine import Machine
from truepath.machine_settings import DeviceConfiguration
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.conditions import Condition, ConditionLog, Observed
from truepath.measurement.messages import CellConfig
from truepath.measurement.process.cell import Cell
from truepath.measurement.time_limits import StreamTimeouts
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


def _read_clock_difference_s() -> float:
    return host_clock.wall_s() - host_clock.now_s()


def configure_cell(stated: DeviceConfiguration) -> CellConfig:
    """Cell configuration from the device settings of a machine."""
    patience = {f"{name}_s": s for name, s in stated.tracker_patience_s.items()}
    return CellConfig(
        stated.tracker_driver,
        stated.tracker_options,
        stated.motion_driver,
        stated.motion_options,
        StreamTimeouts(**patience),
        allow_no_watchdog=stated.allow_no_watchdog,
        thermometer_driver=stated.thermometer_driver,
        thermometer_options=stated.thermometer_options,
        light=stated.light,
    )


def reject_same_names(named: Iterable[tuple[str, str]]) -> None:
    """Raise BadInput where two machine files have one name, which identifies Runs.

    named : identifier and name of each machine
    """
    known: dict[str, str] = {}
    for machine_id, name in named:
        if name in known:
            raise BadInput(
                f"machines {known[name]} and {machine_id} are both named {name!r} in "
                "their machine files; Runs tell machines apart by that name: give "
                "each its own"
            )
        known[name] = machine_id


def reject_shared_links(reached: Iterable[tuple[str, CellConfig]]) -> None:
    """Raise BadInput where two machines name one port or address.

    reached : identifier and devices of each machine
    """
    known: dict[str, str] = {}
    for machine_id, config in reached:
        for link in dict.fromkeys(_list_links(config)):
            if link in known:
                raise BadInput(
                    f"machines {known[link]} and {machine_id} both name {link}; a "
                    "device serves one machine: give each its own port or address"
                )
            known[link] = machine_id


def _list_links(config: CellConfig) -> Iterator[str]:
    devices = (
        ("tracker", config.tracker_driver, config.tracker_options),
        ("motion", config.motion_driver, config.motion_options),
        ("thermometer", config.thermometer_driver, config.thermometer_options),
    )
    for word, driver, options in devices:
        if not driver:
            continue
        with suppress(BadInput):
            yield from _list_links_of(word, driver, options)


def _list_links_of(word: str, driver: str, options: Mapping[str, Any]) -> Iterator[str]:
    stated = {
        one.name: options.get(one.name, one.default)
        for one in list_options(DEVICES[word], driver)
    }
    host, port, serial = (stated.get(n) for n in ("host", "port", "serial_port"))
    if isinstance(serial, str) or isinstance(port, str):
        yield os.path.realpath(str(serial or port))
    elif isinstance(host, str):
        name = "127.0.0.1" if host == "localhost" else host.lower()
        yield f"{name}:{port}"
    elif isinstance(port, int):
        yield f"port {port} of this computer"


@dataclass(frozen=True, slots=True)
class CellSetup:
    """Common to all machines of a service.

    folder : on the disk of the Runs; least_bytes : that have to stay free there
    calibrations : source of the status of machines
    publish : receives changes
    drift_limit_degC : by which a temperature may change before the machine may move
    begun_s : wall clock less monotonic clock when the service began
    """

    folder: Path
    least_bytes: int
    calibrations: Calibrations | None = None
    publish: Callable[[JobEvent], None] = lambda _: None
    drift_limit_degC: float | None = None  # noqa: N815
    begun_s: float = field(default_factory=_read_clock_difference_s)

    def make(
        self, machine_id: str, machine: Machine, config: CellConfig, version: int = 1
    ) -> MachineCell:
        """A machine with its cell, not yet started."""
        cell = CellSupervisor(lambda: Cell(config))

        def observe() -> Observed:
            return Observed(
                cell=cell.status,
                controller=cell.controller,
                allow_no_watchdog=config.allow_no_watchdog,
                free_bytes=shutil.disk_usage(self.folder).free,
                least_bytes=self.least_bytes,
                clock_step_s=_read_clock_difference_s() - self.begun_s,
                calibration_status=self.calibrations
                and self.calibrations.find_calibration_status(machine_id),
                stream=cell.stream.read(),
                drift_limit_degC=self.drift_limit_degC,
            )

        def publish(condition: Condition) -> None:
            body = {"machine": machine_id, **asdict(condition)}
            self.publish(JobEvent("condition", None, body))

        board = ConditionLog(observe, on_change=publish)
        return MachineCell(machine_id, machine, cell, board, version)
