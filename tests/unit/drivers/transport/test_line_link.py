"""Lines over a port: every wait ends when it was said to."""

import pytest

from truepath_drivers.transport.line_link import LineLink


class SlowPort:
    """A byte each 0.3 s, or nothing; waits as long as it is asked to."""

    name = "a slow port"

    def __init__(self, clock, data):
        self._clock, self._data = clock, data
        self.waits_s = []

    def open(self):
        pass

    def read(self, timeout_s):
        self.waits_s.append(timeout_s)
        self._clock.time_s += min(timeout_s, 0.3)
        data, self._data = self._data[:1], self._data[1:]
        return data


@pytest.mark.parametrize("sent", [b"", b"noise without an end"])
def test_a_line_is_awaited_until_the_deadline_and_no_longer(hand_clock, sent):
    hand_clock.time_s = 50.0
    port = SlowPort(hand_clock, sent)
    link = LineLink(port)
    link.open()
    assert link.receive(51.0) is None
    assert hand_clock.time_s == pytest.approx(51.0)
    assert port.waits_s == pytest.approx([1.0, 0.7, 0.4, 0.1])


def test_a_line_in_pieces_comes_whole_and_the_next_one_at_once(hand_clock):
    link = LineLink(SlowPort(hand_clock, b"ok\r\n"))
    link.open()
    assert link.receive(5.0) == b"ok"
    assert hand_clock.time_s == pytest.approx(1.2)
    assert link.receive(hand_clock.time_s) is None
