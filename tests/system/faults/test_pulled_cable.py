"""A tracker's cable is pulled while a cell measures; its port is renumbered."""

import os
import time

import pytest

from driven_cell import Driven, config_of
from measuring import order_of
from truepath.measurement import messages
from truepath.measurement.run_file.run_loader import open_run
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import LinkProxy


def point_to(link, proxy):
    """Let the name of the device lead to the terminal that it has now."""
    link.unlink(missing_ok=True)
    link.symlink_to(proxy.options["port"])


@pytest.mark.long
@pytest.mark.fault_row(6)
def test_a_pulled_cable_ends_the_run_and_a_renumbered_port_is_opened_by_name(tmp_path):
    link = tmp_path / "tracker-by-id"
    with Bench(seed=3, speed=10.0, rtu=False) as bench:
        options = {**bench.tracker_options, "port": str(link)}
        with Driven(config_of(bench, tracker_options=options), spawns=True) as driven:
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                was = driven.cell.connect()
                driven.begin(order_of(bench, tmp_path / "pulled.sqlite", 6))
                driven.until(lambda: bool(driven.of(messages.MeasurementProgress)))
                time.sleep(0.5)
                taken = os.readlink(link)
                keep = os.open(taken, os.O_RDWR | os.O_NOCTTY)  # another number next
            closed = driven.until_closed()
            assert closed.outcome == "faulted"
            fault = driven.of(messages.FaultReported)[0]
            assert str(link) in fault.text + closed.failure
            run = open_run(closed.run_file)
            assert len(run.tracker.sequence) == closed.samples > 0
            driven.events.clear()
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                assert os.readlink(link) != taken
                os.close(keep)
                assert driven.cell.connect() == was
                driven.begin(order_of(bench, tmp_path / "again.sqlite", 2))
                closed = driven.until_closed()
            assert (closed.outcome, closed.lost_samples) == ("finished", 0)
