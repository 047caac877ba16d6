"""What several tests of jobs are made of: rows, Runs, conditions."""

import numpy as np

from scripted_cell import DEVICES
from truepath.catalogue.job import JobKind
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.run import Run
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.machines.cell_status import CellStatus
from truepath.machines.conditions import Observed
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.motion.configurations import Configurations
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers.interfaces.records import TrackerSamples

ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
OFF_THE_LINE = {"x_mm": 100.0, "y_mm": 350.0, "z_mm": 50.0}
OTF = RequestedJob(JobKind.MEASURE_OTF, rows=(*ROWS, OFF_THE_LINE))
CONNECTED = CellStatus("ready", devices={"motion": {"has_watchdog": True}})
OBSERVED = Observed(CONNECTED, None, False, 10**12, 1)


def make_samples(sequence=range(10)):
    number = np.array(sequence)
    n = len(number)
    return TrackerSamples(number, number / 500.0, np.ones((n, 3)), np.zeros(n, int))


def write_bundle_zip(machine, file, sequence=range(10)):
    points = Configurations(machine.axis_names, np.array([[1.0, 2, 3]]), np.ones(1))
    file.write_bytes(zip_bundle(Run("b", machine, points, make_samples(sequence))))
    return file


def begin_run(runs, machine, run_id, job_id="", name="r"):
    """Begin the Run of a job; the caller closes it."""
    path, axes = command_rows(machine, ROWS, is_path=True), machine.axis_names
    header = RunHeader(name, machine, path, 500.0, DEVICES, axes, job_id=job_id)
    return Recorder(runs.name_run_file(run_id), header, reserve_bytes=0)


def arm_at_once(dispatcher, job_id, version, *, by=None):
    token = dispatcher.prepare_arming(job_id, by=by).token
    return dispatcher.arm(job_id, version, token, by=by)
