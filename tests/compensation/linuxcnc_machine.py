"""A headless LinuxCNC with three ideal axes, closed off, for one program.

It has a network, shared memory, processes and a /tmp of its own, so several may run at
once and nothing is left behind. Positions are sampled each servo cycle (1 kHz).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

PORT = 5007
TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-310, 10)}

HAL = """\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net estop-loop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net tool-prep iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net tool-chg iocontrol.0.tool-change => iocontrol.0.tool-changed
loadrt sampler depth=4000 cfg=ffffff
addf sampler.0 servo-thread
"""
JOINT = """\
net motor{n} joint.{n}.motor-pos-cmd => joint.{n}.motor-pos-fb sampler.0.pin.{n}
net command{n} joint.{n}.pos-cmd => sampler.0.pin.{m}
"""
INI = """\
[EMC]
VERSION = 1.1
MACHINE = mill
[DISPLAY]
DISPLAY = linuxcncrsh --port 5007
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = mill.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.010
TOOL_TABLE = tool.tbl
[HAL]
HALFILE = mill.hal
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 50
MAX_LINEAR_VELOCITY = 200
DEFAULT_LINEAR_ACCELERATION = 1000
MAX_LINEAR_ACCELERATION = 1000
[KINS]
KINEMATICS = trivkins coordinates=XYZ
JOINTS = 3
"""
AXIS = """\
[AXIS_{axis}]
MAX_VELOCITY = 200
MAX_ACCELERATION = 1000
MIN_LIMIT = {low}
MAX_LIMIT = {high}
[JOINT_{n}]
COMP_FILE = {table}
COMP_FILE_TYPE = 0
TYPE = LINEAR
HOME = 0.0
HOME_OFFSET = 0.0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
MAX_VELOCITY = 200
MAX_ACCELERATION = 1000
MIN_LIMIT = {low}
MAX_LIMIT = {high}
FERROR = 5
MIN_FERROR = 1
"""
ISOLATED = (
    "mount --make-rprivate / && mount -t tmpfs -o mode=1777 tmpfs /tmp && "
    'ip link set lo up && exec "$@"'
)
# Runs inside, by the system's Python: starts LinuxCNC, runs the program, resumes stops.
DRIVE = r"""
import re, socket, subprocess, sys, time

class Rsh:
    def __init__(self):
        self.socket = socket.create_connection(("127.0.0.1", 5007), 20)
        self.buffer = b""
    def ask(self, line):
        self.socket.sendall(line.encode() + b"\r\n")
        while not (found := re.match(rb"[\r\n]*([^\r\n]+)[\r\n]", self.buffer)):
            chunk = self.socket.recv(4096)
            if not chunk:
                raise EOFError("linuxcncrsh closed the connection")
            self.buffer += chunk
        self.buffer = self.buffer[found.end():]
        return found.group(1).decode()

def until(good, seconds=20.0):
    end = time.monotonic() + seconds
    while not good():
        if time.monotonic() > end:
            sys.exit("LinuxCNC did not get there in time")
        time.sleep(0.02)

def listening():
    try:
        socket.create_connection(("127.0.0.1", 5007), 1).close()
        return True
    except OSError:
        return False

log = open("run.log", "w")
subprocess.Popen(["linuxcnc", "-r", "mill.ini"], stdin=subprocess.DEVNULL, stdout=log,
                 stderr=log, start_new_session=True)
until(listening)
rsh = Rsh()
rsh.ask("hello EMC test 1.0")
rsh.ask("set echo off")
rsh.ask("set verbose on")
for wish in ("enable EMCTOO", "estop off", "machine on", "mode manual", "home -1"):
    until(lambda: "NAK" not in rsh.ask("set " + wish))
until(lambda: "YES YES YES" in rsh.ask("get joint_homed"))
sampler = subprocess.Popen(["halsampler", "-t"], stdout=open("samples.txt", "w"))
for wish in ("mode auto", "open %s/program.ngc" % sys.argv[1], "run"):
    until(lambda: "NAK" not in rsh.ask("set " + wish))
runs = []
def ended():
    status = rsh.ask("get program_status")
    runs.append("RUNNING" in status)
    if "PAUSED" in status:
        rsh.ask("set resume")
    return any(runs) and "IDLE" in status
until(ended, 60.0)
end = time.monotonic() + 0.3
until(lambda: time.monotonic() > end)
sampler.terminate()
sampler.wait()
error = rsh.ask("get error")
if "OK" not in error and "PROGRAM" not in error:
    sys.exit(error)
"""


def why_not() -> str:
    """Say why no LinuxCNC can be started here; empty if one can."""
    if shutil.which("linuxcnc") is None:
        return "Debian's linuxcnc-uspace is not installed"
    probe = ["unshare", "--net", "--ipc", "--mount", "--pid", "--fork", "true"]
    if os.getuid() or subprocess.run(probe, capture_output=True).returncode:
        return "a LinuxCNC of its own needs root and namespaces"
    return ""


def run_program(
    program: str, tables: Mapping[str, str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return commanded and motor positions (n, 3), each millisecond of the program.

    tables : compensation table of each axis, type 0
    """
    with _folder() as folder:
        _write(folder, program, tables)
        answer = subprocess.run(
            ["unshare", "--net", "--ipc", "--mount", "--pid", "--fork", "--mount-proc",
             "sh", "-c", ISOLATED, "sh", "python3", "drive.py", str(folder)],
            cwd=folder,
            env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": str(folder),
                 "RTAPI_UID": "65534", "RTAPI_FIFO_PATH": str(folder / "run" / "fifo")},
            capture_output=True,
            text=True,
            timeout=120,
        )  # fmt: skip
        log = (folder / "run.log").read_text() if (folder / "run.log").exists() else ""
        assert answer.returncode == 0, answer.stdout + answer.stderr + log[-2000:]
        lines = (folder / "samples.txt").read_text().splitlines()
    rows = np.array([row for line in lines if len(row := line.split()) == 7], float)
    assert (np.diff(rows[:, 0]) == 1).all()
    return rows[:, 4:], rows[:, 1:4]


@contextmanager
def _folder() -> Iterator[Path]:
    # Not below /tmp, which is empty for what runs inside.
    folder = Path(tempfile.mkdtemp(prefix="linuxcnc-", dir="/var/tmp"))
    try:
        folder.chmod(0o755)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write(folder: Path, program: str, tables: Mapping[str, str]) -> None:
    (folder / "run").mkdir()
    (folder / "run").chmod(0o1777)
    hal, ini = HAL, INI
    for n, (axis, (low, high)) in enumerate(TRAVEL.items()):
        hal += JOINT.format(n=n, m=n + 3)
        ini += AXIS.format(n=n, axis=axis, low=low, high=high, table=f"{axis}.tbl")
        (folder / f"{axis}.tbl").write_text(tables[axis])
    (folder / "mill.hal").write_text(hal)
    (folder / "mill.ini").write_text(ini)
    (folder / "mill.var").touch()
    (folder / "tool.tbl").touch()
    (folder / "program.ngc").write_text(program)
    (folder / "drive.py").write_text(DRIVE)
