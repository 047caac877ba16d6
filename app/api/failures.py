"""From a family of errors to a problem (RFC 9457): one table, and nothing else decides.

What is not in the table is a bug of ours: status 500, the cause in the log under the
request's identifier, never in the answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app import errors as app_errors
from app.jobs import errors as job_errors
from app.jobs.job import Failure
from drivers.interfaces import errors as device_errors

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, slots=True)
class ProblemKind:
    """One kind of problem. `action` is the way out where the error names none."""

    status: int
    code: str
    title: str
    action: str


INTERNAL = ProblemKind(
    500,
    "internal-error",
    "The service failed",
    "Report the request identifier with the log of the service.",
)

PROBLEM_KINDS: Mapping[type[Exception], ProblemKind] = {
    # What a user gave.
    app_errors.BundleError: ProblemKind(
        422,
        "bundle",
        "The measurement bundle cannot be used",
        "Correct the file at the place that is named, then send it again.",
    ),
    app_errors.OutOfTravel: ProblemKind(
        422,
        "out-of-travel",
        "The plan leaves the travel of an axis",
        "Shorten the plan, or correct the travel in the machine file.",
    ),
    app_errors.PlanningError: ProblemKind(
        422, "plan", "The plan cannot be driven", "Correct the row that is named."
    ),
    app_errors.BadInput: ProblemKind(
        422, "bad-input", "The input cannot be used", "Correct what is named."
    ),
    # Jobs.
    app_errors.NotFound: ProblemKind(
        404,
        "not-found",
        "There is no such thing",
        "Look at the list for what there is.",
    ),
    job_errors.CellBusy: ProblemKind(
        409,
        "busy",
        "Another job holds the machine",
        "Wait until current_job has ended, or abort it.",
    ),
    app_errors.Busy: ProblemKind(
        409, "busy", "The machine is in use", "Try again later."
    ),
    job_errors.QueueFull: ProblemKind(
        503, "queue-full", "Too many jobs wait", "Try again when some have ended."
    ),
    app_errors.IllegalTransition: ProblemKind(
        409,
        "illegal-transition",
        "The job's state does not allow that",
        "Read the job again and choose what its state allows.",
    ),
    job_errors.StaleVersion: ProblemKind(
        412,
        "stale-version",
        "The job has changed since it was read",
        "Read the job again, look at what has changed, then decide anew.",
    ),
    job_errors.KeyReused: ProblemKind(
        409,
        "idempotency-key-reuse",
        "The Idempotency-Key belongs to another body",
        "Use a new key for a new job.",
    ),
    job_errors.NoMachine: ProblemKind(
        409,
        "no-machine",
        "No machine is set up",
        "Give the service a machine_file and the ports of its devices, or --simulated.",
    ),
    job_errors.DeviceSettings: ProblemKind(
        409,
        "device-settings",
        "A driver cannot be used as it is set up",
        "Correct driver and options in the settings, then start the service again.",
    ),
    job_errors.CellDown: ProblemKind(
        503,
        "cell-down",
        "The cell process does not run",
        "Wait a few seconds: it is started again. If that goes on, look at the log.",
    ),
    job_errors.Interrupted: ProblemKind(
        500,
        "interrupted",
        "The service ended during the job",
        "Make sure that the machine stands and is where you expect it, then measure "
        "again; what was recorded is kept.",
    ),
    job_errors.MachineFault: ProblemKind(
        500,
        "machine-fault",
        "Machine, tracker or link failed",
        "Look at the machine, clear the cause, then measure again.",
    ),
    app_errors.MeasurementFailed: ProblemKind(
        500,
        "measurement-failed",
        "The measurement ended before its path did",
        "Clear the cause, then measure again; what was recorded is kept.",
    ),
    # Science.
    app_errors.AlignmentError: ProblemKind(
        422,
        "alignment",
        "The stream and the commanded path do not match",
        "Check that the bundle holds the path that was driven.",
    ),
    app_errors.Unidentifiable: ProblemKind(
        422,
        "unidentifiable",
        "The data cannot tell the parameters that are named",
        "Measure with another path, or with more targets.",
    ),
    app_errors.EstimationError: ProblemKind(
        422,
        "estimation",
        "The data do not carry the answer",
        "Look at the plan and at the quality of the stream.",
    ),
    job_errors.WorkersAway: ProblemKind(
        503,
        "workers-away",
        "The computing cluster cannot be reached",
        "Start its scheduler and workers, or set executor to processes.",
    ),
    job_errors.WorkerDied: ProblemKind(
        500, "worker-died", "The computing process was killed", "Run the job again."
    ),
    # The computer.
    job_errors.StorageUnavailable: ProblemKind(
        503,
        "storage",
        "The catalogue does not answer",
        "Try again; if that goes on, look at the disk or the database server.",
    ),
    job_errors.DiskFull: ProblemKind(
        507, "disk-full", "The disk is full", "Free some space, then try again."
    ),
    # Devices.
    device_errors.ConnectionLost: ProblemKind(
        502,
        "device-unreachable",
        "A device cannot be reached",
        "Check power, cable and the port in the settings, then connect again.",
    ),
    device_errors.DeviceTimeout: ProblemKind(
        504,
        "device-silent",
        "A device does not answer",
        "Check power, cable and the port in the settings, then connect again.",
    ),
    device_errors.WrongDevice: ProblemKind(
        409,
        "device-identity",
        "Something else answers on the port",
        "Check which device is on the port that is named.",
    ),
    device_errors.MotionFault: ProblemKind(
        409,
        "motion-fault",
        "The controller is in alarm",
        "Clear the alarm at the machine, then try again.",
    ),
    device_errors.BeamLost: ProblemKind(
        409,
        "beam-lost",
        "The tracker has lost its reflector",
        "Lock the beam on the reflector, then try again.",
    ),
    device_errors.OutOfTravel: ProblemKind(
        409,
        "out-of-travel",
        "The controller's travel is shorter than the plan",
        "Correct the travel in the machine file, then plan again.",
    ),
    device_errors.Refused: ProblemKind(
        409, "device-refused", "A device has refused", "Look at the text it gave."
    ),
    device_errors.DeviceError: ProblemKind(
        502, "device", "A device failed", "Look at the device, then connect again."
    ),
}
_BY_NAME = {family.__name__: kind for family, kind in PROBLEM_KINDS.items()}

# What the framework raises, by status.
BY_STATUS: Mapping[int, ProblemKind] = {
    400: ProblemKind(
        400, "bad-request", "The request cannot be read", "Correct the request."
    ),
    403: ProblemKind(
        403,
        "cross-site",
        "The request comes from another site",
        "Use the page or the interface of this service itself.",
    ),
    404: ProblemKind(
        404, "not-found", "There is nothing at this address", "See /docs for addresses."
    ),
    405: ProblemKind(
        405, "method", "The method is not for this address", "See the Allow header."
    ),
    412: ProblemKind(
        412,
        "stale-version",
        "The job is not at that version",
        'Read the job and send its version as If-Match: "<version>".',
    ),
    413: ProblemKind(
        413,
        "too-large",
        "The request is too large",
        "Send less, or raise max_upload_mb.",
    ),
    415: ProblemKind(
        415, "media-type", "That kind of content is not taken", "Send JSON."
    ),
    421: ProblemKind(
        421,
        "host",
        "The service does not go by that name",
        "Use localhost or an address, or add the name to trusted_hosts.",
    ),
    422: ProblemKind(
        422, "validation", "The request is not as documented", "Correct what is named."
    ),
    428: ProblemKind(
        428,
        "version-required",
        "The version of the job is required",
        'Read the job and send its version as If-Match: "<version>".',
    ),
    429: ProblemKind(
        429, "too-many-streams", "Too many event streams", "Close some pages."
    ),
    503: ProblemKind(
        503, "not-ready", "The service is not ready", "Try again in a moment."
    ),
}


def find_kind(error: Exception) -> ProblemKind:
    """Return the kind of a problem that an error is; the nearest family counts."""
    for family in type(error).__mro__:
        if family in PROBLEM_KINDS:
            return PROBLEM_KINDS[family]
    return INTERNAL


def is_known(error: Exception) -> bool:
    """Say whether the table has the error's family."""
    return find_kind(error) is not INTERNAL


def describe_error(error: Exception) -> dict[str, Any]:
    """Return the problem that an error is, without what only the request knows."""
    kind = find_kind(error)
    if kind is INTERNAL:
        return problem(kind)
    extra: dict[str, Any] = {}
    if isinstance(error, job_errors.CellBusy):
        extra["current_job"] = f"/api/v1/jobs/{error.job_id}"
    if isinstance(error, job_errors.StaleVersion):
        extra["current_version"] = error.current
    if isinstance(error, app_errors.BundleError):
        extra |= {"file": error.file, "row": error.row, "column": error.column}
    return problem(kind, str(error), extra)


def describe_failure(failure: Failure) -> dict[str, Any]:
    """Return the problem that ended a job. It has no status: it is no answer."""
    kind = _BY_NAME.get(failure.family, INTERNAL)
    detail = failure.detail if kind is not INTERNAL else ""
    code = failure.code or kind.code
    content = problem(kind, detail)
    del content["status"]
    return {
        **content,
        "type": f"/problems/{code}",
        "code": code,
        "action": failure.action or kind.action,
    }


def problem(
    kind: ProblemKind, detail: str = "", extra: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the members of a problem."""
    return {
        "type": f"/problems/{kind.code}",
        "title": kind.title,
        "status": kind.status,
        "detail": detail or f"{kind.title}.",
        "code": kind.code,
        "action": kind.action,
        **(extra or {}),
    }
