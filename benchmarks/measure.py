"""Measures a function in a process of its own: wall time, processor time, peak memory.

A process each, because peak memory never falls again, and what one candidate has
warmed up (imports, caches of the allocator) must not help the next; with as many BLAS
threads as the command line takes.
Compare candidates of one run only, and as ratios: machines differ, and so does this one
from hour to hour.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from truepath.thread_limits import choose_thread_limits


@dataclass(frozen=True, slots=True)
class Measurement:
    """What one call cost.

    wall_s, processor_s : of the call itself, imports and start-up left out
    peak_mib : highest resident set of the process, interpreter and imports included
    value : what the function returned
    """

    wall_s: float
    processor_s: float
    peak_mib: float
    value: Any

    def __str__(self) -> str:
        return (
            f"{self.wall_s:8.2f} s {self.processor_s:8.2f} s cpu "
            f"{self.peak_mib:8.0f} MiB"
        )


def measure(
    function: Callable[..., Any], *arguments: Any, repeats: int = 1
) -> Measurement:
    """Call an importable function in a fresh process; the fastest repeat counts.

    Raises RuntimeError if the process ends without an answer (out of memory, say).
    """
    return min((_once(function, arguments) for _ in range(repeats)), key=_wall)


def ratio(candidate: Measurement, baseline: Measurement) -> str:
    """Say how many times faster and leaner the candidate is than the baseline."""
    faster = baseline.wall_s / candidate.wall_s
    leaner = baseline.peak_mib / candidate.peak_mib
    return f"{faster:.1f} x faster, {leaner:.1f} x less memory"


def _wall(measurement: Measurement) -> float:
    return measurement.wall_s


def _once(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Measurement:
    os.environ.update(choose_thread_limits())
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(sender, function, arguments))
    process.start()
    sender.close()
    try:
        outcome = receiver.recv()
    except EOFError:
        process.join()
        raise RuntimeError(
            f"{function.__name__} ended with {process.exitcode}"
        ) from None
    process.join()
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


def _child(
    sender: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    try:
        sender.send(_measure(function, arguments))
    except Exception as error:
        sender.send(error)


def _measure(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Measurement:
    wall, processor = time.perf_counter(), time.process_time()
    value = function(*arguments)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return Measurement(wall, processor, _peak_mib(), value)


def _peak_mib() -> float:
    # Not getrusage: its figure survives exec, so a big parent shows in a small child.
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("/proc/self/status names no VmHWM")
