"""A cell measures at 500 Hz while others take the processors."""

import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import psutil
import pytest

from driven_cell import config_of
from measuring import Measuring, measuring_on, order_of
from truepath.measurement.run_file.run_loader import open_run
from truepath_drivers.interfaces.records import Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

ROWS = np.array([[100.0, 100.0, 100.0], [300.0, 200.0, 100.0]] * 4)
TO_AND_FRO = Path(("X", "Y", "Z"), ROWS, np.full(8, 9000.0), np.full(8, 0.2))
HOG = "import os\nwhile True: [bytearray(1 << 20) for _ in range(64)]"


@contextmanager
def hogs(count):
    begun = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(count)]
    try:
        yield
    finally:
        for one in begun:
            one.kill()
            one.wait()


@pytest.mark.long
@pytest.mark.fault_row(31)
def test_every_sample_is_recorded_or_counted_as_lost(tmp_path, measured):
    with Bench(seed=12, rtu=False) as bench:
        order = replace(order_of(bench, tmp_path / "busy.sqlite"), commanded=TO_AND_FRO)
        cores = psutil.cpu_count() or 2
        with Measuring(config_of(bench), order) as measuring, hogs(2 * cores):
            closed = measuring.until_closed(timeout_s=120.0)
    assert closed.outcome in ("finished", "faulted")
    run = open_run(closed.run_file)
    gaps = int((np.diff(run.tracker.sequence) - 1).sum())
    assert closed.lost_samples >= gaps
    measured(f"{closed.lost_samples} of {closed.samples} samples lost, all counted")
    step_s = np.diff(run.tracker.device_time_s) / np.diff(run.tracker.sequence)
    np.testing.assert_allclose(step_s, 0.002, rtol=1e-3)
    assert measuring.faults or closed.outcome == "finished"


@pytest.mark.long
@pytest.mark.fault_row(8)
def test_a_late_link_is_no_broken_beam_and_no_silence(tmp_path):
    with (
        Bench(seed=12, tracker="tcp", speed=4.0) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
    ):
        proxy.harm(to_host=Harm(latency_s=0.2, jitter_s=0.1))
        file, options = tmp_path / "late.sqlite", proxy.options
        with measuring_on(bench, file, 2, tracker_options=options) as measuring:
            closed = measuring.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert measuring.faults == set()
