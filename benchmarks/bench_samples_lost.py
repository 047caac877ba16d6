"""Samples lost of a 500 Hz stream, idle and with API, solver and readers at work."""

from __future__ import annotations

import http.client
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil

from app.cli.client import Client

TRUEPATH = Path(sys.executable).with_name("truepath")
FEED_MM_MIN = 15_000  # a short path; the stream is 500 Hz at any feed
READERS = 10  # open event streams, as of ten tabs
ENDED = ("succeeded", "failed", "faulted", "aborted", "interrupted")


@contextmanager
def service(data_dir: Path) -> Iterator[tuple[Client, int]]:
    """Run the service with simulated devices; yield a client and its process id."""
    command = [TRUEPATH, "serve", "--simulated", "--port", "0"]
    with subprocess.Popen(
        [*command, "--data-dir", data_dir],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        address = next(
            found[1]
            for line in process.stdout
            if (found := re.search(r"page +(http://\S+)/", line))
        )
        client = Client(address)
        try:
            yield client, process.pid
        finally:
            process.send_signal(signal.SIGTERM)


def measure(client: Client) -> str:
    """Begin a measurement on the fly and return its job."""
    client.post("/machines/current:connect")
    order = {"kind": "measure-otf", "feed_mm_min": FEED_MM_MIN}
    job_id = client.post("/jobs", order)["id"]
    job = client.wait_for(job_id, lambda j: j["state"] == "ready", 60.0)
    client.post(f"/jobs/{job_id}/arm", version=job["version"])
    return job_id


def follow_measurement(
    client: Client, job_id: str, pid: int
) -> tuple[dict[str, int], float]:
    """Follow a measurement to its end; return its health and the cell's share of a
    core since it was started.
    """
    share = 0.0
    for job in client.follow(job_id, period_s=0.2):
        if job["stage"] == "measuring" and job["state"] == "running":
            share = cell_share(pid)
        elif job["state"] in ENDED or job["stage"] != "measuring":
            return job["health"], share
    raise AssertionError("a job that is followed ends")


def cell_share(pid: int) -> float:
    """Return the processor time of the busiest spawned child over its age."""
    shares = [0.0]
    for child in psutil.Process(pid).children():
        used = child.cpu_times()
        if "spawn_main" in " ".join(child.cmdline()):
            age_s = time.time() - child.create_time()
            shares.append((used.user + used.system) / age_s)
    return max(shares)


@contextmanager
def solving(bundle: Path, folder: Path) -> Iterator[None]:
    """Analyse a measurement over and over, in processes that fill every core."""
    stopping = threading.Event()

    def solve(number: int) -> None:
        command = [TRUEPATH, "analyse", bundle, "-o", folder / f"solved-{number}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        while not stopping.is_set():
            with subprocess.Popen(command, **quiet) as process:
                while process.poll() is None and not stopping.wait(0.1):
                    pass
                process.kill()

    threads = [
        threading.Thread(target=solve, args=(number,))
        for number in range(os.cpu_count() or 1)
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
    """Hold event streams open and read them."""
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
    """Read until the stream ends."""
    try:
        while response.read1(65536):
            pass
    except (OSError, ValueError, AttributeError):
        return  # closed under our hands: the end


def main() -> None:
    """Measure once with nothing else to do, once with everything at work."""
    with tempfile.TemporaryDirectory(prefix="truepath-bench-") as name:
        folder = Path(name)
        bundle = folder / "bundle.zip"
        for load in ("idle", "at work"):
            with service(folder / load) as (client, pid), ExitStack() as stack:
                if load == "at work":
                    stack.enter_context(reading(client))
                    stack.enter_context(solving(bundle, folder))
                job_id = measure(client)
                health, share = follow_measurement(client, job_id, pid)
                stack.close()
                print(
                    f"{load:8s} {health['samples']:6d} samples, "
                    f"{health['lost_samples']} lost; "
                    f"the cell process used {100 * share:.0f} % of a core",
                    flush=True,
                )
                if load == "idle":
                    keep_bundle(client, job_id, bundle)


def keep_bundle(client: Client, job_id: str, file: Path) -> None:
    """Wait for the analysis to end and download the measurement."""
    job = client.wait_for(job_id, lambda j: j["state"] in ENDED, 120.0)
    host = client.address.removeprefix("http://")
    connection = http.client.HTTPConnection(host, timeout=60.0)
    connection.request("GET", f"/api/v1/runs/{job['run_id']}/bundle")
    file.write_bytes(connection.getresponse().read())
    connection.close()


if __name__ == "__main__":
    main()
