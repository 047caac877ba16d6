"""What drivers of somebody else may do to a measurement: hang, lie and break."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent

import numpy as np
import psutil
import pytest
from tests.plugin_site import NAME, install

from truepath.device_options import make_device
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    CellVerb,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
    TemperaturesRead,
    TrackerTrial,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceError
from truepath_drivers.interfaces.records import MotionStatus
from truepath_drivers.interfaces.records import Path as MotionPath

pytestmark = pytest.mark.fault_row(49)

DRIVERS = "tests.measurement.hostile_drivers"
ROOT = Path(__file__).parents[2]
POINTS = {
    "trackers": {"hostile": f"{DRIVERS}:HostileTracker"},
    "motion_controllers": {"hostile": f"{DRIVERS}:HostileMotion"},
    "thermometers": {"hostile": f"{DRIVERS}:HostileThermometers"},
}


@pytest.fixture(autouse=True)
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = install(tmp_path / "site", POINTS)
    monkeypatch.syspath_prepend(ROOT)  # for the process of the cell
    monkeypatch.syspath_prepend(folder)
    return folder


@pytest.fixture
def order(mill, tmp_path) -> MeasurementOrder:
    """A minute of motion."""
    position = np.tile([[10.0, 10.0, -10.0], [410.0, 310.0, -210.0]], (8, 1))
    n = len(position)
    path = MotionPath(mill.axis_names, position, np.full(n, 6000.0), np.zeros(n))
    file = str(tmp_path / "run.sqlite")
    return MeasurementOrder("hostile", file, mill, path, reserve_bytes=0)


class Driven:
    """A cell process on hostile drivers, and all that it has said."""

    def __init__(self, config: CellConfig) -> None:
        self.cell = Cell(config)
        self.events: list[CellEvent] = []
        self.cell.start()

    def until(self, kind: type, limit_s: float, count: int = 1) -> None:
        deadline_s = time.monotonic() + limit_s
        while sum(isinstance(e, kind) for e in self.events) < count:
            assert time.monotonic() < deadline_s, self.events[-3:]
            self.cell.send(CellVerb.BEAT)
            self.events += self.cell.poll(0.1)

    def of(self, kind: type) -> list:
        return [event for event in self.events if isinstance(event, kind)]


@pytest.fixture
def drive(tmp_path) -> Iterator[Callable[..., Driven]]:
    begun: list[Driven] = []

    def begin(device: str, verb: str, fault: str, *, late: bool = False) -> Driven:
        """Start a cell of which one device fails at once, or when `now` is there."""
        options: dict[str, dict[str, str]] = {"tracker": {}, "motion": {}}
        options["thermometer"] = {}
        at = str(tmp_path / "now") if late else "/"
        options[device] = {"verb": verb, "fault": fault, "at": at}
        options["motion"]["diary"] = str(tmp_path / "diary")
        config = CellConfig(
            "hostile",
            options["tracker"],
            "hostile",
            options["motion"],
            thermometer_driver="hostile" if device == "thermometer" else "",
            thermometer_options=options["thermometer"],
        )
        begun.append(Driven(config))
        return begun[-1]

    yield begin
    for one in begun:
        one.cell.kill()
        one.cell.close()


def read_diary(folder: Path) -> list[str]:
    return [line.split()[0] for line in (folder / "diary").read_text().splitlines()]


@pytest.mark.parametrize(
    ("device", "verb"),
    [("motion", "status"), ("tracker", "read"), ("motion", "send_heartbeat")],
)
def test_a_call_that_hangs_in_motion_ends_the_measurement_by_its_name(
    drive, order, tmp_path, device, verb
):
    driven = drive(device, verb, "hang", late=True)
    driven.cell.connect()
    driven.cell.begin(order)
    driven.until(MeasurementProgress, 20.0, 8)
    (tmp_path / "now").touch()
    driven.until(RunClosed, 12.0)
    faults = [fault.text for fault in driven.of(FaultReported)]
    assert any(NAME in text and f"{verb}()" in text for text in faults), faults
    assert driven.of(StateChanged)[-1].state == "faulted"
    assert "hold" in read_diary(tmp_path)
    assert open_run(order.run_file).provenance["outcome"] == "faulted"
    # Threads of the driver could go on to feed the controller: the process ends.
    deadline_s = time.monotonic() + 8.0
    while driven.cell.alive and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert not driven.cell.alive


def test_an_abort_is_answered_while_the_tracker_hangs(drive, order, tmp_path):
    driven = drive("tracker", "read", "hang", late=True)
    driven.cell.connect()
    driven.cell.begin(order)
    driven.until(MeasurementProgress, 20.0, 8)
    (tmp_path / "now").touch()
    driven.cell.send(CellVerb.ABORT)
    driven.until(RunClosed, 9.0)
    assert driven.of(StateChanged)[-1].state == "aborted"


def test_a_stop_that_hangs_is_named_and_leaves_the_cell_to_be_ended(drive):
    driven = drive("tracker", "stop", "hang")
    driven.cell.connect()
    with pytest.raises(DeviceError, match=rf"{NAME}.* stop\(\)"):
        driven.cell.try_tracker(TrackerTrial(500.0, 0.1))
    begin_s = time.monotonic()
    driven.cell.close()
    assert time.monotonic() - begin_s < 15.0


@pytest.mark.long  # the patience of the kernel
def test_a_driver_that_lets_nothing_else_run_is_ended_and_named(drive, order, tmp_path):
    driven = drive("motion", "status", "hang-alone", late=True)
    driven.cell.connect()
    driven.cell.begin(order)
    driven.until(MeasurementProgress, 20.0, 8)
    (tmp_path / "now").touch()
    while "cell-died" not in [f.code for f in driven.of(FaultReported)]:
        driven.events += driven.cell.poll(20.0)
    assert "hostile" in driven.of(FaultReported)[-1].text


SCRIPT = """
    import sys, time
    from pathlib import Path
    from tests.measurement.test_driver_border import Driven, MeasurementProgress
    from truepath.files.bundle.machine_file import read_machine
    from truepath.measurement.messages import CellConfig, CellVerb, MeasurementOrder
    from truepath.planning.lines.default_path import default_path

    if __name__ == "__main__":
        folder = Path(sys.argv[1])
        options = {"verb": "status", "fault": "hang", "at": str(folder / "now")}
        driven = Driven(CellConfig("hostile", {}, "hostile", options))
        driven.cell.connect()
        machine = read_machine(folder / "machine.json")
        file, path = str(folder / "run.sqlite"), default_path(machine, lines=20)
        order = MeasurementOrder("m", file, machine, path, reserve_bytes=0)
        driven.cell.begin(order)
        driven.until(MeasurementProgress, 20.0, 8)
        (folder / "now").touch()
        print(driven.cell.process_id, flush=True)
        time.sleep(1.0)
        if sys.argv[2] == "wait":
            time.sleep(60.0)
"""


@pytest.mark.parametrize("way", ["killed", "ends"])
def test_a_cell_does_not_outlive_its_parent_though_a_driver_hangs(
    site, tmp_path, mill, way
):
    from truepath.files.bundle.machine_file import encode_machine

    (tmp_path / "machine.json").write_bytes(encode_machine(mill))
    script = tmp_path / "parent.py"
    script.write_text(dedent(SCRIPT))
    paths = [str(site), str(ROOT), str(ROOT / "tests")]
    parent = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path), "wait" if way == "killed" else ""],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
    )
    try:
        cell = psutil.Process(int(parent.stdout.readline()))
        time.sleep(0.5)
        if way == "killed":
            parent.send_signal(signal.SIGKILL)
            parent.wait(5.0)
            cell.wait(2.5)
        else:
            parent.wait(15.0)  # as the service ends, asked by nobody else
            cell.wait(1.0)
    finally:
        parent.kill()
        parent.communicate()
    assert not psutil.pid_exists(cell.pid)


@pytest.mark.parametrize(
    ("device", "verb", "fault"),
    [
        ("tracker", "connect", "none"),
        ("tracker", "read", "none"),
        ("tracker", "read", "flat"),
        ("tracker", "take_link_bytes", "tuple"),
        ("tracker", "start", "exit"),
        ("motion", "connect", "raise"),
        ("motion", "connect", "unpicklable"),
        ("motion", "status", "none"),
        ("motion", "status", "raise"),
        ("motion", "status", "two-axes"),
        ("motion", "status", "texts"),
        ("motion", "status", "tuple"),
        ("thermometer", "read", "tuple"),
    ],
)
def test_what_breaks_or_lies_is_an_error_that_names_driver_call_and_remedy(
    device, verb, fault
):
    made = make_device(device, "hostile", {"verb": verb, "fault": fault})
    given = {"read": (0.1,), "start": (500.0,)} if device == "tracker" else {}
    with pytest.raises(DeviceError, match=rf"{NAME}.* {verb}\(\).*; update"):
        getattr(made, verb)(*given.get(verb, ()))


def test_what_is_of_the_drivers_own_class_arrives_as_what_everybody_knows():
    status = make_device("motion", "hostile", {"verb": "status", "fault": "own-class"})
    assert type(status.status()) is MotionStatus
    lost = make_device("motion", "hostile", {"verb": "connect", "fault": "own-error"})
    with pytest.raises(ConnectionLost, match="the cable is out") as caught:
        lost.connect()
    assert caught.type is ConnectionLost


def test_a_connect_that_leaves_the_program_leaves_the_cell_alive(drive):
    driven = drive("motion", "connect", "exit")
    with pytest.raises(DeviceError, match=rf"{NAME}.* connect\(\)"):
        driven.cell.connect()
    assert driven.cell.alive


def test_nonsense_while_it_measures_is_a_fault_that_names_its_driver(
    drive, order, tmp_path
):
    driven = drive("motion", "status", "none", late=True)
    driven.cell.connect()
    driven.cell.begin(order)
    driven.until(MeasurementProgress, 20.0, 8)
    (tmp_path / "now").touch()
    driven.until(RunClosed, 15.0)
    fault = driven.of(FaultReported)[0]
    assert (fault.code, NAME in fault.text) == ("driver", True)


def test_thermometers_that_break_cost_neither_the_cell_nor_the_devices(drive):
    driven = drive("thermometer", "read", "exit")
    assert driven.cell.connect()["motion"].model == "fake controller"
    driven.until(TemperaturesRead, 5.0)
    assert driven.of(TemperaturesRead)[0].readings == {}
    assert driven.cell.alive


def test_a_machine_that_nobody_would_stop_is_not_armed_whatever_is_allowed(
    drive, order, tmp_path
):
    """It has no watchdog, and its driver does not say that it stops unasked."""
    motion = {"watched": "false", "diary": str(tmp_path / "diary")}
    config = CellConfig("hostile", {}, "hostile", motion, allow_no_watchdog=True)
    driven = Driven(config)
    try:
        driven.cell.connect()
        driven.cell.begin(order)
        driven.until(RunClosed, 10.0)
        assert [f.code for f in driven.of(FaultReported)] == ["no-watchdog"]
        assert not (tmp_path / "diary").exists()
    finally:
        driven.cell.kill()
        driven.cell.close()
