"""A link of a cell that measures goes dead: it stays open, nothing comes through."""

import time

import numpy as np
import pytest

from measuring import measuring_on
from truepath.measurement.messages import StateChanged
from truepath.measurement.run_file.run_loader import open_run
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

HOLE = Harm(is_hole=True)


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_controller_ends_in_a_machine_at_rest(tmp_path, measured):
    with (
        Bench(seed=12, speed=4.0, rtu=False) as bench,
        LinkProxy(bench.motion_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
    ):
        file, options = tmp_path / "dead.sqlite", proxy.options
        with measuring_on(bench, file, motion_options=options) as measuring:
            proxy.harm(to_host=HOLE, to_device=HOLE)
            begun_s = time.monotonic()
            measuring.until(lambda: onlooker.status().state == "held", timeout_s=3.0)
            measured(f"held after {time.monotonic() - begun_s:.2f} s")
            assert onlooker.status().hold_reason == "watchdog"
            measuring.until(lambda: bool(measuring.faults), timeout_s=4.0)
            closed = measuring.until_closed()
            here = onlooker.status().position
        assert onlooker.status().position == here
    assert (closed.outcome, closed.lost_samples) == ("faulted", 0)
    assert measuring.faults <= {"control-late", "no-answer", "link-lost"}
    assert (np.diff(open_run(closed.run_file).tracker.sequence) == 1).all()


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_tracker_holds_the_feed_within_a_second(tmp_path):
    with (
        Bench(seed=12, speed=4.0, tracker="tcp", rtu=False) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
    ):
        file, options = tmp_path / "dead.sqlite", proxy.options
        with measuring_on(bench, file, tracker_options=options) as measuring:
            proxy.harm(to_host=HOLE)
            told = measuring.of
            measuring.until(lambda: told(StateChanged)[-1].state == "paused", 1.5)
            assert onlooker.status().hold_reason == "command"
            proxy.harm()
            closed = measuring.until_closed()
    assert closed.outcome == "finished"
    assert measuring.faults == {"tracker-silent"}
    gaps = np.diff(open_run(closed.run_file).tracker.sequence) - 1
    assert closed.lost_samples == gaps.sum() > 500
