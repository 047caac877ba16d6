"""Samples lost of a stream, with API, page and solver at work.

usage: benchmarks/bench_samples_lost.py [HZ:SECONDS ...] [--solvers N] [--write]
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import write_section

from truepath.child_process import BACKGROUND_NICENESS
from truepath.cli.calibration import follow
from truepath.client import Client
from truepath.files.bundle.machine_file import machine_from_json
from truepath.planning.default_path import default_path
from truepath_simulators.machine_file import load_machine

TRUEPATH = Path(sys.executable).with_name("truepath")
DOCUMENT = Path(__file__).parents[1] / "docs" / "measurement.md"
FAST_FEED_MM_MIN = 15_000
STREAMS = ("500:600", "1000:60", "2000:60", "5000:60")
READERS = 10  # open event streams, as of ten tabs
SEEN = ("/machines/current", "/jobs", "/runs")
ENDED = ("succeeded", "failed", "faulted", "aborted", "interrupted")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a stream, and what the processors had to do meanwhile.

    cell_share : of a core, by the process that reads
    load : programs that wanted a processor, on average
    """

    rate_hz: int
    samples: int
    lost: int
    cell_share: float
    load: float


@contextmanager
def service(folder: Path, rate_hz: int) -> Iterator[tuple[Client, int]]:
    """Run the service with simulated devices; yield a client and its process id."""
    machine = dict(load_machine("demo"))
    machine["tracker"] = {**machine["tracker"], "rate_hz": rate_hz}
    file = folder / f"machine-{rate_hz}.json"
    file.write_text(json.dumps(machine), encoding="utf-8")
    command = [TRUEPATH, "serve", "--simulated", "--port", "0"]
    with subprocess.Popen(
        [*command, "--data-dir", folder / f"data-{rate_hz}-{time.monotonic_ns()}"],
        env={**os.environ, "TRUEPATH_MACHINE_FILE": str(file)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        client = Client(read_address(process))
        try:
            yield client, process.pid
        finally:
            process.send_signal(signal.SIGTERM)


def read_address(process: subprocess.Popen[str]) -> str:
    """Return the address that a service prints once it answers."""
    assert process.stdout is not None
    return next(
        found[1]
        for line in process.stdout
        if (found := re.search(r"page +(http://\S+)/", line))
    )


def feed_for(duration_s: float) -> float:
    """Return the feed at which the usual path takes so long."""
    path = default_path(machine_from_json(load_machine("demo")))
    moving_s = duration_s - float(path.dwell_s.sum())
    way_mm = np.linalg.norm(np.diff(path.position, axis=0), axis=1).sum()
    return min(60.0 * float(way_mm) / max(moving_s, 1.0), FAST_FEED_MM_MIN)


def measure(client: Client, feed_mm_min: float) -> str:
    client.connect()
    job_id = client.create_job(kind="measure-otf", feed_mm_min=feed_mm_min)["id"]
    client.arm(client.wait_for(job_id, "ready", timeout_s=60.0))
    return job_id


def follow_measurement(client: Client, job_id: str, pid: int, rate_hz: int) -> Outcome:
    """Follow a measurement to its end, asking the API for this and that."""
    share, loads = 0.0, [os.getloadavg()[0]]
    for job in follow(client, job_id, period_s=0.2):
        if job["stage"] == "measuring" and job["state"] == "running":
            share = cell_share(pid)
            loads.append(os.getloadavg()[0])
            for address in SEEN:
                client.download(f"/api/v1{address}")
        elif job["state"] in ENDED or job["stage"] != "measuring":
            health = job["health"]
            lost, load = health["lost_samples"], float(np.mean(loads))
            return Outcome(rate_hz, health["samples"], lost, share, load)
    raise AssertionError("a job that is followed ends")


def cell_share(pid: int) -> float:
    """Return the processor time of the busiest spawned child over its age."""
    shares = [0.0]
    for child in psutil.Process(pid).children():
        with suppress(psutil.Error):  # it may just have ended
            used = child.cpu_times()
            if "spawn_main" in " ".join(child.cmdline()):
                age_s = time.time() - child.create_time()
                shares.append((used.user + used.system) / age_s)
    return max(shares)


@contextmanager
def solving(bundle: Path, folder: Path, solvers: int) -> Iterator[None]:
    """Analyse a measurement over and over, behind other work as in the service."""
    stopping = threading.Event()

    def solve(number: int) -> None:
        command = ["nice", "-n", str(BACKGROUND_NICENESS), TRUEPATH, "analyse"]
        command += [bundle, "-o", folder / f"solved-{number}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        while not stopping.is_set():
            with subprocess.Popen(command, **quiet) as process:
                while process.poll() is None and not stopping.wait(0.1):
                    pass
                process.kill()

    threads = [
        threading.Thread(target=solve, args=(number,)) for number in range(solvers)
    ]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stopping.set()
        for thread in threads:
            thread.join()


@contextmanager
def reading(client: Client) -> Iterator[None]:
    host = client.address.removeprefix("http://")
    streams = []
    for _ in range(READERS):
        connection = http.client.HTTPConnection(host, timeout=30.0)
        connection.request("GET", "/api/v1/events")
        response = connection.getresponse()
        threading.Thread(target=drain, args=(response,), daemon=True).start()
        streams.append(connection)
    try:
        yield
    finally:
        for connection in streams:
            connection.close()


def drain(response: http.client.HTTPResponse) -> None:
    try:
        while response.read1(65536):
            pass
    except (OSError, ValueError, AttributeError):
        return  # closed under our hands: the end


def keep_bundle(folder: Path) -> Path:
    """Measure once at a high feed; return the measurement, for the solvers."""
    file = folder / "bundle.zip"
    with service(folder, 500) as (client, _):
        job_id = measure(client, FAST_FEED_MM_MIN)
        job = client.wait_for(job_id, timeout_s=300.0)
        file.write_bytes(client.download(f"/api/v1/runs/{job['run_id']}/bundle"))
    return file


def table(outcomes: list[Outcome]) -> str:
    rows = [
        f"| {o.rate_hz} Hz | {o.samples / o.rate_hz:.0f} s | {o.samples} | {o.lost} | "
        f"{100 * o.cell_share:.0f} % | {o.load:.1f} |"
        for o in outcomes
    ]
    head = "| stream | time | samples | lost | cell process, of a core | load |"
    return "\n".join([head, "| --- " * 6 + "|", *rows]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("streams", nargs="*", default=STREAMS, metavar="HZ:SECONDS")
    parser.add_argument("--solvers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help=f"into {DOCUMENT.name}")
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="truepath-bench-") as name:
        folder = Path(name)
        bundle = keep_bundle(folder)
        for stream in options.streams:
            rate_hz, duration_s = map(int, stream.split(":"))
            with (
                service(folder, rate_hz) as (client, pid),
                reading(client),
                solving(bundle, folder, options.solvers),
            ):
                job_id = measure(client, feed_for(duration_s))
                outcomes.append(follow_measurement(client, job_id, pid, rate_hz))
                print(outcomes[-1], flush=True)
    if options.write:
        write_section("samples lost", table(outcomes), DOCUMENT)
    else:
        print(table(outcomes))


if __name__ == "__main__":
    main()
