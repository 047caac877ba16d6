"""What drivers of somebody else may do to a measurement: hang, lie and break."""

import time
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from driven_cell import Driven, measured_by_another
from hostile_drivers import POINTS
from measurement_fixtures import there_and_back
from plugin_site import NAME, install
from processes import until
from truepath.measurement import messages
from truepath.measurement.run_file.run_loader import open_run
from truepath_drivers.interfaces.errors import DeviceError

pytestmark = pytest.mark.fault_row(49)

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    folder = install(tmp_path / "site", POINTS)
    monkeypatch.syspath_prepend(ROOT)  # for the process of the cell
    monkeypatch.syspath_prepend(folder)
    return folder


@pytest.fixture
def order(order):
    return there_and_back(order, 8)


@pytest.fixture
def drive(tmp_path):
    with ExitStack() as stack:

        def start(device, verb, fault, **given):
            options = {"tracker": {}, "motion": {}, "thermometer": {}}
            options[device] = {"verb": verb, "fault": fault, **given}
            options["motion"]["diary"] = str(tmp_path / "diary")
            devices = "hostile", options["tracker"], "hostile", options["motion"]
            name = "hostile" if device == "thermometer" else ""
            sensors = {"thermometer_driver": name}
            sensors["thermometer_options"] = options["thermometer"]
            config = messages.CellConfig(*devices, **sensors, allow_no_watchdog=True)
            driven = stack.enter_context(Driven(config, beats=True))
            stack.callback(driven.cell.kill)
            return driven

        yield start


@pytest.fixture
def measuring(drive, order, tmp_path):
    def start(device, verb, fault):
        driven = drive(device, verb, fault, at=str(tmp_path / "now"))
        driven.cell.connect()
        driven.cell.begin(order)
        driven.until(lambda: len(driven.of(messages.MeasurementProgress)) >= 8)
        (tmp_path / "now").touch()
        return driven

    return start


@pytest.mark.parametrize(
    ("device", "verb"),
    [("motion", "status"), ("tracker", "read"), ("motion", "send_heartbeat")],
)
def test_a_call_that_hangs_in_motion_is_named(measuring, order, tmp_path, device, verb):
    driven = measuring(device, verb, "hang")
    driven.until_closed(12.0)
    faults = [fault.text for fault in driven.of(messages.FaultReported)]
    assert any(NAME in text and f"{verb}()" in text for text in faults), faults
    assert driven.states[-1] == "faulted"
    diary = (tmp_path / "diary").read_text().splitlines()
    assert "hold" in [line.split()[0] for line in diary]
    assert open_run(order.run_file).provenance["outcome"] == "faulted"
    # Threads of the driver could go on to feed the controller: the process ends.
    until(lambda: not driven.cell.alive, 8.0)


def test_an_abort_is_answered_while_the_tracker_hangs(measuring):
    driven = measuring("tracker", "read", "hang")
    driven.cell.send(messages.CellVerb.ABORT)
    driven.until_closed(9.0)
    assert driven.states[-1] == "aborted"


def test_a_stop_that_hangs_is_named_and_leaves_the_cell_to_be_ended(drive):
    driven = drive("tracker", "stop", "hang")
    driven.cell.connect()
    with pytest.raises(DeviceError, match=rf"{NAME}.* stop\(\)"):
        driven.cell.try_tracker(messages.TrackerTrial(500.0, 0.1))
    begin_s = time.monotonic()
    driven.cell.close()
    assert time.monotonic() - begin_s < 15.0


@pytest.mark.long  # the patience of the kernel
def test_a_driver_that_lets_nothing_else_run_is_ended_and_named(measuring):
    driven = measuring("motion", "status", "hang-alone")
    while "cell-died" not in driven.faults:
        driven.events += driven.cell.poll(20.0)
    assert "hostile" in driven.of(messages.FaultReported)[-1].text


@pytest.mark.parametrize("way", ["killed", "ends"])
def test_no_cell_outlives_its_parent_though_a_driver_hangs(site, tmp_path, order, way):
    options = {"verb": "status", "fault": "hang", "at": str(tmp_path / "now")}
    config = messages.CellConfig("hostile", {}, "hostile", options)
    given = tmp_path, config, order, site, ROOT / "tests" / "helpers"
    with measured_by_another(*given) as (parent, cell, told):
        for _ in range(8):
            next(told)
        (tmp_path / "now").touch()
        time.sleep(0.5)
        if way == "killed":
            parent.kill()
            parent.wait(5.0)
            cell.wait(2.5)
        else:
            (tmp_path / "end").touch()
            parent.wait(15.0)  # as the service ends, asked by nobody else
            cell.wait(1.0)
    assert not psutil.pid_exists(cell.pid)


def test_nonsense_while_it_measures_is_a_fault_that_names_its_driver(measuring):
    driven = measuring("motion", "status", "none")
    driven.until_closed(15.0)
    fault = driven.of(messages.FaultReported)[0]
    assert (fault.code, NAME in fault.text) == ("driver", True)


def test_thermometers_that_break_cost_neither_the_cell_nor_the_devices(drive):
    driven = drive("thermometer", "read", "exit")
    assert driven.cell.connect()["motion"].model == "fake controller"
    driven.until(lambda: bool(driven.of(messages.TemperaturesRead)), 20.0)
    assert driven.of(messages.TemperaturesRead)[0].readings == {}
    assert driven.cell.alive


def test_a_machine_that_nobody_would_stop_is_never_armed(drive, order, tmp_path):
    """It has no watchdog, and its driver does not say that it stops unasked."""
    driven = drive("motion", "", "", watched="false")
    driven.cell.connect()
    driven.cell.begin(order)
    driven.until_closed(10.0)
    assert driven.faults == ["no-watchdog"]
    assert not (tmp_path / "diary").exists()
