"""Makes the cell of a machine and the board of its conditions, not started yet."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.job import JobEvent
from truepath.device_options import DEVICES, list_options
from truepath.errors import BadInput
from truepath.kinematics.machine.machine import Machine
from truepath.machine_settings import DeviceConfiguration
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.conditions.condition_log import ConditionLog
from truepath.machines.conditions.conditions import Condition, Observed
from truepath.machines.machine_cells import MachineCell
from truepath.measurement.messages import CellConfig
from truepath.measurement.process.cell import Cell
from truepath.measurement.time_limits import StreamTimeouts
from truepath_drivers import host_clock


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
                standing=self.calibrations
                and self.calibrations.find_calibration_status(machine_id),
                stream=cell.stream.read(),
                drift_limit_degC=self.drift_limit_degC,
            )

        def publish(condition: Condition) -> None:
            body = {"machine": machine_id, **asdict(condition)}
            self.publish(JobEvent("condition", None, body))

        board = ConditionLog(observe, on_change=publish)
        return MachineCell(machine_id, machine, cell, board, version)
