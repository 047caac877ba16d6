"""Streams in drivers: numbers, order, lines by characters, bytes for the Run."""

import numpy as np
import pytest

from truepath_drivers.streams.line_feeding import Line, LineFeed
from truepath_drivers.streams.numbering import SampleNumbers
from truepath_drivers.streams.received_bytes import ReceivedBytes
from truepath_drivers.streams.reordering import Reordering


@pytest.mark.parametrize("deviation", [0.0, 1e-4, -1e-3, 1e-2])
def test_numbers_from_times_follow_a_clock_that_deviates_from_its_rate(deviation, rng):
    number = np.delete(np.arange(5000), [70, 71, 900])
    time_s = 7.0 + number / (500.0 * (1.0 + deviation)) + rng.normal(0, 1e-4, 4997)
    numbers = SampleNumbers(rate_hz=500.0)
    assert [numbers.from_time(t) for t in time_s.tolist()] == number.tolist()


def test_a_late_time_has_the_number_before():
    numbers = SampleNumbers(rate_hz=100.0)
    assert [numbers.from_time(t) for t in (5.0, 4.99, 5.03)] == [0, -1, 3]


def test_a_counter_that_wraps_goes_on_and_one_that_restarts_goes_on():
    numbers = SampleNumbers(wraps=256)
    for counter, number in [(254, 254), (255, 255), (1, 257)]:
        assert numbers.from_counter(counter) == number
        assert numbers.accept(number)
    assert not numbers.accept(257)
    numbers = SampleNumbers()
    assert numbers.accept(numbers.from_counter(41))
    numbers.restart_counter()
    assert numbers.from_counter(0) == 42


def test_records_come_in_order_and_wait_no_longer_than_said(hand_clock):
    order, last, given = Reordering[str](most=3, longest_s=0.05), -1, []
    for number in (7, 9, 8, 11):
        order.add(number, 0.1 * number, f"{number}")
        while record := order.pop(last, more_waits=True):
            given.append(record)
            last = int(record)
    assert given == ["7", "8", "9"]
    assert order.pop(9) is None
    hand_clock.time_s += 0.06
    assert order.pop(9) == "11"


def test_lines_are_sent_as_the_buffer_has_room_and_a_barrier_waits():
    lines = [
        Line(b"123456\n"),
        Line(b"12\n", is_barrier=True),
        Line(b"3\n"),
        Line(b"4"),
    ]
    feed = LineFeed(lines, buffer_bytes=10)
    assert feed.take() == lines[:2]
    assert feed.take() == []
    assert feed.answer() == lines[0]
    assert feed.take() == []
    assert feed.answer() == lines[1]
    assert feed.take() == lines[2:]
    assert (feed.is_sent, feed.is_done) == (True, False)
    assert [feed.answer(), feed.answer(), feed.answer()] == [*lines[2:], None]
    assert feed.is_done


def test_the_newest_bytes_are_kept():
    received = ReceivedBytes(most=4)
    received.add(b"abc")
    received.add(b"def")
    assert (len(received), received.take(), received.take()) == (4, b"cdef", b"")
