"""Several machines measured at once by one service: samples lost, answers in time.

usage: benchmarks/bench_many_machines.py [MACHINES ...] [--seconds S]

Each machine streams at 500 Hz while its job is followed, an analysis computes beside
them, and one client asks for a job over and over. Everything runs on this computer:
the simulated trackers and controllers, two processes a machine, take their share of it.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from bench_samples_lost import (
    ENDED,
    FAST_FEED_MM_MIN,
    TRUEPATH,
    feed_for,
    keep_bundle,
    read_address,
    solving,
)

from truepath.client import Client

MACHINES = (1, 8)
SECONDS = 60.0
ASK_S = 0.05


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of so many machines at once.

    lost : samples of each machine; states : how its job ended
    cells, devices : of a core, by all cell processes and by all simulated devices
    p99_s, median_s : of GET /jobs/{id} while all streamed
    """

    machines: int
    samples: tuple[int, ...]
    lost: tuple[int, ...]
    states: tuple[str, ...]
    cells: float
    devices: float
    median_s: float
    p99_s: float
    load: float

    def __str__(self) -> str:
        return (
            f"{self.machines} machines: {sum(self.samples)} samples, lost "
            f"{list(self.lost)}, {', '.join(sorted(set(self.states)))}; cells "
            f"{100 * self.cells:.0f} % of a core, simulated devices "
            f"{100 * self.devices:.0f} %; GET /jobs/{{id}} median "
            f"{1e3 * self.median_s:.0f} ms, p99 {1e3 * self.p99_s:.0f} ms; load "
            f"{self.load:.1f}"
        )


def run_machines(machines: int, folder: Path, bundle: Path, feed: float) -> Outcome:
    """Measure with so many machines at once, an analysis beside them."""
    command = [TRUEPATH, "serve", "--simulated", "--port", "0"]
    command += ["--simulated-machines", str(machines)]
    command += ["--data-dir", folder / f"data-{machines}"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            client = Client(read_address(process))
            with solving(bundle, folder, 1):
                return _follow(client, process.pid, feed)
        finally:
            process.send_signal(signal.SIGTERM)


def _follow(client: Client, pid: int, feed: float) -> Outcome:
    names = _connect(client)
    with ThreadPoolExecutor(len(names)) as pool:
        jobs = list(pool.map(lambda name: _begin(client, name, feed), names))
    answers_s: list[float] = []
    loads = [os.getloadavg()[0]]
    shares = (0.0, 0.0)
    while True:
        begun = time.monotonic()
        first = client.get_job(jobs[0])
        answers_s.append(time.monotonic() - begun)
        if first["stage"] != "measuring" or first["state"] != "running":
            break
        shares = _processor_shares(pid)
        loads.append(os.getloadavg()[0])
        time.sleep(ASK_S)
    ended = [client.wait_for(i, *ENDED, timeout_s=900.0) for i in jobs]
    return Outcome(
        len(names),
        tuple(job["health"]["samples"] for job in ended),
        tuple(job["health"]["lost_samples"] for job in ended),
        tuple(job["state"] for job in ended),
        *shares,
        float(np.median(answers_s)),
        float(np.quantile(answers_s, 0.99)),
        float(np.mean(loads)),
    )


def _connect(client: Client) -> list[str]:
    """Connect one machine after another once their cells have started."""
    while True:
        machines = client.list_machines()
        if all(one["cell"] != "starting" for one in machines):
            break
        time.sleep(ASK_S)
    for one in machines:
        client.connect(one["id"])
    return [one["id"] for one in machines]


def _begin(client: Client, machine: str, feed_mm_min: float) -> str:
    job = client.create_job(
        kind="measure-otf", machine=machine, feed_mm_min=feed_mm_min
    )
    armed = client.arm(client.wait_for(job["id"], "ready", timeout_s=300.0))
    client.wait_for(armed["id"], "running", timeout_s=60.0)
    return armed["id"]


def _processor_shares(pid: int) -> tuple[float, float]:
    """Return the processor time over the age of cells and of simulated devices.

    What computes runs at a lower priority than the service, and is left out.
    """
    spawned = devices = 0.0
    service = psutil.Process(pid)
    for child in service.children(recursive=True):
        with suppress(psutil.Error):  # it may just have ended
            used, line = child.cpu_times(), " ".join(child.cmdline())
            share = (used.user + used.system) / (time.time() - child.create_time())
            if "simulators" in line:
                devices += share
            elif child.nice() == service.nice() and "spawn_main" in line:
                spawned += share
    return spawned, devices


def main() -> int:
    """Measure with each number of machines; 1 if a sample was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", type=int, default=MACHINES)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    options = parser.parse_args()
    feed = min(feed_for(options.seconds), FAST_FEED_MM_MIN)
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="truepath-bench-") as name:
        folder = Path(name)
        bundle = keep_bundle(folder)
        for machines in options.machines:
            outcomes.append(run_machines(machines, folder, bundle, feed))
            print(outcomes[-1], flush=True)
    few, many = outcomes[0], outcomes[-1]
    print(
        f"{many.machines} against {few.machines}: p99 x {many.p99_s / few.p99_s:.1f}, "
        f"cells x {many.cells / max(few.cells, 1e-9):.1f}"
    )
    return int(any(sum(one.lost) for one in outcomes))


if __name__ == "__main__":
    sys.exit(main())
