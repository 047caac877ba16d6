"""Two machines in one service: each has its cell, its job and its stop."""

from dataclasses import replace

import pytest

from arming import arm_at_once
from job_builders import OTF
from scripted_cell import CellMaker
from truepath.catalogue.errors import CellBusy, UnnamedMachine
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, NotFound
from truepath.jobs.kinds.job_creation import RequestedJob
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath.machines.setup.cell_setup import reject_same_names, reject_shared_links
from truepath.measurement.messages import CellConfig

TCP = {"host": "192.0.2.7", "port": 502}


def measure(machine):
    return replace(OTF, machine=machine)


class Fleet:
    def __init__(self, machine, open_dispatcher, until):
        self.makers = {"mill": CellMaker(), "lathe": CellMaker()}
        cells = [
            MachineCell(name, machine, CellSupervisor(maker, first_pause_s=0.02))
            for name, maker in self.makers.items()
        ]
        self.machines, self.until = Machines(cells), until
        for cell in cells:
            cell.start()
        self.dispatcher = open_dispatcher(
            machines=self.machines, planner=lambda *_, on_progress: {"kind": "path"}
        )

    def begin(self, machine):
        job, _ = self.dispatcher.create(measure(machine))
        ready = self.until(job, State.READY)
        arm_at_once(self.dispatcher, ready.id, ready.version)
        assert self.makers[machine].cell.begun.wait(25)
        return self.until(job, State.RUNNING)


@pytest.fixture
def fleet(machine, open_dispatcher, until):
    fleet = Fleet(machine, open_dispatcher, until)
    yield fleet
    fleet.dispatcher.close()
    fleet.machines.close()


@pytest.mark.database
def test_two_machines_measure_at_once_each_once_one_outlives_the_other(fleet, context):
    mill, lathe = fleet.begin("mill"), fleet.begin("lathe")
    assert (mill.machine, lathe.machine) == ("mill", "lathe")
    for job in (mill, lathe):
        with pytest.raises(CellBusy) as busy:
            fleet.dispatcher.create(measure(job.machine))
        assert busy.value.job_id == job.id
    fleet.makers["mill"].cell.die()
    assert fleet.until(mill, State.FAULTED).failure.code == "cell-died"
    assert context.store.get(lathe.id).state is State.RUNNING
    assert "abort" not in fleet.makers["lathe"].cell.heard
    fleet.makers["lathe"].cell.end()
    assert fleet.until(lathe, State.SUCCEEDED).run_id == lathe.id


def test_a_stop_of_one_machine_leaves_the_other_moving(fleet, context):
    mill, lathe = fleet.begin("mill"), fleet.begin("lathe")
    assert [job.id for job in fleet.dispatcher.stop("mill")] == [mill.id]
    fleet.until(mill, State.ABORTED)
    assert context.store.get(lathe.id).state is State.RUNNING
    assert lathe.id in [job.id for job in fleet.dispatcher.stop()]
    fleet.until(lathe, State.ABORTED)
    with pytest.raises(NotFound, match="no machine press; it drives mill, lathe"):
        fleet.dispatcher.stop("press")


def test_a_job_says_which_of_several_machines_it_means_and_a_plan_is_of_one(fleet):
    with pytest.raises(UnnamedMachine, match="one of mill, lathe"):
        fleet.dispatcher.create(measure(None))
    with pytest.raises(NotFound, match="no machine press"):
        fleet.dispatcher.create(measure("press"))
    request = RequestedJob(JobKind.PLAN, plan_request={}, machine="mill")
    plan = fleet.until(fleet.dispatcher.create(request)[0])
    on_other = RequestedJob(JobKind.MEASURE_OTF, plan_id=plan.id, machine="lathe")
    with pytest.raises(BadInput, match="is of machine mill, not of lathe"):
        fleet.dispatcher.create(on_other)


def cell_config(tracker, motion):
    return CellConfig("streaming", tracker, "modbus", motion)


def test_two_machines_may_not_name_one_port_or_address_or_state_one_name():
    mill = cell_config({"port": "/dev/tracker-1"}, TCP)
    apart = cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.8"})
    reject_shared_links([("mill", mill), ("lathe", apart)])
    for other, link in (
        (cell_config({"port": "/dev/tracker-1"}, {"host": "192.0.2.8"}), "tracker-1"),
        (cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.7"}), "2.7:502"),
    ):
        with pytest.raises(BadInput, match=f"mill and lathe both name .*{link}"):
            reject_shared_links([("mill", mill), ("lathe", other)])
    with pytest.raises(BadInput, match="mill and lathe are both named 'VMC'"):
        reject_same_names([("mill", "VMC"), ("lathe", "VMC")])
