"""The driver of GRBL against its published rules, without a port and in no time."""

import contextlib
import socket
import threading

import numpy as np
import pytest

from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl import driver, motion, protocol
from truepath_drivers.conformance.motion import MOTION_CHECKS, PROVOKED_CHECKS
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.records import MotionState, Path
from truepath_drivers.transport.byte_port import BytePort
from truepath_drivers.transport.tcp_port import TcpPort
from truepath_simulators.cnc.grbl import GrblDevice


class GrblPort(BytePort):
    """Every board that it opens begins as it was left; `is_gone` pulls the cable."""

    def __init__(self, device: GrblDevice) -> None:
        self.device = device
        self.is_gone = False
        self.sent = b""
        self._lock = threading.RLock()  # a stop comes from another thread

    name = "grbl"

    def open(self) -> None:
        if self.is_gone:
            raise errors.ConnectionLost("no such port")

    def read(self, timeout_s: float) -> bytes:
        end_s = host_clock.now_s() + timeout_s
        while True:
            with self._lock:
                self.pass_time()
                said = self.device.take()
            if said:
                return said
            if host_clock.now_s() >= end_s:
                return b""
            host_clock.sleep_s(min(0.005, end_s - host_clock.now_s()))

    def write(self, data: bytes) -> None:
        with self._lock:
            self.pass_time()
            self.sent += data
            self.device.receive(data)

    def pass_time(self) -> None:
        if self.is_gone:
            raise errors.ConnectionLost("the port is gone")
        self.device.update(host_clock.now_s())

    def close(self) -> None:
        pass


AXES = ("X", "Y", "Z")
SETTINGS = [f"${n}={v}".encode() for n, v in GrblDevice().settings.items()]
BUILD = [b"[OPT:V,15,128]"]


@pytest.fixture
def device():
    return GrblDevice()


@pytest.fixture
def port(clock, device, monkeypatch):
    port = GrblPort(device)
    monkeypatch.setattr(driver, "make_port", lambda *_: port)
    return port


@pytest.fixture
def grbl(port):
    with driver.GrblController(port="") as grbl:
        grbl.home(10.0)
        yield grbl


def path_to(*rows, feed=1200.0, dwell_s=0.0):
    n = len(rows)
    position = np.array(rows, float)
    return Path(AXES, position, np.full(n, feed), np.full(n, dwell_s))


def write(path, settings, override=1.0):
    return list(
        protocol.write_blocks(path, (0.0, 0.0, 0.0), settings, lambda: override)
    )


def look_for(grbl, seconds, each_s=0.05):
    for _ in range(round(seconds / each_s)):
        status = grbl.status()
        host_clock.sleep_s(each_s)
    return status


def assert_held(status, reason):
    assert (status.state, status.hold_reason) == (MotionState.HELD, reason)


def resume_to_the_end(grbl):
    grbl.resume()
    assert grbl.wait(60.0).state is MotionState.FINISHED


@pytest.mark.parametrize("check", MOTION_CHECKS)
def test_it_keeps_what_the_interface_promises(grbl, check):
    check(lambda: driver.GrblController(port=""))


TROUBLES = {
    "an_alarm_ends_the_motion": lambda device: device.trip(1),
    "an_open_door_ends_the_motion": lambda device: device.open_door(True),
    "an_unhomed_machine_does_not_move": lambda device: device.restart(),
    "a_lost_reply_moves_nothing_twice": lambda device: setattr(device, "drops", 1),
    "a_blocked_device_is_told_in_time": lambda device: setattr(device, "is_mute", True),
}


@pytest.mark.parametrize("check", PROVOKED_CHECKS)
def test_it_keeps_in_trouble_what_the_interface_promises(grbl, device, check):
    provoke = TROUBLES[check.__name__]
    check(lambda: driver.GrblController(port=""), lambda: provoke(device))
    device.is_mute = False


def test_never_more_than_128_bytes_are_unread_and_every_line_is_sent_once(grbl, device):
    rows = [[-50.0, -50.0, -50.0], [-90.0, -20.0, -50.0], [-50.0, -50.0, -20.0]]
    grbl.load(path_to(*rows, feed=3000.0, dwell_s=0.2))
    grbl.start()
    assert (grbl.wait(60.0).state, device.overflows) == (MotionState.FINISHED, 0)
    lines = [line for line in device.executed if b"X" in line]
    assert len(set(lines)) == len(lines) > 30
    dwells = [line for line in device.executed if line.startswith(b"G4")]
    assert dwells == [b"G4P0.200"] * 3
    assert device.position == pytest.approx(rows[-1], abs=1e-3)


def assert_feed(grbl, device, mm_s, seconds, off_mm):
    """It keeps to its feed while it is asked three times a second."""
    here, begin_s = device.position.copy(), host_clock.now_s()
    look_for(grbl, seconds, each_s=0.33)
    grbl.status()
    driven_s = host_clock.now_s() - begin_s
    assert here[0] - device.position[0] == pytest.approx(mm_s * driven_s, abs=off_mm)


def test_it_keeps_to_the_feed_while_it_is_asked_three_times_a_second(grbl, device):
    grbl.move_to([-101.0, -1.0, -1.0], 3000.0)
    assert_feed(grbl, device, 50.0, seconds=1.5, off_mm=4.0)


def test_a_machine_without_homing_is_unlocked_and_never_referenced(port, device):
    device.settings[22], device.state = 0.0, "Idle"
    with driver.GrblController(port="") as grbl:
        assert grbl.status().referenced is False
        device.trip(3)
        grbl.reset()
        assert grbl.status().state is MotionState.IDLE
        with pytest.raises(errors.Refused, match=r"\$22=0"):
            grbl.home(1.0)


@pytest.mark.parametrize(("rows", "drops"), [(1, 1), (2, 1), (2, 1000)])
def test_lost_replies_end_the_motion_and_no_line_is_sent_twice(
    grbl, device, rows, drops
):
    grbl.load(path_to(*[[-20.0, -20.0, -20.0], [-60.0, -20.0, -20.0]][:rows]))
    grbl.start()
    look_for(grbl, 0.3)
    device.drops = drops
    status = grbl.wait(60.0)
    if drops == 1:
        assert status.position == pytest.approx((-20.0, -20.0, -20.0))
    ended = MotionState.FINISHED if rows == 1 else MotionState.ABORTED
    assert (status.state, status.referenced) == (ended, True)
    assert ("owes replies" in status.alarm) == (rows == 2)
    lines = [line for line in device.executed if b"X" in line]
    assert len(set(lines)) == len(lines)


def test_a_line_that_is_refused_ends_the_motion_with_its_number(grbl, monkeypatch):
    lines = [
        protocol.Block(b"G21\n"),
        protocol.Block(b"G61.1\n"),
        protocol.Block(b"G4P9\n"),
    ]
    monkeypatch.setattr(motion, "write_blocks", lambda *_: iter(lines))
    grbl.move_to([-20.0, -20.0, -20.0], 600.0)
    status = grbl.wait(5.0)
    assert status.state is MotionState.ABORTED
    assert status.alarm == "error:20 at G61.1, an unknown G-code"


def test_a_control_that_hangs_is_a_timeout_until_it_begins_anew(driving, device):
    device.is_mute = True
    with pytest.raises(errors.DeviceTimeout, match="does not answer"):
        driving.status()
    device.is_mute = False
    device.restart()
    status = driving.status()
    assert status.state is MotionState.UNHOMED
    assert "begun anew" not in status.alarm
    driving.home(10.0)
    assert driving.status().state is MotionState.FINISHED


def test_a_cable_that_is_pulled_in_motion_is_the_end_of_it(driving, port, device):
    port.is_gone = True
    with pytest.raises(errors.ConnectionLost):
        driving.status()
    port.is_gone = False
    host_clock.sleep_s(5.0)
    driving.connect()
    ended = driving.status().state, driving.status().alarm
    assert ended == (MotionState.ABORTED, "the connection was lost in motion")
    assert device.position[0] > -60.0


def test_what_a_dead_process_has_left_running_is_ended_at_connect(driving, device):
    assert device.state == "Run"
    other = driver.GrblController(port="")
    other.connect()
    assert (device.state, other.status().state) == ("Idle", MotionState.IDLE)
    other.close()


def test_homing_is_told_as_motion_and_can_be_aborted(grbl, device):
    grbl._motion.home(grbl._session.stops)
    assert grbl.status().state is MotionState.RUNNING
    grbl.abort()
    assert (grbl.status().alarm, device.state) == ("ALARM:6, homing was reset", "Alarm")


def test_work_coordinates_are_not_taken_for_those_of_the_machine(grbl, device):
    grbl.move_to([-50.0, -1.0, -1.0], 600.0)
    device.settings[10] = 0
    with pytest.raises(errors.DeviceTimeout):
        grbl.status()
    with pytest.raises(errors.WrongDevice, match=r"\$10=1"):
        driver.GrblController(port="").connect()
    host_clock.sleep_s(2.0)
    device.update(host_clock.now_s())
    assert device.state in ("Hold", "Idle")


def test_the_override_is_lowered_and_told(grbl, device):
    for _ in range(3):
        device.receive(b"\x91")
    look_for(grbl, 1.0)
    assert grbl.status().override == pytest.approx(1.3)
    grbl.limit_override(0.87)
    assert grbl.status().override == pytest.approx(0.87)
    device.receive(b"\x92" * 10)  # flags: they count once
    look_for(grbl, 1.0)
    assert grbl.status().override == pytest.approx(0.77)
    with pytest.raises(errors.Refused, match="10 %"):
        grbl.limit_override(0.05)


def test_beyond_the_travel_nothing_is_sent(grbl, port):
    before = port.sent
    with pytest.raises(errors.OutOfTravel):
        grbl.move_to([10.0, 0.0, 0.0], 600.0)
    assert port.sent == before


@pytest.mark.parametrize(
    ("line", "state", "stands"),
    [
        (b"<Idle|MPos:0.000,1.000,2.000|FS:0,0>", "Idle", True),
        (b"<Hold:1|MPos:0.000,1.000,2.000>", "Hold:1", False),
        (b"<Hold:0|MPos:0.000,1.000,2.000|Bf:15,128|Pn:P>", "Hold:0", True),
        (b"<Hold|MPos:0.000,1.000,2.000>", "Hold", False),
        (b"<Door:1|MPos:0.000,1.000,2.000|WCO:1.0,1.0,1.0>", "Door:1", True),
        (b"<Door:2|MPos:0.000,1.000,2.000>", "Door:2", False),
        (b"<Door:3|MPos:0.000,1.000,2.000>", "Door:3", False),
        (b"<Run|MPos:0.000,1.000,2.000|FS:500,0|Ov:100,100,100>", "Run", False),
        (b"<Jog|MPos:0.000,1.000,2.000>", "Jog", False),
        (b"<Tool|MPos:0.000,1.000,2.000>", "Tool", False),
        (b"<Idle|MPos:0.000,1.000|FS:0,0>", None, None),
        (b"<Idle|MP", None, None),
        (b"<Run|MPos:0.0,1.0,x>", None, None),
        (b"<Hold:|MPos:0.000,1.000,2.000>", None, None),
        (b"<Idle|WPos:0.000,1.000,2.000|FS:0,0>", None, None),
        (b"<>", None, None),
    ],
)
def test_reports_are_read_and_damaged_ones_are_none(line, state, stands):
    report = protocol.parse_report(line)
    assert (report is None) == (state is None)
    if report is not None:
        assert (report.state, report.is_at_rest) == (state, stands)
        assert report.position == (0.0, 1.0, 2.0)


def test_settings_that_are_lost_are_not_guessed():
    for number in (20, 130):
        with pytest.raises(errors.ConnectionLost, match=rf"\${number} did not"):
            protocol.parse_settings(
                [s for s in SETTINGS if b"$%d=" % number not in s], BUILD
            )
    with pytest.raises(errors.ConnectionLost, match="OPT"):
        protocol.parse_settings(SETTINGS, [b"[VER:1.1h.20190830:]"])


@pytest.mark.parametrize(
    ("letters", "first"),
    [
        (b"", (-300.0, 0.0)),
        (b"V", (-300.0, 0.0)),
        (b"Z", (0.0, 300.0)),  # homing sets the origin: the travel is turned over
        (b"VZ+", (0.0, 300.0)),
        (b"V*$#Z", (0.0, 300.0)),
    ],
)
def test_options_of_any_letters_are_read(letters, first):
    settings = protocol.parse_settings(
        [*SETTINGS, b"$23=1"], [b"[OPT:%b,35,255]" % letters]
    )
    assert (settings.queue, settings.options.encode()) == (35, letters)
    assert settings.travel == (first, (-200.0, 0.0), (-100.0, 0.0))
    assert settings.buffer_bytes == 128


def before_command(device, command, act):
    """Have something happen before each time that a system command is done."""

    def do_system(line):
        if line == command:
            act()
        usual(line)

    usual, device._do_system = device._do_system, do_system


def begin_anew(device):
    before_command(device, b"$N", device.restart)


def lose_limits(device):
    before_command(device, b"$I", lambda: device._say("[OPT:VL,15,128]"))


def make_noise(device):
    noise = iter([b"\x00\xfe%"] * 3)
    device.take = lambda: next(noise, b"")


UNFIT = [
    (errors.Refused, r"\$13=0", lambda device: device.settings.update({13: 1})),
    # Drives switched off at standstill.
    (errors.Refused, r"\$1=255", lambda device: device.settings.update({1: 25})),
    (errors.Refused, r"\$20=1", lambda device: device.settings.update({20: 0})),
    (errors.Refused, r"\$20=1", lose_limits),
    (errors.Refused, r"\$N0=G0X0", lambda device: setattr(device, "startup", "G0X0")),
    (errors.ConnectionLost, r"anew at \$N", begin_anew),
    (errors.WrongDevice, "SIM-G1", lambda device: None),
    (errors.WrongDevice, "baudrate", make_noise),
    (
        errors.DeviceTimeout,
        "nothing answers",
        TROUBLES["a_blocked_device_is_told_in_time"],
    ),
]


@pytest.mark.parametrize(("error", "said", "spoil"), UNFIT)
def test_what_cannot_be_driven_is_refused_at_connect(port, device, error, said, spoil):
    spoil(device)
    number = "other" if said == "SIM-G1" else ""
    with pytest.raises(error, match=said):
        driver.GrblController(port="", serial_number=number).connect()


@pytest.mark.parametrize("driven_s", [0.5, 6.0])
@pytest.mark.parametrize("acceleration", [10.0, 12.5, 50.0, 500.0])
def test_it_stands_soon_after_nobody_asks(grbl, port, device, acceleration, driven_s):
    device.settings |= dict.fromkeys((120, 121, 122), acceleration)
    grbl.close()
    grbl.connect()
    grbl.move_to([-290.0, -1.0, -1.0], 3000.0)
    driven_s = min(driven_s, 4.0 if acceleration > 20.0 else 6.0)
    look_for(grbl, driven_s)
    assert device.state == "Run"
    host_clock.sleep_s(2.0)
    port.pass_time()
    assert device.state == "Idle"
    assert stands(device)
    # From no faster than 16.5 mm/s it could brake on 0.9 s of lines of the slowest.
    slow = acceleration == 10.0
    most_mm = 16.5 * (driven_s + 2.0) if slow else 50.0 * (driven_s + 1.4)
    assert device.position[0] > -1.0 - most_mm
    # Asked again, it does not go on by itself.
    assert_held(grbl.wait(60.0), "watchdog")
    resume_to_the_end(grbl)


def test_pieces_last_as_long_at_any_override_and_in_any_queue():
    usual = protocol.parse_settings(SETTINGS, [b"[OPT:V,15,128]"])
    long = protocol.parse_settings(SETTINGS, [b"[OPT:V,35,1024]"])
    path = path_to([-100.0, 0.0, 0.0])
    pieces = len(write(path, usual))
    assert len(write(path, usual, 0.1)) == pytest.approx(10 * pieces, abs=30)
    assert len(write(path, long)) == pytest.approx(pieces * 35 / 15, abs=5)


def stands(device, seconds=5.0):
    """Whether it stays where it is while nobody asks."""
    device.update(host_clock.now_s())
    before = device.position.copy()
    host_clock.sleep_s(seconds)
    device.update(host_clock.now_s())
    return bool((device.position == before).all())


def when_asked(port, happen):
    """Have something happen once, when the driver asks next."""
    write = port.write

    def ask(data):
        if data == b"?" and happenings:
            happenings.pop()()
        write(data)

    happenings = [happen]
    port.write = ask


def in_a_thread(grbl, verb):
    """Run a stop in a thread of its own, up to where it waits for its turn."""
    stops = grbl._session.stops
    thread = threading.Thread(target=verb)

    def run():
        thread.start()
        while grbl._session.stops == stops:
            pass

    return run, thread


@pytest.fixture
def driving(grbl):
    grbl.move_to([-200.0, -1.0, -1.0], 1200.0)
    look_for(grbl, 0.5)
    return grbl


@pytest.mark.parametrize(
    ("deaf", "unasked_s"),
    [(0, 0.0), (1, 0.0), (2, 0.0), (1, 3.0)],
    ids=["heard", "lost", "lost-with-its-question", "lost-until-the-queue-is-dry"],
)
def test_a_lost_hold_is_sent_again_and_nothing_fed(
    driving, port, device, deaf, unasked_s
):
    device.deaf = deaf
    port.sent = b""
    driving.hold()
    host_clock.sleep_s(unasked_s)
    if deaf == 2:  # the question is lost as well
        with pytest.raises(errors.DeviceTimeout):
            driving.status()
        assert port.sent.endswith(b"!")
        host_clock.sleep_s(0.1)
        assert stands(device)
    assert driving.wait(5.0).hold_reason == "command"
    assert stands(device)
    assert driving.status().state is MotionState.HELD
    assert set(port.sent) <= set(b"!?")
    resume_to_the_end(driving)


@pytest.mark.parametrize("verb", ["hold", "abort"])
def test_a_resume_does_not_override_a_later_stop(driving, port, device, verb):
    driving.hold()
    driving.wait(5.0)
    stop, thread = in_a_thread(driving, getattr(driving, verb))
    when_asked(port, stop)
    port.sent = b""
    driving.resume()
    host_clock.join(thread, 10.0)
    assert b"~" not in port.sent
    assert stands(device)
    if verb == "hold":
        assert driving.status().state is MotionState.HELD
        resume_to_the_end(driving)
    else:
        assert driving.status().state is MotionState.ABORTED


@pytest.mark.parametrize("waits", [True, False])
def test_a_resume_waits_until_it_stands_and_is_no_uneven_motion(driving, waits):
    driving.hold()
    if waits:
        driving.wait(5.0)
    resume_to_the_end(driving)
    assert driving.take_events() == ()


def test_whoever_releases_our_hold_is_held_again(driving, device):
    driving.hold()
    driving.wait(5.0)
    device.receive(b"~")
    assert driving.wait(5.0).hold_reason == "command"
    assert stands(device)


@pytest.mark.parametrize("verb", ["hold", "abort"])
@pytest.mark.parametrize("begin", ["move_to", "start", "home"])
def test_nothing_begins_after_an_earlier_stop(grbl, port, device, begin, verb):
    grbl.load(path_to([-50.0, -50.0, -50.0]))
    stop, thread = in_a_thread(grbl, getattr(grbl, verb))
    when_asked(port, stop)
    arguments = {"move_to": ([-50.0, -1.0, -1.0], 600.0), "start": (), "home": (9.0,)}
    port.sent = b""
    with pytest.raises(errors.Refused, match="before it began"):
        getattr(grbl, begin)(*arguments[begin])
    host_clock.join(thread, 10.0)
    look_for(grbl, 1.0)
    assert stands(device)
    assert not {*b"GH"} & {*port.sent}


ALARMS = dict.fromkeys(range(1, 10), "") | {1: ", a limit switch was hit"}


@pytest.mark.parametrize("end", ["reset", "connect", "home"])
@pytest.mark.parametrize("code", ALARMS)
def test_every_alarm_ends_the_motion_and_homing_ends_it(driving, device, code, end):
    device.trip(code)
    with pytest.raises(errors.MotionFault, match=f"ALARM:{code}{ALARMS[code]}"):
        driving.wait(5.0)
    assert stands(device)
    for _ in range(2):
        status = driving.status()
        assert status.state is MotionState.ALARM
        assert f"ALARM:{code}" in status.alarm
        with pytest.raises(errors.MotionFault):
            driving.move_to([-50.0, -1.0, -1.0], 600.0)
    if code in (1, 2):  # of a limit: it is mute until its reset
        device.receive(b"?")
        assert device.take() == b""
    if end == "reset":
        driving.reset()
    elif end == "connect":
        driving.abort()
        driving = driver.GrblController(port="")
        driving.connect()
    if end != "home":
        status = driving.status()
        assert (status.state, status.referenced) == (MotionState.UNHOMED, False)
        with pytest.raises(errors.MotionFault, match="not homed"):
            driving.move_to([-10.0, -10.0, -10.0], 600.0)
    driving.home(10.0)
    assert driving.status().referenced is True


@pytest.mark.parametrize("is_open", [False, True])
def test_connect_drops_the_lines_behind_a_dwell_or_a_door_and_stops_a_homing(
    grbl, device, is_open
):
    device.receive(b"G4P3\nG53G1X-50F600\n")
    device.open_door(is_open)
    other = driver.GrblController(port="")
    if is_open:
        with pytest.raises(errors.Refused, match="door"):
            other.connect()
        device.open_door(False)
    other.connect()
    assert other.status().state is MotionState.IDLE
    other.resume()
    assert stands(device, 10.0)
    device.receive(b"$H\n")
    device._homing_s = 60.0
    driver.GrblController(port="").connect()
    assert device.state == "Alarm"


def home_slowly(grbl, device, act=lambda: None):
    """Let the next homing take a minute, in which something happens; give the verb."""
    begin = grbl._motion.home

    def home(*stops):
        begin(*stops)
        device._homing_s = 60.0
        act()

    grbl._motion.home = home
    return begin


def test_a_hold_in_homing_is_a_reset(grbl, port, device):
    home_slowly(grbl, device, grbl.hold)
    port.sent = b""
    with pytest.raises(errors.MotionFault, match="homing was reset"):
        grbl.home(100.0)
    assert device.state == "Alarm"
    assert port.sent.partition(b"$H\n")[2].startswith(b"\x18")
    assert not grbl._session.is_homing


def test_homing_that_takes_too_long_is_reset(grbl, port, device):
    begin = home_slowly(grbl, device)
    with pytest.raises(errors.DeviceTimeout, match="not homed"):
        grbl.home(1.0)
    host_clock.sleep_s(0.1)
    assert port.sent.endswith(b"\x18")
    assert (device.state, grbl.status().state) == ("Alarm", MotionState.ALARM)
    grbl._motion.home = begin
    grbl.home(10.0)
    assert grbl.status().state is MotionState.FINISHED


def test_homing_that_is_refused_or_fails_is_over(grbl, device):
    device.settings[22] = 0.0
    with pytest.raises(errors.MotionFault, match=r"error:5 at \$H"):
        grbl.home(10.0)
    assert grbl.status().state is MotionState.ABORTED
    device.settings[22], device.homing_fails = 1.0, 9
    with pytest.raises(errors.MotionFault, match="ALARM:9, homing found no switch"):
        grbl.home(10.0)
    grbl.hold()
    device.homing_fails = 0
    grbl.home(10.0)
    grbl.move_to([-5.0, -1.0, -1.0], 600.0)
    assert grbl.wait(60.0).state is MotionState.FINISHED


def test_at_a_door_it_moves_until_it_stands_and_on_its_way_back(driving, device):
    device.update(host_clock.now_s())
    device.open_door(True)
    assert (device._part, driving.status().state) == (2, MotionState.RUNNING)
    with pytest.raises(errors.Refused):
        driving.reset()
    with pytest.raises(errors.MotionFault, match="door"):
        driving.wait(5.0)
    device.open_door(False)
    assert_held(driving.status(), "operator")
    driving.resume()
    assert (device._part, driving.status().state) == (3, MotionState.RUNNING)
    assert driving.wait(60.0).state is MotionState.FINISHED


@pytest.mark.parametrize("at_once", [True, False])
def test_a_hold_on_the_way_back_from_a_door_holds(driving, port, device, at_once):
    device.open_door(True)
    look_for(driving, 0.5)
    device.open_door(False)
    driving.status()
    thread, write = threading.Thread(target=driving.hold), port.write

    def press(data):
        write(data)
        if data == b"~" and at_once and not thread.ident:
            thread.start()

    port.write = press
    driving.resume()
    if not at_once:
        driving.status()
        driving.hold()
    assert stands(device)
    assert driving.wait(5.0).hold_reason == "command"
    resume_to_the_end(driving)


def test_a_reset_ends_the_motion_that_was_under_way(driving, device):
    device.open_door(True)
    look_for(driving, 0.5)
    assert driving.status().state is MotionState.DOOR
    driving.reset()
    assert not driving._motion.is_under_way
    device.open_door(False)
    driving.resume()
    assert stands(device)
    assert driving.status().state is MotionState.ABORTED


def test_nothing_moves_before_the_units_are_acknowledged(grbl, port, device):
    port.sent, device.drops = b"", 1
    grbl.move_to([-50.0, -1.0, -1.0], 600.0)
    assert grbl.wait(10.0).state is MotionState.ABORTED
    assert b"G53" not in port.sent
    assert stands(device)


@pytest.mark.parametrize("is_held", [True, False])
def test_nothing_waits_behind_a_dwell_held_or_not(grbl, device, is_held):
    grbl.load(path_to([-5.0, -1.0, -1.0], [-9.0, -1.0, -1.0], dwell_s=5.0))
    grbl.start()
    look_for(grbl, 2.0)
    assert (device.state, device._rx) == ("Idle", b"")
    if is_held:
        grbl.hold()
        assert grbl.wait(5.0).state is MotionState.HELD
    assert stands(device, 20.0)
    if is_held:
        resume_to_the_end(grbl)


def test_a_low_override_does_not_make_it_drive_on_unasked(grbl, device):
    for _ in range(9):
        device.receive(b"\x92")
    look_for(grbl, 1.0)
    grbl.move_to([-200.0, -1.0, -1.0], 3000.0)
    look_for(grbl, 3.0)
    assert device.state == "Run"
    host_clock.sleep_s(1.5)
    assert stands(device)


def test_a_report_that_comes_late_is_not_taken_for_the_next(driving, device):
    take, said = device.take, []
    device.take = lambda: said.append(take()) or b""
    for _ in range(2):
        with pytest.raises(errors.DeviceTimeout):
            driving.status()
    late = [line for line in b"".join(said).splitlines(True) if b"<Run|" in line]
    assert len(late) == 2
    host_clock.sleep_s(3.0)

    def take_late():
        if b"<" not in (now := take()):
            return now
        late.append(now)
        return late.pop(0)

    device.take = take_late
    device.update(host_clock.now_s())
    assert driving.status().position == pytest.approx(device.position, abs=1e-3)


def test_replies_that_come_in_halves_are_whole(driving, device):
    take, rest = device.take, bytearray()

    def halves():
        rest.extend(take())
        half = bytes(rest[: (len(rest) + 1) // 2])
        del rest[: len(half)]
        return half

    device.take = halves
    assert driving.wait(60.0).state is MotionState.FINISHED


@pytest.mark.parametrize("homes", [1.0, 0.0, None])
def test_an_ended_motion_gets_no_further_line(driving, port, device, homes):
    if homes is None:
        device._drop_motion()
        device.state = "Alarm"
        device._say("ALARM:5")
        assert driving.status().state is MotionState.ALARM
        device.receive(b"$X\n")
    else:
        device.settings[22] = homes
        device.restart()
    port.sent = b""
    look_for(driving, 3.0)
    assert b"G" not in port.sent
    assert stands(device)
    driving.resume()
    assert stands(device)


@pytest.mark.parametrize("deaf", [0, 1, 1000])
def test_an_abort_ends_also_what_does_not_obey_a_hold(driving, device, deaf):
    device.deaf = deaf
    if deaf == 1000:
        device._hold = lambda: None
        device.deaf = 0
    driving.abort()
    look_for(driving, 2.0)
    status = driving.status()
    assert stands(device)
    if deaf == 1000:
        assert status.state is MotionState.ALARM
    else:
        assert (status.state, status.referenced) == (MotionState.ABORTED, True)
        assert device.state == "Idle"
        with pytest.raises(errors.Refused, match="no path"):
            driving.start()


def test_an_abort_is_never_told_as_a_hold(driving, monkeypatch):
    def hold_late(*, urgent=False):
        if urgent:
            host_clock.sleep_s(1.0)
        return hold(urgent=urgent)

    hold = driving._lock.hold
    monkeypatch.setattr(driving._lock, "hold", hold_late)
    thread = threading.Thread(target=driving.abort)
    thread.start()
    states = {look_for(driving, 0.05).state for _ in range(15)}
    host_clock.join(thread, 10.0)
    assert MotionState.HELD not in states
    assert driving.status().state is MotionState.ABORTED


def cut_off(port, line, count):
    """Have the port take so many bytes of a line, once, and then none in time."""
    write = port.write

    def cut(data):
        if line not in data:
            write(data)
            return
        port.write = write
        write(data[:count])
        raise errors.DeviceTimeout("takes no bytes")

    port.write = cut


@pytest.mark.parametrize(("line", "count"), [(b"G53", 20), (b"", 0)])
def test_a_line_or_an_abort_that_is_cut_off_ends_the_motion(
    driving, port, device, line, count
):
    cut_off(port, line, count)
    with pytest.raises(errors.DeviceTimeout):
        look_for(driving, 5.0) if line else driving.abort()
    status = driving.wait(10.0)
    assert status.state is MotionState.ABORTED
    assert "cut off" in status.alarm or not line
    assert stands(device)


def test_a_hold_at_standstill_does_not_keep_the_next_motion_from_going(grbl, device):
    grbl.hold()
    assert grbl.status().state is MotionState.FINISHED
    grbl.move_to([-5.0, -1.0, -1.0], 600.0)
    assert grbl.wait(60.0).state is MotionState.FINISHED


def test_two_questions_have_one_answer_and_two_line_ends_are_two_lines(grbl, device):
    device.take()
    device.receive(b"??")
    assert device.take().count(b"<") == 1
    assert grbl.status().state is MotionState.FINISHED
    device.take()
    device.receive(b"$N\r\n")
    assert device.take().count(b"ok") == 2


HAPPENINGS = {
    "lost replies": lambda port: setattr(port.device, "drops", 2),
    "lost characters": lambda port: setattr(port.device, "deaf", 2),
    "a door": lambda port: port.device.open_door(True),
    "a closed door": lambda port: port.device.open_door(False),
    "a limit": lambda port: port.device.trip(1),
    "a new begin": lambda port: port.device.restart(),
    "an operator's hold": lambda port: port.device.receive(b"!"),
    "a lower override": lambda port: port.device.receive(b"\x92"),
    "no cable": lambda port: setattr(port, "is_gone", True),
    "silence": lambda port: host_clock.sleep_s(2.0),
    "nothing": lambda port: None,
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("verb", ["hold", "abort"])
def test_after_a_stop_nothing_moves_whatever_happened(grbl, port, device, verb, seed):
    random = np.random.default_rng(seed)
    for _ in range(6):
        grbl.move_to([*random.uniform(-90.0, -10.0, 3)], 3000.0)
        for happening in random.choice(list(HAPPENINGS), 2):
            device.update(host_clock.now_s())
            HAPPENINGS[happening](port)
            for stop in (grbl.status, getattr(grbl, verb), grbl.status):
                with contextlib.suppress(errors.DeviceError):
                    stop()
            for _ in range(20):
                with contextlib.suppress(errors.DeviceError):
                    grbl.status()
                host_clock.sleep_s(0.06)
            port.is_gone = False
            assert stands(device, 2.0)
            grbl.connect()
            assert stands(device, 2.0)
        device.open_door(False)
        device.drops = device.deaf = 0
        grbl.close()
        grbl.connect()
        grbl.home(10.0)


def test_homing_whose_line_was_sent_with_an_error_is_reset(grbl, port, device):
    cut_off(port, b"$H\n", 3)
    with pytest.raises(errors.DeviceTimeout):
        grbl.home(10.0)
    host_clock.sleep_s(0.1)
    device.update(host_clock.now_s())
    assert (device.state, grbl.status().state) == ("Alarm", MotionState.ALARM)


def test_a_reply_that_is_owed_is_never_taken_for_that_of_the_next_motion(port, device):
    device.settings[22], device.state = 0.0, "Idle"
    with driver.GrblController(port="") as grbl:
        device.trip(3)
        device.drops = 1
        with pytest.raises(errors.DeviceTimeout, match=r"\$X"):
            grbl.reset()
        with pytest.raises(errors.Refused, match="owes a reply"):
            grbl.move_to([-5.0, -1.0, -1.0], 600.0)
        grbl.reset()
        grbl.move_to([-5.0, -1.0, -1.0], 600.0)
        assert grbl.wait(60.0).state is MotionState.FINISHED


def test_what_ran_dry_while_the_computer_slept_is_held(driving, port, device):
    port.pass_time = lambda: device.update(host_clock.now_s() + 3600.0)
    port.pass_time()
    dry_at = device.position.copy()
    look_for(driving, 0.2)
    assert_held(driving.status(), "watchdog")
    assert device.position == pytest.approx(dry_at)
    resume_to_the_end(driving)


@pytest.mark.parametrize("is_slow", [False, True])
def test_a_board_that_begins_anew_unheard_is_not_fed(grbl, port, device, is_slow):
    grbl.move_to([-100.0, -1.0, -1.0], 1200.0)
    if is_slow:
        drive_by_late_answers(grbl, device, 0.14, 0.3)
    else:
        look_for(grbl, 0.5)
        host_clock.sleep_s(0.3)
        port.pass_time()
    device._drop_motion()
    device.state, device.position = "Idle", np.zeros(3)
    look_for(grbl, 2.0)
    status = grbl.status()
    assert status.state is MotionState.ABORTED
    assert "has lost its queue" in status.alarm
    assert device.position == pytest.approx(np.zeros(3))


@pytest.mark.parametrize("verb", ["hold", "abort"])
@pytest.mark.parametrize("hangs", [False, True])
def test_a_stop_that_falls_into_a_begin_holds(grbl, port, device, verb, hangs):
    begin, feed = grbl._session.begin, grbl._session.feed

    def stop():
        with contextlib.suppress(errors.DeviceTimeout):
            getattr(grbl, verb)()

    run, thread = in_a_thread(grbl, stop)

    def begin_then_stop(*arguments, **options):
        begin(*arguments, **options)
        grbl._session.feed = feed_then_hang
        run()

    def feed_then_hang():
        grbl._session.feed = feed
        feed()
        device.is_mute = hangs

    grbl._session.begin = begin_then_stop
    port.sent = b""
    grbl.move_to([-200.0, -1.0, -1.0], 3000.0)
    host_clock.join(thread, 10.0)
    device.is_mute = False
    with contextlib.suppress(errors.DeviceTimeout):
        grbl.status()
    look_for(grbl, 2.0)
    assert b"G53" not in port.sent
    ended = MotionState.HELD if verb == "hold" else MotionState.ABORTED
    assert grbl.status().state is ended


def answer_late(device, late_s):
    """Have what the control says come later, piece by piece."""
    take, said = device.take, []

    def take_late():
        if now := take():
            said.append((host_clock.now_s() + late_s, now))
        return said.pop(0)[1] if said and said[0][0] <= host_clock.now_s() else b""

    device.take = take_late


@pytest.mark.parametrize(("late_s", "before"), [(0.2, 0), (0.45, 0), (0.45, 9)])
def test_one_look_is_short_and_feeds_little(driving, port, device, late_s, before):
    driving._session._late = before
    answer_late(device, late_s)
    begin_s, here = host_clock.now_s(), device.position.copy()
    with contextlib.suppress(errors.DeviceTimeout):
        driving.status()
    assert host_clock.now_s() - begin_s < 0.85
    host_clock.sleep_s(5.0)
    port.pass_time()
    assert here[0] - device.position[0] < 20.0 * 1.7


def test_a_control_that_answers_late_after_timeouts_is_heard_again(driving, device):
    driving._session._late = 9
    answer_late(device, 0.1)
    for _ in range(3):
        with contextlib.suppress(errors.DeviceTimeout):
            driving.status()
    assert driving.status().state is MotionState.RUNNING


def test_nothing_begins_while_it_closes(grbl, port, device, monkeypatch):
    def begin():
        with contextlib.suppress(errors.DeviceError):
            grbl.move_to([-200.0, -1.0, -1.0], 3000.0)
            look_for(grbl, 0.2)

    def hold_late(*, urgent=False):
        if urgent:
            host_clock.sleep_s(0.3)  # who waits for the lock gets it before
        return hold(urgent=urgent)

    thread, hold = threading.Thread(target=begin), grbl._lock.hold
    monkeypatch.setattr(grbl._lock, "hold", hold_late)
    when_asked(port, thread.start)
    grbl.close()
    host_clock.join(thread, 10.0)
    port.pass_time()
    assert stands(device)


def test_a_begin_of_before_a_close_is_refused_after_it(grbl):
    stops = grbl._session.stops
    grbl.close()
    grbl.connect()
    with pytest.raises(errors.Refused, match="before it began"):
        grbl._motion.begin(path_to([-50.0, -1.0, -1.0]), stops)


@pytest.mark.parametrize("verbs", [(), ("hold",), ("abort",)])
def test_the_operators_hold_is_his_also_after_a_motion_of_ours(driving, device, verbs):
    for verb in verbs:
        getattr(driving, verb)()
        driving.wait(5.0)
        driving.abort()
    device.receive(b"!")
    if verbs:
        assert driving.status().hold_reason == "operator"
    else:
        assert_held(driving.wait(5.0), "operator")
        resume_to_the_end(driving)


def test_a_dwell_may_last_longer_on_a_slow_board_and_has_a_limit(grbl, device):
    def do_slowly(line):
        do_block(line)
        if device._dwell_s:
            device._dwell_s *= 1.02

    do_block, device._do_block = device._do_block, do_slowly
    grbl.load(path_to([-5.0, -1.0, -1.0], [-9.0, -1.0, -1.0], dwell_s=200.0))
    grbl.start()
    assert grbl.wait(900.0).state is MotionState.FINISHED
    with pytest.raises(errors.Refused):
        grbl.load(path_to([-5.0, -1.0, -1.0], dwell_s=3001.0))


@pytest.mark.parametrize("reset", ["abort", "lost reply", "home"])
def test_a_lowered_override_outlasts_our_reset(grbl, device, reset):
    for character in [b"\x92"] * 6 + [b"\x94"] * 3:
        device.receive(character)
    look_for(grbl, 1.0)
    if reset == "home":
        grbl.home(10.0)
    else:
        grbl.move_to([-5.0, -1.0, -1.0], 600.0)
        look_for(grbl, 0.5)
        device.drops = int(reset != "abort")
        grbl.abort() if reset == "abort" else grbl.wait(60.0)
    assert (device._override, grbl.status().override) == (37, pytest.approx(0.37))


def test_a_network_keeps_no_lines_for_later():
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()
        grbl = driver.GrblController(port=port, host=host)
        line = grbl._session._link._port
        assert isinstance(line, TcpPort)
        line.open()
        assert line._socket is not None
        option = socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT
        assert line._socket.getsockopt(*option) == 1000
        line.close()


def drive_by_late_answers(grbl, device, late_s, each_s):
    """Drive a row whose lines come too slowly; the states that are told."""
    answer_late(device, late_s)
    states = set()
    for _ in range(10):
        states.add(grbl.status().state)
        device.update(host_clock.now_s())
        host_clock.sleep_s(each_s)
    return states


@pytest.mark.parametrize(("late_s", "each_s"), [(0.1, 0.4), (0.14, 0.3)])
def test_what_ran_dry_at_its_begin_goes_on_and_keeps_to_its_feed_again(
    grbl, device, caplog, late_s, each_s
):
    caplog.set_level("WARNING", "truepath_drivers")  # whatever a service has set
    take = device.take
    grbl.move_to([-200.0, -1.0, -1.0], 1200.0)
    assert drive_by_late_answers(grbl, device, late_s, each_s) == {MotionState.RUNNING}
    assert [event.kind for event in grbl.take_events()] == ["motion-uneven"]
    assert "row 1: the axes stood within a row" in caplog.text
    device.take = take
    look_for(grbl, 1.0, each_s=0.33)
    device.update(host_clock.now_s())
    assert_feed(grbl, device, 20.0, seconds=2.0, off_mm=1.0)
    assert grbl.wait(60.0).state is MotionState.FINISHED
    lines = [line for line in device.executed if b"X" in line]
    assert len(set(lines)) == len(lines)
    assert device.position == pytest.approx([-200.0, -1.0, -1.0])


def test_what_is_dry_and_answers_too_late_to_be_fed_is_held(grbl, device):
    grbl.move_to([-100.0, -1.0, -1.0], 1200.0)
    grbl.status()
    assert MotionState.HELD in drive_by_late_answers(grbl, device, 0.35, 0.05)
    assert grbl.status().hold_reason == "watchdog"


def test_what_slept_is_held_also_where_its_clock_stood(driving, clock, device):
    host_clock.sleep_s(0.6)  # until it sleeps, and after it
    clock.wall_jump_s += 3600.0
    device.update(host_clock.now_s())
    device.update(host_clock.now_s() + 3600.0)
    assert device.state == "Idle"
    dry_at = device.position.copy()
    device._now_s = host_clock.now_s()
    assert driving.wait(5.0).hold_reason == "watchdog"
    assert device.position == pytest.approx(dry_at)


def test_a_wall_clock_that_is_set_back_holds_nothing(driving, clock):
    clock.wall_jump_s -= 3600.0
    assert driving.wait(60.0).state is MotionState.FINISHED


def test_what_was_asked_without_an_answer_for_a_second_is_held(driving, port, device):
    take, device.take = device.take, bytes
    for _ in range(6):
        with pytest.raises(errors.DeviceTimeout):
            driving.status()
    assert device.state != "Run"
    stood_at = device.position.copy()
    device.take = take
    assert driving.wait(5.0).hold_reason == "watchdog"
    assert stands(device)
    assert device.position == pytest.approx(stood_at)
    resume_to_the_end(driving)


def test_an_override_that_a_person_raises_holds_nothing(grbl, device):
    for _ in range(9):
        device.receive(b"\x92")
    look_for(grbl, 1.0)
    grbl.load(path_to([-20.0, -1.0, -1.0], [-280.0, -1.0, -1.0], feed=3000.0))
    grbl.start()
    look_for(grbl, 1.0)
    device.receive(b"\x90")
    assert look_for(grbl, 1.2, each_s=0.4).state is MotionState.RUNNING
    assert look_for(grbl, 4.0).line == 1
    device.update(host_clock.now_s() + 3600.0)
    device._now_s = host_clock.now_s()
    look_for(grbl, 0.2)
    assert grbl.status().hold_reason == "watchdog"  # the next row is even again
    resume_to_the_end(grbl)


def test_a_board_that_was_another_one_while_it_was_held_dry_is_not_fed(driving, device):
    host_clock.sleep_s(3.0)
    assert driving.wait(5.0).hold_reason == "watchdog"
    device.position = np.zeros(3)
    driving.resume()
    assert driving.wait(5.0).state is MotionState.ABORTED
    assert device.position == pytest.approx(np.zeros(3))


def test_a_feed_whose_pieces_are_no_step_is_refused(port, device):
    device.settings |= dict.fromkeys((100, 101, 102), 80.0)
    with driver.GrblController(port="") as grbl:
        grbl.home(10.0)
        before = device.position.copy()
        with pytest.raises(errors.Refused, match="12 mm/min"):
            grbl.move_to([-5.0, -1.0, -1.0], 12.0)
        grbl.move_to([-5.0, -1.0, -1.0], 13.0)
        grbl.status()
        assert device.position == pytest.approx(before)
        host_clock.sleep_s(2.0)
        assert stands(device)
