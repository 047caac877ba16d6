"""Errors of jobs, beyond the families of `truepath.errors`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from truepath.errors import (
    BadInput,
    JobError,
    MeasurementFailed,
    TruepathError,
)


class StaleVersion(JobError):
    """Another client has changed the job since its version was read."""

    def __init__(self, version: int, current: int, state: str) -> None:
        super().__init__(
            f"version {version} of the job is not the current one, {current} "
            f"({state}); read the job again"
        )
        self.current = current


class StaleMachine(StaleVersion):
    """Another client has configured the machine since its version was read."""

    def __init__(self, machine_id: str, version: int, current: int) -> None:
        JobError.__init__(
            self,
            f"version {version} of machine {machine_id} is not the current one, "
            f"{current}; read the machine again",
        )
        self.current = current


class KeyReused(JobError):
    """The same Idempotency-Key came with another body."""


class NoMachine(JobError):
    """The service has no machine file, so it cannot move anything."""

    def __init__(self) -> None:
        super().__init__("no machine is set up; give the service a machine_file")


class UnnamedMachine(BadInput):
    """The service controls several machines and the request names none of them."""

    def __init__(self, machine_ids: Sequence[str]) -> None:
        super().__init__(
            f"the service drives several machines; give `machine`, one of "
            f"{', '.join(machine_ids)}"
        )


class MachineKnown(JobError):
    """There is a machine of that identifier, name, port or address already."""


class SetElsewhere(JobError):
    """The machine is configured in the settings, not over the interface."""


class NotSimulated(JobError):
    """Tables are loaded into simulated controls alone."""

    def __init__(self, machine_id: str) -> None:
        super().__init__(
            f"machine {machine_id} has no simulated control; load the files at the "
            "control itself"
        )


class DeviceSettings(JobError):
    """A driver cannot be made with its options: unknown driver, wrong option."""


class CellDown(JobError):
    """The cell process is not running."""


class QueueFull(JobError):
    """More jobs wait than the service takes on."""


class CellBusy(JobError):
    """One measuring job at a time: `job_id` holds the cell."""

    def __init__(self, job_id: str, state: str) -> None:
        super().__init__(f"job {job_id} ({state}) holds the machine")
        self.job_id = job_id


class NotResumable(JobError):
    """An interrupted measurement cannot continue; the text gives the reason."""


class MachineFileChanged(NotResumable):
    """A measurement cannot continue: its machine file has changed."""


class NotInControl(JobError):
    """Another client controls the job; `controller` is its name."""

    def __init__(self, controller: str) -> None:
        super().__init__(
            f"{controller} has this job under control; ask, or take the control over"
        )
        self.controller = controller


class ArmTokenExpired(JobError):
    """The token to arm with is too old."""


class ArmTokenUsed(JobError):
    """The token to arm with has been used."""


class ArmTokenOther(JobError):
    """The token to arm with is unknown, or was issued for something else."""


class MeasurementEnded(MeasurementFailed):
    """The cell ended a measurement before its path did; the machine is intact.

    code : as the cell named it; action : the remedy
    """

    def __init__(self, code: str, text: str, action: str = "") -> None:
        super().__init__(text)
        self.code, self.action = code, action


class MachineFault(MeasurementEnded):
    """Machine, tracker or link failed in a measurement; an operator has to check."""


class LineUnfinished(MeasurementEnded):
    """The current line did not end after a cancel, so the job was aborted."""


class Aborted(TruepathError):
    """A user ended the job. Not a failure."""


class Cancelled(TruepathError):
    """A user ended the job after its current line. Not a failure."""


class Interrupted(TruepathError):
    """The service is ending and the job with it."""


class GivenUp(TruepathError):
    """The service ended during each attempt of the job, which is given up."""


class WorkersAway(TruepathError):
    """No worker answers at the address that was set."""


class TaskFailed(TruepathError):
    """A task in another process raised.

    family : name of the class of its error; trace : for the log
    """

    def __init__(self, family: str, text: str, trace: str = "") -> None:
        super().__init__(family, text, trace)  # all of them, to survive pickling
        self.family, self.text, self.trace = family, text, trace

    def __str__(self) -> str:
        return self.text


class DiskFull(TruepathError):
    """The disk of the data folder has no room left for this."""


class StillNeeded(JobError):
    """What is to be deleted has not ended, or something depends on it.

    dependents : addresses or names of that
    """

    def __init__(self, text: str, dependents: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.dependents = tuple(dependents)


class SchemaTooNew(BadInput):
    """The catalogue was written by a newer version of the service."""


class SchemaTooOld(BadInput):
    """The catalogue is of an older version, from which no migration leads here."""


class CatalogueDamaged(BadInput):
    """The file of the catalogue is no catalogue or damaged. It is left as it is."""

    def __init__(self, file: Path, problem: str) -> None:
        super().__init__(
            f"{file}: {problem}, so the catalogue cannot be used; it is left as it is; "
            "`truepath catalogue rebuild`, with the settings of the service, sets it "
            "aside and makes it again from the Runs and results on disk"
        )


class CatalogueReadOnly(BadInput):
    """The file of the catalogue cannot be written."""


class InUse(TruepathError):
    """Another instance of the service works on the same data folder."""


class StorageUnavailable(TruepathError):
    """The catalogue stayed locked, or its server was away, for too long."""


class StorageFull(StorageUnavailable):
    """The disk of the catalogue has no room left. Known at once."""
