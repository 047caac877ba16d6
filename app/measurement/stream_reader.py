"""Carries the tracker's stream from the driver to the disk, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from app.measurement.recorder import Recorder
from app.measurement.stream_monitor import StreamMonitor
from drivers.interfaces.link import ByteLink
from drivers.interfaces.records import TrackerSamples
from drivers.interfaces.tracker import Tracker

BATCH_S = 0.1  # that is committed at once
READ_S = 0.02  # between looks at the tracker


class StreamReader:
    """Reads blocks of some 20 ms and hands batches of some 100 ms to the recorder.

    clock : stamps what has come, for the watch
    """

    def __init__(
        self,
        tracker: Tracker,
        recorder: Recorder,
        monitor: StreamMonitor,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tracker, self._recorder, self._monitor = tracker, recorder, monitor
        self._clock = clock
        self._stopping = threading.Event()
        self._thread = threading.Thread(
            target=self._run, name="stream-reader", daemon=True
        )
        self._failure: Exception | None = None

    @property
    def failure(self) -> Exception | None:
        """What ended the pump before it was stopped."""
        return self._failure

    def start(self, rate_hz: float) -> None:
        """Start the stream. Raises as `Tracker.start`."""
        while len(self._tracker.read(0.0)):
            pass  # left over from an earlier stream
        if isinstance(self._tracker, ByteLink):
            self._tracker.take_link_bytes()
        self._tracker.start(rate_hz)
        self._thread.start()

    def stop(self) -> None:
        """Hand over what has come, then end the stream. Idempotent."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._tracker.stop()

    def _run(self) -> None:
        """Body of the thread. What it fails of is kept for the engine to find."""
        try:
            while not self._stopping.is_set():
                self._fill_batch()
            self._hand_over([self._tracker.read(0.0)])
        except Exception as error:
            self._failure = error

    def _fill_batch(self) -> None:
        blocks: list[TrackerSamples] = []
        end_s = time.monotonic() + BATCH_S
        while (left_s := end_s - time.monotonic()) > 0 and not self._stopping.is_set():
            block = self._tracker.read(left_s)
            self._monitor.add_block(block, self._clock())
            blocks.append(block)
            self._stopping.wait(READ_S)
        self._hand_over(blocks)

    def _hand_over(self, blocks: list[TrackerSamples]) -> None:
        link = (
            self._tracker.take_link_bytes()
            if isinstance(self._tracker, ByteLink)
            else b""
        )
        self._recorder.put_tracker(TrackerSamples.join(blocks), link)
