"""Cells are made, asked and made anew; each of two machines has its own, and a stop."""

import threading
from dataclasses import replace

import pytest

from job_builders import OTF, arm_at_once
from scripted_cell import CellMaker, wait_until
from truepath.catalogue.errors import CellBusy, CellDown, DeviceSettings, UnnamedMachine
from truepath.catalogue.job import JobKind
from truepath.catalogue.transitions import State
from truepath.errors import BadInput, MeasurementFailed, NotFound, TruepathError
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.machines import cell_status, machine_cells
from truepath.machines.cell_supervisor import CellSupervisor
from truepath.machines.machine_cells import MachineCell, Machines
from truepath.measurement.messages import CellConfig, CellVerb, ControllerRead
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import WrongDevice
from truepath_drivers.interfaces.records import MotionState, MotionStatus


@pytest.fixture
def maker():
    return CellMaker()


@pytest.fixture
def supervisor(maker):
    supervisor = CellSupervisor(maker, first_pause_s=0.02)
    yield supervisor
    supervisor.close()


@pytest.fixture
def running(supervisor, maker):
    supervisor.start()
    wait_until(lambda: supervisor.status.state == "disconnected")
    return supervisor


def test_a_new_cell_opens_no_port_and_connecting_names_the_devices(running, maker):
    assert maker.cell.heard == []
    assert not running.status.connected
    assert running.connect()["tracker"]["serial_number"] == "T-1"
    assert running.status.connected
    assert running.status.state == "ready"
    running.connect()
    assert maker.cell.heard == ["connect", "connect"], "they are asked again"
    maker.cell.deaf.add("begin")
    assert running.begin(None, lambda event: None, lambda: False)
    assert running.connect()["motion"]["serial_number"] == "C-1"
    assert maker.cell.heard[2:] == ["begin"], "a measurement is not disturbed"
    running.ignore_events()
    maker.cell.fault("link-lost", "the cable is out", "plug it in")
    maker.cell.say_state("faulted")
    wait_until(lambda: running.status.state == "faulted")
    assert running.status.text == "the cable is out"
    assert not running.status.connected, "a fault makes connecting necessary"


def test_only_a_fresh_word_says_that_a_machine_stands(running, maker, monkeypatch):
    def read(state):
        status = state and MotionStatus(MotionState(state), (0.0, 0.0, 0.0), 0)
        maker.cell.say(ControllerRead(status, "" if status else "no answer"))
        wait_until(lambda: running.controller and running.controller.status == status)
        return running.read_standstill()

    assert running.read_standstill() is None
    assert read("idle") is True
    assert read("running") is False
    assert read("held") is False, "it could go on"
    assert read(None) is None
    assert read("aborted") is True
    for state in ("running", "aborted"):
        maker.cell.say_state(state)
        wait_until(lambda now=state: running.status.state == now)
        assert running.read_standstill() is None, "not read since"
    assert read("idle") is True
    monkeypatch.setattr(cell_status, "FRESH_S", 0.0)
    assert running.read_standstill() is None


@pytest.mark.parametrize(
    ("refusal", "family"),
    [
        (WrongDevice("a printer answers"), WrongDevice),
        (TruepathError("no tracker called x is installed"), DeviceSettings),
        (MeasurementFailed("the cell process did not answer"), CellDown),
    ],
)
def test_a_device_that_refuses_is_named_not_connected(running, maker, refusal, family):
    running.connect()
    maker.cell.refuses = refusal
    with pytest.raises(family, match=str(refusal)):
        running.connect()
    assert not running.status.connected


@pytest.mark.parametrize("end", ["die", "kill"])
def test_a_cell_that_dies_or_is_killed_is_made_anew_unconnected(running, maker, end):
    first = maker.cell
    running.connect()
    if end == "die":
        first.die()
    else:
        running.kill()
    wait_until(lambda: maker.cell is not first)
    wait_until(lambda: running.status.state == "disconnected")
    assert running.status.restarts == 1
    assert first.heard == ["connect", "kill"][: 2 - (end == "die")]
    assert first.closed
    assert maker.cell.heard == []
    running.connect()


def test_a_cell_that_does_not_start_is_tried_again_or_refuses(maker, supervisor):
    maker.fails = 2
    supervisor.start()
    wait_until(lambda: supervisor.status.state == "disconnected")
    assert supervisor.status.restarts == 2
    waiting = CellSupervisor(maker, first_pause_s=30.0)
    maker.fails = 1
    waiting.start()
    wait_until(lambda: waiting.status.state == "down")
    with pytest.raises(CellDown, match="no more processes"):
        waiting.connect()
    assert isinstance(waiting.send(CellVerb.ABORT).exception(5), CellDown)
    waiting.close()
    CellSupervisor(maker).close()  # it was never started
    supervisor.close()
    with pytest.raises(CellDown, match="ending"):
        supervisor.connect()


@pytest.mark.parametrize("asked", ["connect", "begin"])
def test_a_hanging_cell_is_told_and_killed(clock, running, maker, monkeypatch, asked):
    monkeypatch.setattr("truepath.machines.cell_supervisor.CONNECT_TIMEOUT_S", 0.1)
    first, hold = maker.cell, threading.Event()
    setattr(first, asked, lambda *_: host_clock.wait(hold, 5.0) and {})
    order = () if asked == "connect" else (None, lambda event: None, lambda: False)
    with pytest.raises(CellDown, match="does not answer"):
        getattr(running, asked)(*order)
    hold.set()
    wait_until(lambda: asked == "connect" or maker.cell is not first)


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
    mill = cell_config({"port": "/dev/tracker-1"}, {"host": "192.0.2.7", "port": 502})
    apart = cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.8"})
    machine_cells.reject_shared_links([("mill", mill), ("lathe", apart)])
    for other, link in (
        (cell_config({"port": "/dev/tracker-1"}, {"host": "192.0.2.8"}), "tracker-1"),
        (cell_config({"port": "/dev/tracker-2"}, {"host": "192.0.2.7"}), "2.7:502"),
    ):
        with pytest.raises(BadInput, match=f"mill and lathe both name .*{link}"):
            machine_cells.reject_shared_links([("mill", mill), ("lathe", other)])
    with pytest.raises(BadInput, match="mill and lathe are both named 'VMC'"):
        machine_cells.reject_same_names([("mill", "VMC"), ("lathe", "VMC")])
