"""What linuxcncrsh says word for word, programs and INI files, without a machine."""

import numpy as np
import pytest

from truepath.motion.nc_programs.gcode import LinuxCnc
from truepath_drivers.cnc.linuxcnc import driver, session
from truepath_drivers.cnc.linuxcnc.machine import parse_travel, read_ini
from truepath_drivers.cnc.linuxcnc.program import Program, write_program
from truepath_drivers.interfaces.errors import ConnectionLost, Refused, WrongDevice
from truepath_drivers.interfaces.records import MotionState, Path
from wires import HandPort

MACHINE = parse_travel("X 0 500, Y 0 400, Z -300 0")
AT = "10.000000 5.000000 -2.000000 0.000000 0.000000 0.000000"
BRAKING = "11.000000 5.000000 -2.000000 0.000000 0.000000 0.000000"
STANDS = {
    "estop": "OFF",
    "machine": "ON",
    "joint_homed": "YES YES YES NO NO NO",
    "program_status": "IDLE",
    "program_line": "0",
    "feed_override": "100",
    "joint_pos": AT,
    "abs_act_pos": AT,
}


class SaidByLinuxCnc:
    """Answers `get`, the last of several answers for ever."""

    def __init__(self, **said):
        self._said = {
            what: list(texts) if isinstance(texts, tuple) else [texts]
            for what, texts in (STANDS | said).items()
        }

    def read(self, what):
        texts = self._said[what]
        return texts.pop(0) if len(texts) > 1 else texts[0]


def look(*, tripped=False, **said):
    rsh = SaidByLinuxCnc(**said)
    return session.read_machine(rsh, MACHINE, is_tripped=tripped, was_at_rest=False)


def judge(*, tripped=False, **said):
    memory = driver.MotionMemory(ended=MotionState.FINISHED)
    program = Program("", "", (7, 9), (10.0, 5.0, -2.0))
    return memory.begin(program, (0.0, 0.0, 0.0)).assess(look(tripped=tripped, **said))


@pytest.mark.parametrize(
    ("said", "state", "reason"),
    [
        ({"estop": "ON"}, "estop", ""),
        ({"machine": "OFF"}, "not-ready", ""),
        ({"joint_homed": "YES NO YES NO NO NO"}, "unhomed", ""),
        ({"estop": "ON", "machine": "OFF"}, "estop", ""),
        ({"program_status": "RUNNING"}, "running", ""),
        ({"program_status": "PAUSED"}, "held", "operator"),
        ({"program_status": "PAUSED", "joint_pos": (AT, BRAKING)}, "running", ""),
        ({"joint_pos": (AT, BRAKING)}, "running", ""),
        ({}, "finished", ""),
        ({"joint_pos": BRAKING}, "aborted", ""),
        ({"program_status": "RUNNING", "tripped": True}, "held", "watchdog"),
    ],
)
def test_what_is_said_means_a_state(said, state, reason):
    status = judge(**said)
    assert (status.state, status.hold_reason) == (state, reason)


def test_position_line_override_and_reference_are_those_said():
    status = judge(program_status="RUNNING", program_line="9", feed_override="87.500")
    assert status.position == (10.0, 5.0, -2.0)
    assert (status.line, status.override) == (1, 0.875)
    for homed, referenced in (("YES", True), ("NO", False)):
        status = judge(machine="OFF", joint_homed=f"YES {homed} YES NO NO NO")
        assert (status.state, status.referenced) == (MotionState.NOT_READY, referenced)


@pytest.mark.parametrize("text", ["OFF", "1.0 nan? 2", "12.0 ERROR"])
def test_no_number_is_a_lost_connection(text):
    with pytest.raises(ConnectionLost, match="no numbers"):
        look(joint_pos=text)


@pytest.mark.parametrize(
    ("joints", "world", "follows"),
    [
        ((AT,), AT, False),
        ((AT, BRAKING), "10.500000 5.000000 -2.000000 0 0 0", False),
        ((AT, BRAKING), "11.500000 5.000000 -2.000000 0 0 0", True),
        ((AT,), "10.000000 5.000000 -2.020000 0 0 0", True),
        # Turned back between the readings of one look, or of two.
        ((AT,), (BRAKING, AT), False),
        ((AT,), (BRAKING, BRAKING, AT), False),
    ],
)
def test_a_followed_tip_is_told_from_a_motion_between_readings(joints, world, follows):
    rsh = SaidByLinuxCnc(joint_pos=joints, abs_act_pos=world)
    assert session.differs_from_joints(rsh, MACHINE) is follows


def test_a_program_is_the_path_to_a_reader_that_knows_only_the_control():
    rows = np.array([(20.1, 10, -10), (30, 10.25, -10)])
    path = Path(("X", "Y", "Z"), rows, np.full(2, 1234.5), np.array([0.3, 0.0]))
    program = write_program(path, ())
    motion_of_control = LinuxCnc().read(program.text)
    np.testing.assert_allclose(motion_of_control.position, path.position)
    np.testing.assert_allclose(motion_of_control.feed_mm_min, path.feed_mm_min)
    np.testing.assert_allclose(motion_of_control.dwell_s, path.dwell_s)
    text = program.text.splitlines()
    assert [text[line - 1].split()[0] for line in program.lines] == ["N1", "N2"]
    assert [program.find_row(line) for line in (0, *program.lines)] == [0, 0, 1]


def test_axes_travel_and_compensation_come_from_the_ini_file_or_by_hand(tmp_path):
    file = tmp_path / "gantry.ini"
    file.write_text(
        "[EMC]\nMACHINE = Big # ours\n[TRAJ]\nCOORDINATES = X Y Y C\n"
        "[KINS]\nKINEMATICS = trivkins coordinates=xyyc kinstype=BOTH\n"
        "[AXIS_X]\nMIN_LIMIT = -1\nMAX_LIMIT = 500\n"
        "[JOINT_0]\nMIN_LIMIT = 0\nMAX_LIMIT = 510\n[AXIS_Y]\nMAX_LIMIT = 300\n"
        "[JOINT_1]\nMIN_LIMIT = -20\nMAX_LIMIT = 400\n"
        "[JOINT_3]\nMIN_LIMIT = -360\nMAX_LIMIT = 360\n"
    )
    machine = read_ini(file)
    assert (machine.name, machine.axes) == ("Big", ("X", "Y", "C"))
    assert machine.travel == ((0, 500), (-20, 300), (-360, 360))
    assert (machine.joints, machine.joint_count) == ((0, 1, 3), 4)
    file.write_text(file.read_text() + "[TRAJ]\nLINEAR_UNITS = inch\n")
    with pytest.raises(Refused, match="not mm"):
        read_ini(file)
    with pytest.raises(Refused, match="ini_file"):
        read_ini(tmp_path / "none.ini")

    plain = "[KINS]\nKINEMATICS = trivkins coordinates=XY\n[JOINT_0]\nMIN_LIMIT = 0\n"
    plain += "[JOINT_1]\nMIN_LIMIT = 0\n"
    entries = {"": False, "COMP_FILE = x.tbl": True}
    entries |= {"BACKLASH = 0.0": False, "BACKLASH = 0.01": True}
    for entry, has in entries.items():
        file.write_text(f"{plain}{entry}\n")
        assert read_ini(file).has_compensation is has
    travel = parse_travel("X 0 500, c -360 360")
    assert (travel.axes, travel.has_compensation) == (("X", "C"), None)
    with pytest.raises(ValueError, match="'X 0'"):
        parse_travel("X 0, Y 0 1")


WELCOME = [b"HELLO ACK EMCNETSVR 1.1\r\n", b"set echo off\r\n"]
WELCOME += [b"SET VERBOSE ACK\n\r", b"SET ENABLE ACK\n\r"]
UNITS = b"USER_LINEAR_UNITS "


class AnsweringPort(HandPort):
    def __init__(self, answers):
        super().__init__()
        self._answers = list(answers)

    def write(self, data):
        self.due += self._answers.pop(0)


@pytest.mark.parametrize(
    ("answers", "error", "said"),
    [
        ([b"220 mail ready\r\n"], WrongDevice, "welcome"),
        ([*WELCOME, UNITS + b"INCH\r\n"], WrongDevice, "INCH"),
        ([*WELCOME, UNITS + b"MM\r\n", b"INIFILE emc.ini\r\n"], Refused, "ini_file"),
        ([*WELCOME, b"SET MODE ACK\r\n"], ConnectionLost, "out of step"),
    ],
)
def test_what_cannot_be_driven_is_told_at_connect(answers, error, said):
    controller = driver.LinuxCncController(host="h")
    controller._session._rsh._port = AnsweringPort(answers)
    with pytest.raises(error, match=said):
        controller.connect()
