"""Dependencies shared by all jobs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import State
from truepath.jobs.running.cell_measurement import CONFIRM_S
from truepath.jobs.running.live_estimation import LiveEstimation, Show
from truepath.jobs.running.live_process import LiveEstimateOrder
from truepath.jobs.running.plan_requests import plan_measurement
from truepath.jobs.workers.analysis_tasks import (
    check_closure,
    check_station,
    discover_recorded,
    find_committed_rows,
    follow_recorded,
    reanalyse_run,
    verify_recorded,
)
from truepath.jobs.workers.executor import ProcessExecutor, Task
from truepath.jobs.workers.workers import Workers
from truepath.kinematics.machine.machine import Machine
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath.machines.simulated_controls import LoadedFiles


@dataclass(frozen=True, slots=True)
class JobContext:
    """Dependencies of the steps of a job.

    machines : all machines of this service
    machine_cell : the job's machine; None for a job without one
    planner, science, discoverer, follower, checker, reanalyser, verifier : called as
        `plan_measurement`, `analyse_recorded`, `discover_recorded`, `follow_recorded`,
        `check_station`, `reanalyse_run`, `verify_recorded`
    resumer, closer : called as `find_committed_rows`, `check_closure`
    workers : compute the blocks of an analysis
    results : folder of results, one folder per job
    calibrations : of all machines; None where their status is not needed
    registry : stored configurations of the machines; None for none
    read_loaded_files : compensation files of a simulated control; empty for a real one
    confirm_s : time in which the cell has to confirm each state
    live : makes the live estimator; None for no live estimate
    """

    store: Store
    runs: RunCatalogue
    results: Path
    executor: ProcessExecutor
    science: Task
    workers: Workers = field(default_factory=Workers)
    machines: Machines = field(default_factory=Machines)
    machine_cell: MachineCell | None = None
    confirm_s: Mapping[State, float] = field(default_factory=lambda: CONFIRM_S)
    calibrations: Calibrations | None = None
    registry: MachineRegistry | None = None
    read_loaded_files: Callable[[str], LoadedFiles] = lambda _: LoadedFiles()
    live: Callable[[LiveEstimateOrder, Show], LiveEstimation] | None = None
    planner: Task = plan_measurement
    discoverer: Task = discover_recorded
    follower: Task = follow_recorded
    verifier: Task = verify_recorded
    checker: Task = check_station
    reanalyser: Task = reanalyse_run
    resumer: Task = find_committed_rows
    closer: Task = check_closure

    def require_machine_cell(self) -> MachineCell:
        """The job's machine with its cell. Raises NoMachine, UnnamedMachine."""
        return self.machine_cell or self.machines.choose(None)

    def require_machine(self) -> Machine:
        """Raises NoMachine, UnnamedMachine."""
        return self.require_machine_cell().machine

    def require_cell(self) -> CellSupervisor:
        """Raises NoMachine, UnnamedMachine."""
        return self.require_machine_cell().cell
