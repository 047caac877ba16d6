"""The driver `modbus` moves a real LinuxCNC through the register map before it."""

from __future__ import annotations

import numpy as np
import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.interfaces.errors import MotionFault
from truepath_drivers.interfaces.records import MotionState, Path
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence
from truepath_simulators.scenario import load_machine

ABSENT = explain_absence()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none"),
]
TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-10, 310)}


@pytest.fixture(scope="module")
def rig():
    machine = LinuxCncMachine(TRAVEL)
    with LinuxCncRig(machine, gateway=load_machine("demo")) as rig:
        with ModbusController(**rig.modbus_options) as controller:
            with pytest.raises(MotionFault, match="release it"):
                controller.move_to((1, 1, 1), 3000)
            controller.reset()
            with pytest.raises(MotionFault, match="home it"):
                controller.move_to((1, 1, 1), 3000)
            controller.home(10.0)
        yield rig


@pytest.mark.parametrize("check", MOTION_CHECKS, ids=lambda c: c.__name__)
def test_it_conforms(rig, check):
    check(lambda: ModbusController(**rig.modbus_options))


def test_rows_are_those_of_the_program(rig):
    rows = np.array([[20.0, 20, 30], [30, 30, 30], [40, 20, 10]])
    path = Path(("X", "Y", "Z"), rows, np.full(3, 3000.0), np.array([0.2, 0, 0.2]))
    with ModbusController(**rig.modbus_options) as controller:
        controller.load(path)
        controller.start()
        seen = []
        while (status := controller.status()).state is MotionState.RUNNING:
            controller.send_heartbeat()
            seen.append(status.line)
        assert (status.state, status.position) == (MotionState.FINISHED, (40, 20, 10))
        assert sorted(set(seen)) == [0, 1, 2]
        assert seen == sorted(seen)


def test_its_override_is_lowered(rig):
    with ModbusController(**rig.modbus_options) as controller:
        assert controller.status().override == 1.0
        for largest, left in ((0.5, 0.5), (1.0, 0.5)):
            controller.limit_override(largest)
            assert controller.status().override == left
