"""What linuxcncrsh says of the machine, word for word, and the state it means."""

from __future__ import annotations

import pytest

from truepath_drivers.cnc.linuxcnc.machine import parse_travel
from truepath_drivers.cnc.linuxcnc.motion import MotionMemory
from truepath_drivers.cnc.linuxcnc.program import Program
from truepath_drivers.cnc.linuxcnc.readings import differs_from_joints, read_machine
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.interfaces.records import MotionState

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
    return read_machine(rsh, MACHINE, is_tripped=tripped, was_standing=False)


def judge(*, tripped=False, **said):
    memory = MotionMemory(ended=MotionState.FINISHED)
    program = Program("", "", (7, 9), (10.0, 5.0, -2.0))
    return memory.begin(program, (0.0, 0.0, 0.0)).judge(look(tripped=tripped, **said))


@pytest.mark.parametrize(
    ("said", "state", "reason"),
    [
        ({"estop": "ON"}, MotionState.ESTOP, ""),
        ({"machine": "OFF"}, MotionState.NOT_READY, ""),
        ({"joint_homed": "YES NO YES NO NO NO"}, MotionState.UNHOMED, ""),
        ({"estop": "ON", "machine": "OFF"}, MotionState.ESTOP, ""),
        ({"program_status": "RUNNING"}, MotionState.RUNNING, ""),
        ({"program_status": "PAUSED"}, MotionState.HELD, "operator"),
        (
            {"program_status": "PAUSED", "joint_pos": (AT, BRAKING)},
            MotionState.RUNNING,
            "",
        ),
        ({"joint_pos": (AT, BRAKING)}, MotionState.RUNNING, ""),
        ({}, MotionState.FINISHED, ""),
        ({"joint_pos": BRAKING}, MotionState.ABORTED, ""),
        ({"program_status": "RUNNING", "tripped": True}, MotionState.HELD, "watchdog"),
    ],
)
def test_what_is_said_means_a_state(said, state, reason):
    status = judge(**said)
    assert (status.state, status.hold_reason) == (state, reason)


@pytest.mark.parametrize(("homed", "referenced"), [("YES", True), ("NO", False)])
def test_a_machine_that_is_off_still_says_whether_it_is_referenced(homed, referenced):
    status = judge(machine="OFF", joint_homed=f"YES {homed} YES NO NO NO")
    assert (status.state, status.referenced) == (MotionState.NOT_READY, referenced)


def test_position_line_and_override_are_those_said():
    status = judge(program_status="RUNNING", program_line="9", feed_override="87.500")
    assert status.position == (10.0, 5.0, -2.0)
    assert (status.line, status.override) == (1, 0.875)


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
    assert differs_from_joints(rsh, MACHINE) is follows
