"""What a cell says to its parent: in order, the latest, and no state is dropped."""

import threading
from dataclasses import replace
from multiprocessing import Pipe

import numpy as np
import pytest

from processes import until
from truepath.measurement import messages
from truepath.measurement.process.cell_process import MAX_BLOCKS, Outbox
from truepath_drivers.interfaces.records import TrackerSamples


def block(number):
    samples = TrackerSamples.empty()
    return messages.BlockRecorded(replace(samples, sequence=np.array([number])))


def state(text=""):
    return messages.StateChanged(messages.CellState.PAUSED, text)


def test_a_parent_that_is_gone_does_not_hang_the_outbox():
    ours, theirs = Pipe()
    outbox = Outbox(theirs)
    ours.close()
    outbox.report(state())
    outbox.close(5.0)
    assert not outbox._thread.is_alive()
    theirs.close()


class Reluctant:
    """A pipe's end whose other side takes nothing until it is told to."""

    def __init__(self):
        self.taken = []
        self.taking = threading.Event()
        self.asked = threading.Event()

    def send(self, event):
        self.asked.set()
        assert self.taking.wait(20.0)
        self.taken.append(event)


@pytest.fixture
def reluctant():
    link = Reluctant()
    outbox = Outbox(link)
    outbox.report(state())
    assert link.asked.wait(5.0)  # one event is on its way, the others wait
    yield link, outbox
    link.taking.set()
    outbox.close(5.0)


def test_blocks_that_nobody_takes_are_dropped_and_counted_and_nothing_else(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS + 7):
        outbox.report(block(number))
    outbox.report(messages.FaultReported("beam-lost", "", ""))
    outbox.report(state())
    assert outbox.dropped_blocks == 7
    link.taking.set()
    outbox.close(5.0)
    blocks = [e for e in link.taken if isinstance(e, messages.BlockRecorded)]
    assert [b.block.sequence[0] for b in blocks] == list(range(MAX_BLOCKS))
    names = [type(event).__name__ for event in link.taken]
    others = [name for name in names if name != "BlockRecorded"]
    assert others == ["StateChanged", "FaultReported", "StateChanged"]


def test_a_slow_parent_gets_the_latest_and_every_state_however_many_wait(reluctant):
    link, outbox = reluctant
    for number in range(2000):
        done = (number, 10, "lines", "measuring", 0.0, 0.0)
        outbox.report(messages.MeasurementProgress(*done))
        outbox.report(state(str(number)))
    link.taking.set()
    outbox.close(5.0)
    states = [e.text for e in link.taken[1:] if isinstance(e, messages.StateChanged)]
    assert states == [str(n) for n in range(2000)]
    done = [e.done for e in link.taken if isinstance(e, messages.MeasurementProgress)]
    assert done == [1999]


def test_there_is_room_for_blocks_again_once_they_are_taken(reluctant):
    link, outbox = reluctant
    for number in range(MAX_BLOCKS):
        outbox.report(block(number))
    link.taking.set()
    until(lambda: len(link.taken) > MAX_BLOCKS)
    outbox.report(block(MAX_BLOCKS))
    outbox.close(5.0)
    assert (outbox.dropped_blocks, link.taken[-1].block.sequence[0]) == (0, MAX_BLOCKS)
