"""Two machines in one service: each has its cell, its job and its stop."""

from __future__ import annotations

from dataclasses import replace

import pytest
from arming import arm_at_once
from scripted_cell import CellMaker, wait_until

from truepath.catalogue.errors import CellBusy, UnnamedMachine
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, NotFound
from truepath.jobs.dispatch.dispatcher import Dispatcher
from truepath.jobs.kinds.requested_job import RequestedJob
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath.machines.setup.cell_setup import refuse_same_names, refuse_shared_links
from truepath.measurement.messages import CellConfig

ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
OFF_THE_LINE = {"x_mm": 100.0, "y_mm": 350.0, "z_mm": 50.0}
TCP = {"host": "192.0.2.7", "port": 502}


def measure(machine):
    return RequestedJob(
        JobKind.MEASURE_OTF, rows=(*ROWS, OFF_THE_LINE), machine=machine
    )


class Fleet:
    """Two machines over scripted cells, and verbs that wait for what they ask."""

    def __init__(self, context, event_bus, machine, until):
        self.makers = {"mill": CellMaker(), "lathe": CellMaker()}
        self.cells = [
            MachineCell(name, machine, CellSupervisor(maker, first_pause_s=0.02))
            for name, maker in self.makers.items()
        ]
        self.context = replace(context, machines=Machines(self.cells))
        for cell in self.cells:
            cell.start()
        self.dispatcher = Dispatcher(self.context, event_bus)
        self.until = until

    def begin(self, machine):
        job, _ = self.dispatcher.create(measure(machine))
        ready = self.until(job, State.READY)
        arm_at_once(self.dispatcher, ready.id, ready.version)
        assert self.makers[machine].cell.begun.wait(25)
        return self.until(job, State.RUNNING)

    def close(self):
        self.dispatcher.close()
        self.context.machines.close()


@pytest.fixture
def fleet(context, event_bus, machine, until):
    fleet = Fleet(context, event_bus, machine, until)
    yield fleet
    fleet.close()


def test_two_machines_measure_at_once_and_each_only_once(fleet):
    jobs = {name: fleet.begin(name) for name in fleet.makers}
    assert {name: job.machine for name, job in jobs.items()} == {
        "mill": "mill",
        "lathe": "lathe",
    }
    with pytest.raises(CellBusy) as busy:
        fleet.dispatcher.create(measure("mill"))
    assert busy.value.job_id == jobs["mill"].id
    for name, maker in fleet.makers.items():
        maker.cell.end()
        assert fleet.until(jobs[name], State.SUCCEEDED).run_id == jobs[name].id


def test_a_cell_that_dies_leaves_the_other_machine_at_work(fleet):
    mill, lathe = fleet.begin("mill"), fleet.begin("lathe")
    fleet.makers["mill"].cell.die()
    assert fleet.until(mill, State.FAULTED).failure.code == "cell-died"
    assert fleet.context.store.get(lathe.id).state is State.RUNNING
    assert "abort" not in fleet.makers["lathe"].cell.heard
    fleet.makers["lathe"].cell.end()
    fleet.until(lathe, State.SUCCEEDED)


def test_a_stop_of_one_machine_leaves_the_other_moving(fleet):
    mill, lathe = fleet.begin("mill"), fleet.begin("lathe")
    assert [job.id for job in fleet.dispatcher.stop("mill")] == [mill.id]
    fleet.until(mill, State.ABORTED)
    assert fleet.context.store.get(lathe.id).state is State.RUNNING
    assert lathe.id in [job.id for job in fleet.dispatcher.stop()]
    fleet.until(lathe, State.ABORTED)
    with pytest.raises(NotFound, match="no machine press; it drives mill, lathe"):
        fleet.dispatcher.stop("press")


def test_a_job_has_to_say_which_of_several_machines_it_means(fleet):
    with pytest.raises(UnnamedMachine, match="one of mill, lathe"):
        fleet.dispatcher.create(measure(None))
    with pytest.raises(NotFound, match="no machine press"):
        fleet.dispatcher.create(measure("press"))


def test_a_plan_of_one_machine_is_not_driven_on_another(fleet):
    request = RequestedJob(JobKind.PLAN, plan_request={}, machine="mill")
    plan, _ = fleet.dispatcher.create(request)
    wait_until(lambda: fleet.context.store.get(plan.id).is_final)
    on_other = RequestedJob(JobKind.MEASURE_OTF, plan_id=plan.id, machine="lathe")
    with pytest.raises(BadInput, match="is of machine mill, not of lathe"):
        fleet.dispatcher.create(on_other)


def cell_config(tracker, motion):
    return CellConfig("streaming", tracker, "modbus", motion)


def test_two_machines_may_not_name_one_port_or_address():
    mill = cell_config({"port": "/dev/tracker-1"}, TCP)
    apart = cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.8"})
    refuse_shared_links([("mill", mill), ("lathe", apart)])
    for other, link in (
        (cell_config({"port": "/dev/tracker-1"}, {"host": "192.0.2.8"}), "tracker-1"),
        (cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.7"}), "2.7:502"),
    ):
        with pytest.raises(BadInput, match=f"mill and lathe both name .*{link}"):
            refuse_shared_links([("mill", mill), ("lathe", other)])


def test_two_machine_files_may_not_state_one_name():
    with pytest.raises(BadInput, match="mill and lathe are both named 'VMC'"):
        refuse_same_names([("mill", "VMC"), ("lathe", "VMC")])
