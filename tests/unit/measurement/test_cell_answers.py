"""The parent's handle of a cell process: answers, and the events around them."""

from types import SimpleNamespace

import pytest

from truepath.measurement import messages
from truepath.measurement.process import cell as cell_module
from truepath_drivers.interfaces.errors import ConnectionLost

BEFORE = messages.StateChanged(messages.CellState.CONNECTING)
AFTER = [
    messages.StateChanged(messages.CellState.READY),
    messages.SensorsTried(refused="none"),
]
TRIAL = messages.TrackerTrial(500.0)
TRIED = messages.TrackerTried(9, 9, 0, 1800.0)


class ReadyLink:
    """The pipe of a process that has said everything before it is asked."""

    def __init__(self, events, clock):
        self._events, self._clock = list(events), clock
        self.sent = []

    def send(self, command):
        self.sent.append(command)

    def poll(self, timeout_s):
        if not self._events:
            self._clock.time_s += timeout_s
        return bool(self._events)

    def recv(self):
        return self._events.pop(0)


@pytest.fixture
def start(monkeypatch, hand_clock):
    """Start a cell whose process says these events, all of which one read finds."""

    def start(*events):
        link = ReadyLink(events, hand_clock)
        process = SimpleNamespace(link=link, alive=True, process_id=1)
        monkeypatch.setattr(cell_module, "ChildProcess", lambda *_, **__: process)
        return cell_module.Cell(messages.CellConfig("streaming", {}, "modbus", {}))

    return start


@pytest.mark.parametrize(
    ("verb", "given", "answer", "said"),
    [
        ("connect", [], messages.Connected({}), {}),
        ("try_tracker", [TRIAL], TRIED, TRIED),
    ],
    ids=["connect", "try_tracker"],
)
def test_events_read_together_with_an_answer_are_kept(start, verb, given, answer, said):
    cell = start(BEFORE, answer, *AFTER)
    assert getattr(cell, verb)(*given) == said
    assert cell.poll(0.0) == [BEFORE, *AFTER]
    assert cell.poll(0.0) == []


def test_events_read_together_with_a_refusal_are_kept(start):
    cell = start(BEFORE, messages.ConnectRefused("ConnectionLost", "/dev/gone"), *AFTER)
    with pytest.raises(ConnectionLost, match="/dev/gone"):
        cell.connect()
    assert cell.poll(0.0) == [BEFORE, *AFTER]
