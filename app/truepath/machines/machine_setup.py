"""Machines while the service runs: add one, choose its devices, test them.

Machines of the settings are changed in the settings; those added over the interface are
stored in the catalogue and loaded at the next start.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import structlog

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.errors import (
    CellBusy,
    MachineKnown,
    SetElsewhere,
    StaleMachine,
)
from truepath.catalogue.job import Json
from truepath.catalogue.machine_registry import (
    CATALOGUE,
    REMOVED,
    SETTINGS,
    MachineRecord,
    MachineRegistry,
    hide_secrets,
)
from truepath.catalogue.store import Store
from truepath.device_options import make_device
from truepath.errors import (
    BadInput,
    IllegalTransition,
    NotFound,
    TruepathError,
)
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.kinematics.machine.machine import Machine
from truepath.machine_settings import DeviceConfiguration
from truepath.machines.cell_status import MOVING
from truepath.machines.machine_cells import (
    CellSetup,
    MachineCell,
    Machines,
    configure_cell,
    reject_same_names,
    reject_shared_links,
)
from truepath.machines.simulated_controls import (
    LoadedFiles,
    SimulatedControl,
    SimulatedControls,
)
from truepath.measurement.messages import CellConfig, TrackerTried

log = structlog.get_logger(__name__)

_OPTIONS = ("tracker_options", "motion_options", "thermometer_options")


@dataclass(frozen=True, slots=True)
class ConfiguredMachine:
    """A machine of the settings, or a simulated one.

    control : of a simulated machine: its ports differ each time and are no part of the
        configuration
    """

    id: str
    machine: Machine
    config: CellConfig
    control: SimulatedControl | None = None


class MachineSetup:
    """Keeps cells and catalogue of the machines consistent; thread-safe."""

    def __init__(
        self,
        registry: MachineRegistry,
        store: Store,
        cell_setup: CellSetup,
        calibrations: Calibrations,
    ) -> None:
        self.registry, self.machines = registry, Machines()
        self.calibrations = calibrations
        self._store, self._cell_setup = store, cell_setup
        self._configs: dict[str, CellConfig] = {}
        self.simulated_controls = SimulatedControls()

    def load(self, configured: Iterable[ConfiguredMachine]) -> None:
        """Load the machines of the settings, then those of the catalogue.

        One of the catalogue that the settings now contradict is left out.
        """
        known = list(configured)
        self.simulated_controls = SimulatedControls(
            {one.id: one.control for one in known if one.control is not None}
        )
        for one in known:
            devices = {"simulated": True} if one.control else _describe(one.config)
            content = machine_to_json(one.machine)
            version = self.registry.record_configuration(
                one.id, SETTINGS, content, devices
            )
            self._put(one.id, one.machine, one.config, version)
        for record in self.registry.list_all():
            if record.origin == CATALOGUE and record.versions:
                self._load_kept(record)

    def add(
        self, machine_id: str, machine_file: Json, identity: Mapping[str, str]
    ) -> MachineRecord:
        """Add a machine whose devices are chosen later.

        Raises BundleError, MachineKnown.
        """
        machine = machine_from_json(machine_file)
        self._reject_name(machine_id, machine.name)
        names = {"name": machine.name, **{k: v for k, v in identity.items() if v}}
        self.registry.add(machine_id, CATALOGUE, names)
        self.registry.record_configuration(
            machine_id, CATALOGUE, machine_to_json(machine), {}
        )
        return self.registry.get(machine_id)

    def set_devices(
        self,
        machine_id: str,
        devices: DeviceConfiguration,
        version: int | None = None,
    ) -> MachineRecord:
        """Choose drivers and their options; the cell is started again with them.

        version : of the configuration, as it was read; None for any

        Raises NotFound, SetElsewhere, CellBusy, StaleMachine, MachineKnown, BadInput.
        """
        record = self._get_changeable(machine_id, version)
        config = configure_cell(devices)
        _check_options(config)
        self._reject_links(machine_id, config)
        content = record.versions[0].machine_file
        kept = devices.model_dump(mode="json")
        number = self.registry.record_configuration(
            machine_id, CATALOGUE, content, kept
        )
        machine = machine_from_json(content)
        self._put(machine_id, machine, config, number).start()
        return self.registry.get(machine_id)

    def set_machine_file(
        self, machine_id: str, machine_file: Json, version: int | None = None
    ) -> MachineRecord:
        """Replace the machine file; the cell, if there is one, is started again.

        version : of the configuration, as it was read; None for any

        Raises NotFound, SetElsewhere, CellBusy, StaleMachine, MachineKnown,
        BundleError.
        """
        before = self._get_changeable(machine_id, version).versions[0]
        machine = machine_from_json(machine_file)
        self._reject_name(machine_id, machine.name)
        content, devices = machine_to_json(machine), dict(before.devices)
        number = self.registry.record_configuration(
            machine_id, CATALOGUE, content, devices
        )
        if devices and number != before.number:
            config = configure_cell(DeviceConfiguration(**devices))
            self._put(machine_id, machine, config, number).start()
        return self.registry.get(machine_id)

    def remove(self, machine_id: str, version: int) -> None:
        """Stop controlling a machine; its measurements stay.

        version : of its configuration, as it was read

        Raises NotFound, SetElsewhere, CellBusy, IllegalTransition, StaleMachine.
        """
        self._get_changeable(machine_id, version)
        for one in self.machines.list_all():
            if one.id == machine_id and one.cell.status.state in MOVING:
                raise IllegalTransition(
                    f"machine {machine_id} is {one.cell.status.state}; stop it first"
                )
        self.registry.change(machine_id, origin=REMOVED)
        self._configs.pop(machine_id, None)
        taken = self.machines.pop_machine(machine_id)
        if taken is not None:
            taken.close()

    def try_devices(self, machine_id: str) -> TrackerTried:
        """Connect, and read the tracker's stream for a moment. Nothing moves.

        Raises NotFound, CellBusy, DeviceError, DeviceSettings, CellDown.
        """
        one = self.machines.get(machine_id)
        self.reject_while_measuring(machine_id)
        tried = one.cell.try_tracker(one.machine.tracker.rate_hz)
        if tried is None:
            raise CellBusy("", "measuring")
        return tried

    def read_loaded_files(self, machine_id: str) -> LoadedFiles:
        """Files that this service has loaded into a simulated control."""
        return self.simulated_controls.read(machine_id)

    def reject_while_measuring(self, machine_id: str) -> None:
        """Raise CellBusy where a measuring job holds the machine."""
        for job in self._store.list_unfinished():
            if job.kind.measures and job.machine == machine_id:
                raise CellBusy(job.id, job.state)

    def _get_changeable(self, machine_id: str, version: int | None) -> MachineRecord:
        record = self.registry.get(machine_id)
        if record.origin == REMOVED:
            raise NotFound(f"machine {machine_id} was removed; add it again")
        if record.origin != CATALOGUE:
            raise SetElsewhere(f"machine {machine_id} is configured in the settings")
        self.reject_while_measuring(machine_id)
        newest = record.versions[0].number
        if version is not None and version != newest:
            raise StaleMachine(machine_id, version, newest)
        return record

    def _load_kept(self, record: MachineRecord) -> None:
        newest = record.versions[0]
        if not newest.devices:
            return
        try:
            config = configure_cell(DeviceConfiguration(**newest.devices))
            machine = machine_from_json(newest.machine_file)
            self._reject_name(record.id, machine.name)
            self._reject_links(record.id, config)
        except (TruepathError, ValueError) as error:
            log.error("a machine is left out", machine=record.id, reason=str(error))
            return
        self._put(record.id, machine, config, newest.number)

    def _put(
        self, machine_id: str, machine: Machine, config: CellConfig, version: int
    ) -> MachineCell:
        made = self._cell_setup.make(machine_id, machine, config, version)
        self._configs[machine_id] = config
        before = self.machines.put(made)
        if before is not None:
            before.close()
        return made

    def _reject_name(self, machine_id: str, name: str) -> None:
        known = {one.id: one.machine.name for one in self.machines.list_all()}
        for record in self.registry.list_all():
            if record.origin == CATALOGUE and record.versions:
                known[record.id] = str(record.versions[0].machine_file["name"])
        try:
            reject_same_names((known | {machine_id: name}).items())
        except BadInput as error:
            raise MachineKnown(str(error)) from error

    def _reject_links(self, machine_id: str, config: CellConfig) -> None:
        others = {k: v for k, v in self._configs.items() if k != machine_id}
        try:
            reject_shared_links([*others.items(), (machine_id, config)])
        except BadInput as error:
            raise MachineKnown(str(error)) from error


def show_devices(devices: Mapping[str, Any]) -> dict[str, Any]:
    """Devices of a version without the passwords among their options."""
    return {k: hide_secrets(v) if k in _OPTIONS else v for k, v in devices.items()}


def _describe(config: CellConfig) -> dict[str, Any]:
    return show_devices(asdict(config))


def _check_options(config: CellConfig) -> None:
    make_device("tracker", config.tracker_driver, config.tracker_options)
    make_device("motion", config.motion_driver, config.motion_options)
    if config.thermometer_driver:
        options = config.thermometer_options
        make_device("thermometer", config.thermometer_driver, options)
