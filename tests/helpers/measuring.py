"""A cell that measures, as the tests of faults see it: what it has said so far."""

import time

import pytest

from driven_cell import Driven, config_of
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import MeasurementOrder
from truepath.planning.default_path import default_path
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.links.link_proxy import Harm

RATE_HZ = 500.0
LOST_DOUBLED_OR_HIT = [
    pytest.param(
        Harm(drop=0.15, double=0.15, swap=0.15),
        marks=pytest.mark.fault_row(2),
        id="drop-double-swap",
    ),
    pytest.param(
        Harm(noise=0.3, noise_bytes=20_000), marks=pytest.mark.fault_row(3), id="noise"
    ),
]
IN_PIECES = pytest.param(
    Harm(most_bytes=1), marks=pytest.mark.fault_row(4), id="one-byte"
)


def order_of(bench, file, lines=4):
    machine = machine_from_json(bench.machine)
    path = default_path(machine, lines=lines)
    return MeasurementOrder(file.stem, str(file), machine, path)


class Measuring(Driven):
    """Started as the service does, under way when entered, and closed at the end."""

    look_s = 0.02

    def __init__(self, config, order):
        super().__init__(config, spawns=True)
        self._order = order

    def __enter__(self):
        super().__enter__()
        try:
            self.who = self.cell.connect()
            self.begin(self._order, line=1)
        except BaseException:
            self.cell.close()
            raise
        return self

    @property
    def faults(self):
        return set(super().faults)


def measuring_on(bench, file, lines=4, **given):
    """Measure on a bench; given : what else a CellConfig takes."""
    return Measuring(config_of(bench, **given), order_of(bench, file, lines))


def read_through(tracker, proxy, harm):
    """Return what a driver reads while harm is done, and half a second after it."""
    tracker.start(RATE_HZ)
    blocks = [tracker.read(1.0)]
    for now, seconds in ((harm, 0.8), (Harm(), 0.5)):
        proxy.harm(to_host=now)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            blocks.append(tracker.read(0.2))
    tracker.stop()
    return TrackerSamples.join(blocks)
