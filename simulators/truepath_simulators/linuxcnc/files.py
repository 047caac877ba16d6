"""The INI and HAL files of a LinuxCNC machine with ideal drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

_HAL = """\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net estop-loop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net tool-prep iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net tool-chg iocontrol.0.tool-change => iocontrol.0.tool-changed
loadrt sampler depth=4000 cfg={pins}
addf sampler.0 servo-thread
"""
_JOINT_HAL = """\
net motor{n} joint.{n}.motor-pos-cmd => joint.{n}.motor-pos-fb sampler.0.pin.{n}
net command{n} joint.{n}.pos-cmd => sampler.0.pin.{m}
"""
_INI = """\
[EMC]
VERSION = 1.1
MACHINE = {name}
[DISPLAY]
DISPLAY = linuxcncrsh --port 5007
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = machine.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.010
TOOL_TABLE = tool.tbl
[HAL]
HALFILE = machine.hal
{watchdog}[TRAJ]
COORDINATES = {coordinates}
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 50
MAX_LINEAR_VELOCITY = 200
DEFAULT_LINEAR_ACCELERATION = 1000
MAX_LINEAR_ACCELERATION = 1000
DEFAULT_ANGULAR_VELOCITY = 60
MAX_ANGULAR_VELOCITY = 90
[KINS]
KINEMATICS = {kinematics}
JOINTS = {joints}
"""
_AXIS_INI = """\
[AXIS_{axis}]
MAX_VELOCITY = {speed}
MAX_ACCELERATION = 1000
MIN_LIMIT = {low}
MAX_LIMIT = {high}
[JOINT_{n}]
{table}TYPE = {kind}
HOME = 0.0
HOME_OFFSET = 0.0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
MAX_VELOCITY = {speed}
MAX_ACCELERATION = 1000
MIN_LIMIT = {low}
MAX_LIMIT = {high}
FERROR = 5
MIN_FERROR = 1
"""
_WATCHDOG_INI = """\
[TRUEPATH]
WATCHDOG = truepath_watchdog.py
LISTEN = 127.0.0.1:5017
"""
_SPEED = {"LINEAR": 200, "ANGULAR": 90}


@dataclass(frozen=True, slots=True)
class LinuxCncMachine:
    """A machine in LinuxCNC's files; one joint per axis.

    travel : lowest and highest position of each axis, in LinuxCNC's order
    tables : compensation table (type 0) of an axis
    kinematics : empty if axes are joints
    hal, ini : lines to add
    """

    travel: Mapping[str, tuple[float, float]]
    tables: Mapping[str, str] = field(default_factory=dict)
    kinematics: str = ""
    hal: str = ""
    ini: str = ""
    name: str = "mill"

    def write_files(self, *, watchdog: bool) -> dict[str, str]:
        """Files by name; `machine.ini` is the one to start."""
        axes = "".join(self.travel)
        hal = _HAL.format(pins="f" * 2 * len(axes))
        hal += "".join(
            _JOINT_HAL.format(n=n, m=n + len(axes)) for n in range(len(axes))
        )
        ini = _INI.format(
            name=self.name,
            coordinates=" ".join(axes),
            kinematics=self.kinematics or f"trivkins coordinates={axes}",
            joints=len(axes),
            watchdog="HALFILE = truepath.hal\n" if watchdog else "",
        )
        ini += "".join(self._write_axis(n, axis) for n, axis in enumerate(axes))
        tables = {f"{axis}.tbl": text for axis, text in self.tables.items()}
        return {
            "machine.hal": hal + self.hal,
            "machine.ini": ini + _WATCHDOG_INI * watchdog + self.ini,
            "machine.var": "",
            "tool.tbl": "",
            **tables,
        }

    def _write_axis(self, n: int, axis: str) -> str:
        low, high = self.travel[axis]
        kind = "ANGULAR" if axis in "ABC" else "LINEAR"
        table = f"COMP_FILE = {axis}.tbl\nCOMP_FILE_TYPE = 0\n"
        return _AXIS_INI.format(
            n=n,
            axis=axis,
            low=low,
            high=high,
            kind=kind,
            speed=_SPEED[kind],
            table=table if axis in self.tables else "",
        )
