"""The estimate of a measurement under way, in a process of its own.

Committed blocks go in through a short queue that drops what the process cannot take in
time, and counts it: a slow estimate never delays the measurement, and the analysis of
the closed Run misses nothing. Answers come out as they are made, at least twice a
second. What fails in there ends the live estimate and nothing else.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import structlog

from app.jobs.executor import BELOW_THE_CELL, limit_threads
from app.kinematics.machine import Machine
from app.planning.configurations import Configurations
from drivers.interfaces.records import Path, TrackerSamples

log = structlog.get_logger(__name__)

PERIOD_S = 0.25  # with a busy processor, still twice a second
_LEAST_S = 0.05
WAITING_BLOCKS = 100  # about ten seconds of the stream
FINISH_S = 20.0
_MICRO = 1e3  # mm to µm

Show = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True, slots=True)
class LiveOrder:
    """What is measured."""

    machine: Machine
    commanded: Path | Configurations
    perpendicular_only: bool = False


class LiveEstimation:
    """One measurement followed by one process, from `start` to `close`.

    show : told every estimate, in the words of `GET /jobs/{id}/estimate`; from a thread
        of its own; must return at once
    """

    def __init__(self, order: LiveOrder, show: Show) -> None:
        limit_threads()
        context = get_context("spawn")
        taken, self._blocks = context.Pipe(duplex=False)
        self._answers, given = context.Pipe(duplex=False)
        self._others = (taken, given)
        self._process: BaseProcess = context.Process(
            target=main, args=(taken, given, order), name="live-estimate", daemon=True
        )
        self._show = show
        self._queue: queue.Queue[TrackerSamples | None] = queue.Queue(WAITING_BLOCKS)
        self._feeder = threading.Thread(
            target=self._feed, name="live-feeder", daemon=True
        )
        self._listener = threading.Thread(
            target=self._listen, name="live-listener", daemon=True
        )
        self.dropped_blocks = 0
        self.volumetric_uncertainty_um = float("inf")

    def start(self) -> None:
        """Start the process."""
        with _no_interrupts():
            self._process.start()
        for end in self._others:
            end.close()
        self._feeder.start()
        self._listener.start()

    def offer(self, samples: TrackerSamples) -> None:
        """Hand over a committed block. Never waits: what has no room is dropped."""
        try:
            self._queue.put_nowait(samples)
        except queue.Full:
            self.dropped_blocks += 1

    def finish(self, timeout_s: float = FINISH_S) -> None:
        """Nothing follows: wait for the last estimate, at most so long."""
        with suppress(queue.Full):
            self._queue.put(None, timeout=timeout_s)
            self._listener.join(timeout_s)

    def close(self) -> None:
        """End the process, whatever it does. Idempotent."""
        if self._process.ident is None:
            return
        self._process.kill()
        self._process.join()
        self._listener.join()
        with suppress(queue.Full):
            self._queue.put_nowait(None)  # the feeder notices, or finds the pipe broken
        self._feeder.join(FINISH_S)
        for end in (self._blocks, self._answers):
            end.close()

    def _feed(self) -> None:
        """Body of a thread: what waits goes to the process."""
        with suppress(OSError):
            while True:
                samples = self._queue.get()
                self._blocks.send(samples)
                if samples is None:
                    return

    def _listen(self) -> None:
        """Body of a thread: what the process says is shown."""
        with suppress(EOFError, OSError):
            while True:
                body = self._answers.recv()
                if "error" in body:
                    log.warning("no live estimate any more", reason=body["error"])
                    continue
                self.volumetric_uncertainty_um = body["volumetric_uncertainty_um"]
                self._show({**body, "dropped_blocks": self.dropped_blocks})


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Let a child inherit that Ctrl+C is not for it, from its first instruction."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def main(blocks: Connection, answers: Connection, order: LiveOrder) -> None:
    """Body of the process: ends with its parent, or after the last block."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(BELOW_THE_CELL)
    try:
        _estimate(blocks, answers, order)
    except (EOFError, OSError):
        return
    except Exception as error:  # told, and the end of the live estimate alone
        with suppress(OSError):
            answers.send({"error": f"{type(error).__name__}: {error}"})


def _estimate(blocks: Connection, answers: Connection, order: LiveOrder) -> None:
    # Imported where it computes: the service itself carries no science.
    from app.estimation.live import LiveEstimator

    live = LiveEstimator(
        order.machine, order.commanded, perpendicular_only=order.perpendicular_only
    )
    body: dict[str, Any] | None = None
    total = len(order.commanded) - isinstance(order.commanded, Path)
    due_s = time.monotonic()
    while True:
        due_s = max(due_s + PERIOD_S, time.monotonic() + _LEAST_S)
        is_new, is_over = _fed(live.take, blocks, due_s)
        if is_over:
            is_new = live.finish()
        if is_new:
            body = _body(live.estimate(), total)
        if body is not None:
            answers.send({**body, "is_last": is_over})
        if is_over:
            return


def _fed(
    take: Callable[[TrackerSamples], bool], blocks: Connection, until_s: float
) -> tuple[bool, bool]:
    """Take blocks until a moment; tell whether they finished anything, and the end."""
    is_new = False
    while (left_s := until_s - time.monotonic()) > 0 and blocks.poll(left_s):
        samples = blocks.recv()
        if samples is None:
            return is_new, True
        is_new = take(samples) or is_new
    return is_new, False


def _body(now: Any, total: int) -> dict[str, Any] | None:
    """Return an estimate in the words of `result.json`: µm, µrad, k = 1."""
    from app.reporting.error_tables import error_tables

    if now is None:
        return None
    tables = error_tables(now.model, now.theta, now.covariance)
    return {
        "volumetric_uncertainty_um": round(_MICRO * now.volumetric_sigma_mm, 4),
        "done": now.done,
        "total": total,
        "cells": now.cells,
        "device_time_s": round(now.time_s, 4),
        "error_tables": {
            table.symbol: {
                "position_mm": table.position_mm.round(3).tolist(),
                f"value_{table.unit}": table.value.round(3).tolist(),
                f"uncertainty_{table.unit}": table.uncertainty.round(3).tolist(),
            }
            for table in tables.tables
        },
        "squareness_urad": {
            s.symbol: {
                "value": round(s.value_urad, 3),
                "uncertainty": round(s.uncertainty_urad, 3),
            }
            for s in tables.squareness
        },
    }
