"""Machines, Runs and bundles that the measurement tests start from."""

import itertools
import sqlite3
import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from drivers_fixtures import clock  # noqa: F401
from truepath.measurement import messages
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.run_file.run_file import LINK_STREAM
from truepath.measurement.run_file.run_loader import open_run
from truepath.measurement.time_limits import EngineSettings, StreamTimeouts
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces import arcs, errors, records, tracker_records
from truepath_drivers.interfaces import tracker as trackers
from truepath_drivers.interfaces.motion import MotionController
from truepath_drivers.interfaces.records import MotionState, TrackerSamples

JUDGED = EngineSettings(poll_s=0.02, progress_s=0.0, axes_rows=5)
"""The patience of the service."""
QUICK = EngineSettings(poll_s=0.01, settle_s=0.02, progress_s=0.0, confirm_s=30.0)
NOISE_MM = 0.001  # of a shot of a tracker that is polled
PLACE_MM = np.array([2000.0, 300.0, 50.0])
"""Where it sees the target of a machine at zero."""


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture(autouse=True)
def no_thread_is_left_over():
    before = set(threading.enumerate())
    yield
    left = [t.name for t in threading.enumerate() if t not in before and not t.daemon]
    assert not left


@pytest.fixture
def calm():
    """Timeouts that a busy computer does not reach."""
    names = ("confirm_s", "stale_s", "link_s", "first_sample_s")
    timeouts = StreamTimeouts(silent_s=30.0, dead_s=60.0, beam_s=30.0)
    return replace(JUDGED, timeouts=timeouts, **dict.fromkeys(names, 30.0))


@pytest.fixture
def read_link_bytes():
    def read(file):
        query = "SELECT payload FROM batch WHERE stream = ? ORDER BY seq0"
        with closing(sqlite3.connect(file)) as database:
            return b"".join(row[0] for row in database.execute(query, (LINK_STREAM,)))

    return read


class FakeTracker(trackers.Tracker, trackers.ByteLink):
    """A tracker in this process: its clock runs `speed` times faster than ours."""

    def __init__(self, speed=20.0):
        self.speed = speed
        self.silent = self.restarted = self.streaming = False
        self.damaged = False  # of twenty samples one arrives
        self.beam = True
        self.follows = None  # its machine; else it moves by itself
        self.frozen = False  # it repeats the last place
        self.place = (1.0, 2.0, 3.0)  # of the target before the machine moved
        self._last = np.array(self.place)
        self.error = self.refusal = None
        self.stops = self._sent = 0
        self._begun_s, self._rate_hz, self._bytes = 0.0, 500.0, b""

    def connect(self):
        return records.Identity("Us", "fake tracker", "T1", "0")

    def close(self):
        self.stop()

    def start(self, rate_hz):
        if self.refusal is not None:
            raise self.refusal
        self._rate_hz, self._begun_s, self._sent = rate_hz, host_clock.now_s(), 0
        self.streaming = True

    def stop(self):
        self.streaming = False
        self.stops += 1

    def read(self, timeout_s):
        deadline_s = host_clock.now_s() + timeout_s
        while True:
            if self.error is not None:
                raise self.error
            block = self._new()
            if len(block) or host_clock.now_s() >= deadline_s:
                return block
            host_clock.sleep_s(0.005)

    def take_link_bytes(self):
        data, self._bytes = self._bytes, b""
        return data

    @property
    def health(self):
        return records.LinkHealth(frames=self._sent, crc_errors=2)

    def _new(self):
        if not self.streaming:
            return TrackerSamples.empty()
        passed_s = (host_clock.now_s() - self._begun_s) * self.speed
        count = max(int(passed_s * self._rate_hz), self._sent)
        first, self._sent = self._sent, count
        if self.silent or count <= first:
            return TrackerSamples.empty()
        sequence = np.arange(first, count, dtype=np.int64)
        if self.restarted:
            sequence -= first
        self._bytes += bytes(count - first)
        time_s = 100.0 + np.arange(first, count) / self._rate_hz
        status = np.full(count - first, 0 if self.beam else 4, np.int64)
        samples = TrackerSamples(sequence, time_s, self._see(count - first), status)
        return samples.select(sequence % 20 == 0) if self.damaged else samples

    def _see(self, count):
        """Return the place of the target `count` times; none of it is bit for bit."""
        if self.follows is not None and not self.frozen:
            self._last = self.follows.here + self.place
        places = np.tile(self._last, (count, 1))
        if not self.frozen:
            places[:, 0] += 1e-6 * np.random.default_rng(self._sent).random(count)
            self._last = places[-1]
        return places


class FakePolledTracker(trackers.PolledTracker):
    @property
    def capabilities(self):
        how = {"clock": tracker_records.Clock.HOST, "distance": "ADM"}
        return tracker_records.TrackerCapabilities(streams=False, **how)

    def connect(self):
        return records.Identity("Us", "fake polled tracker", "P1", "0")

    def close(self):
        self.stop()

    def stop(self):
        """Nothing is under way."""


class FakePolled(FakePolledTracker, trackers.EventSource):
    """Sees the axes of a controller in this process; shots come at 200 Hz."""

    def __init__(self, motion):
        self.motion = motion
        self.asked = self.connects = 0
        self.before = lambda _: None
        self.stopped = threading.Event()
        self.events = []
        self._rng = np.random.default_rng(5)

    def connect(self):
        self.connects += 1
        return super().connect()

    def stop(self):
        self.stopped.set()

    def take_events(self):
        events, self.events = tuple(self.events), []
        return events

    def measure(self, dwell_s):
        self.stopped.clear()
        self.asked += 1
        self.before(self.asked)
        begin_s = host_clock.now_s()
        times, shots = [], []
        while host_clock.now_s() - begin_s < dwell_s or not shots:
            noise = self._rng.normal(0.0, NOISE_MM, 3)
            shots.append(PLACE_MM + self.motion.here + noise)
            times.append(host_clock.now_s())
            if host_clock.wait(self.stopped, 0.005):
                raise errors.Refused("the measurement was stopped")
        seen = np.array(times), np.array(shots), tracker_records.Air(21.5, 1013.0, 40.0)
        return tracker_records.PointMeasurement.average(*seen)


@pytest.fixture
def polled(motion):
    motion.speed = 2000.0
    return FakePolled(motion)


class FakeMotion(MotionController, trackers.EventSource):
    """A controller in this process: constant speed, `speed` times faster than told."""

    axes = ("X", "Y", "Z")
    travel = ((0.0, 500.0), (0.0, 400.0), (-300.0, 0.0))

    def __init__(self, speed=20.0):
        self.speed = speed
        self.calls, self.events = [], []
        self.out_of_reach = self.stops_unasked = False
        self.has_watchdog = self.limits_override = True
        self.override = self.referenced = self.compensation = None
        self.ignores_hold = self.ignores_resume = self.ignores_abort = False
        self.ends_after_s = None
        self.runs_on = False  # another program follows the last row
        self.stale_looks = 0  # that still show the last line of the program before
        self.here = np.zeros(3)
        self.loaded, self.alarm = None, ""
        self.beats = self.looks = 0
        self._is_fed = False
        self._state, self._reason = MotionState.IDLE, ""
        self._rows, self._owners = [], []
        self._feed, self._done_s = 6000.0, 0.0
        self._since_s = host_clock.now_s()
        self._lock = threading.RLock()

    def connect(self):
        known = {"has_watchdog": self.has_watchdog, "stops_unasked": self.stops_unasked}
        return records.Identity("Us", "fake controller", "C1", "0", **known)

    def close(self):
        self.abort()

    def send_heartbeat(self):
        self._reach()
        self._is_fed = True

    def status(self):
        self._reach()
        with self._lock:
            line = self._advance()
            if self.stale_looks and len(self._rows) > 2:
                self.stale_looks, line = self.stale_looks - 1, len(self._rows) - 2
            line = self._owners[line] if self._owners else line
            if self._state is MotionState.RUNNING:
                self.looks += 1
                self.beats += self._is_fed
            self._is_fed = False
            stated = self.override, self.referenced, self.compensation
            why = self.alarm, self._reason
            return records.MotionStatus(self._state, (*self.here,), line, *why, *stated)

    def take_events(self):
        events, self.events = tuple(self.events), []
        return events

    def limit_override(self, largest):
        if not self.limits_override:
            super().limit_override(largest)
        self.override = min(self.override or largest, largest)

    def move_to(self, position, feed_mm_min):
        self._reach("move_to")
        self._run([np.array(position, float)], feed_mm_min)

    def load(self, path):
        self._reach("load")
        self.loaded = path
        self._state = MotionState.READY

    def start(self):
        self._reach("start")
        assert self.loaded is not None
        places, owners = arcs.trace(self.loaded)
        self._run(list(places), float(self.loaded.feed_mm_min[0]))
        self._owners = owners.tolist()  # rows, where an arc is driven in chords

    def wait(self, timeout_s):
        raise NotImplementedError

    def hold(self):
        self._reach("hold")
        with self._lock:
            if not self.ignores_hold:
                self.stand("command")

    def resume(self):
        self._reach("resume")
        with self._lock:
            if self._state is MotionState.HELD and not self.ignores_resume:
                self.go_on()

    def abort(self):
        self._reach("abort")
        with self._lock:
            self._advance()
            if self.ignores_abort:
                return
            self.loaded = None
            if self._state is not MotionState.ALARM:
                self._state, self._reason = MotionState.ABORTED, ""

    # What happens at the machine itself.

    def stand(self, reason):
        with self._lock:
            self._advance()
            if self._state is MotionState.RUNNING:
                self._state, self._reason = MotionState.HELD, reason

    def go_on(self):
        with self._lock:
            self._state, self._reason = MotionState.RUNNING, ""
            self._since_s = host_clock.now_s()

    def raise_alarm(self, text):
        with self._lock:
            self._advance()
            self._state, self.alarm = MotionState.ALARM, text

    def begin_elsewhere(self):
        self._run([np.array([400.0, 0.0, 0.0])], 6.0)

    def _reach(self, *calls):
        if self.out_of_reach:
            raise errors.DeviceTimeout("the controller does not answer; is it on?")
        self.calls += calls

    def _run(self, rows, feed_mm_min):
        with self._lock:
            self._rows = [self.here.copy(), *rows]
            self._owners = list(range(len(rows)))
            self._feed, self._done_s = feed_mm_min, 0.0
            self.go_on()

    def _advance(self):
        """Bring position and state to now; return the row moved towards."""
        now_s = host_clock.now_s()
        if self._state is not MotionState.RUNNING:
            return max(len(self._rows) - 2, 0)
        self._done_s += (now_s - self._since_s) * self.speed
        self._since_s = now_s
        left_mm = self._done_s * self._feed / 60.0
        for row, (begin, end) in enumerate(itertools.pairwise(self._rows)):
            length = float(np.linalg.norm(end - begin))
            if left_mm < length:
                self.here = begin + (end - begin) * left_mm / length
                if self.ends_after_s is not None and self._done_s > self.ends_after_s:
                    self._state = MotionState.FINISHED
                return row
            left_mm -= length
        self.here = self._rows[-1].copy()
        if self.runs_on and len(self._rows) > 2:
            self.here -= [min(left_mm, 1.5), 0.0, 0.0]
            return len(self._rows) - 2
        self._state = MotionState.FINISHED
        return max(len(self._rows) - 2, 0)


@pytest.fixture
def motion():
    return FakeMotion()


@pytest.fixture
def tracker(motion):
    fake = FakeTracker()
    fake.follows = motion
    return fake


class Told:
    """What a measurement has told: `events`, and `until` waits for some."""

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def states(self):
        return [event.state for event in self.of(messages.StateChanged)]

    @property
    def faults(self):
        return [event.code for event in self.of(messages.FaultReported)]

    @property
    def progress(self):
        return self.of(messages.MeasurementProgress)

    def until_state(self, state):
        self.until(lambda: self.states[-1:] == [state])

    def until_done(self, rows=1):
        self.until(lambda: any(p.done >= rows for p in self.progress))


class Journal(Told):
    def __init__(self):
        self.events = []
        self._changed = threading.Condition()

    def report(self, event):
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()

    def wait(self, condition, timeout_s=25.0):
        with self._changed:
            came = host_clock.wait_for(self._changed, condition, timeout_s)
            assert came, self.events[-8:]


@pytest.fixture
def journal():
    return Journal()


class Running(Told):
    """A measurement on devices in this process, in a thread, and what it leaves."""

    def __init__(self, order, tracker, motion, journal, settings, sensors=None):
        devices = {"tracker": tracker.connect(), "motion": motion.connect()}
        self.order, self.journal, self.motion = order, journal, motion
        how = devices, journal.report, settings, sensors
        self.measurement = Measurement(order, tracker, motion, *how)
        self.obey, self.told = self.measurement.obey, journal.of
        self.events, self.until = journal.events, journal.wait
        self.thread = threading.Thread(target=self.measurement.run)

    @property
    def fault(self):
        return self.told(messages.FaultReported)[-1]

    def until_told(self, *codes):
        self.until(lambda: self.faults == list(codes))

    def until_seen(self, time_s):
        """Wait until the tracker has measured for so long; its clock begins at 100."""
        told = messages.LivePoints
        self.until(lambda: any(one.device_time_s > time_s for one in self.of(told)))

    def pass_until(self, condition):
        """Let time pass, a tenth of a second a look, until something has happened."""
        deadline_s = host_clock.now_s() + 25.0
        while not condition():
            assert host_clock.now_s() < deadline_s, self.journal.events[-8:]
            host_clock.sleep_s(0.1)

    def look(self, times=3, kind=messages.MeasurementProgress):
        told = len(self.told(kind))
        self.until(lambda: len(self.told(kind)) > told + times)

    def see(self, times=3):
        self.look(times, messages.LivePoints)

    def pause(self):
        self.obey(messages.CellVerb.PAUSE)
        self.until_state("paused")

    def pause_and_resume(self):
        self.pause()
        self.obey(messages.CellVerb.RESUME)
        self.until_state("running")

    def ended(self):
        host_clock.join(self.thread, 30.0)
        assert not self.thread.is_alive(), self.journal.events[-8:]
        return self.states[-1]

    def ends(self, state, *codes):
        assert (self.ended(), tuple(self.faults)) == (state, codes)

    def finished(self):
        """Let the machine be quick about the rest; it ends in order."""
        self.motion.speed = 5000.0
        self.motion.override = 5000.0  # it says so, or it would not be believed
        assert self.ended() == "finished"

    def finished_after(self, *codes):
        self.finished()
        assert tuple(self.faults) == codes

    def resume_to_the_end(self):
        self.obey(messages.CellVerb.RESUME)
        self.finished()

    @property
    def run(self):
        return open_run(self.order.run_file)

    def texts(self, kind):
        return [event.text for event in self.run.events if event.kind == kind]


@pytest.fixture
def begin(tracker, motion, journal, calm):
    begun = []

    def start(order, *, settings=calm, tracker=tracker, sensors=None):
        begun.append(Running(order, tracker, motion, journal, settings, sensors))
        begun[-1].thread.start()
        return begun[-1]

    yield start
    for one in begun:
        if one.thread.is_alive():
            one.obey(messages.CellVerb.ABORT)
            host_clock.join(one.thread, 5.0)


@pytest.fixture
def order(mill, square, tmp_path):
    file = str(tmp_path / "monday.sqlite")
    return messages.MeasurementOrder("monday", file, mill, square, reserve_bytes=0)


def along(order, rows, feed_mm_min=6000.0, **given):
    rows, n, axes = np.array(rows, float), len(rows), order.commanded.axes
    path = records.Path(axes, rows, np.full(n, feed_mm_min), np.zeros(n), **given)
    return replace(order, commanded=path)


def there_and_back(order, times):
    return along(order, [[10.0, 10.0, -10.0], [410.0, 310.0, -210.0]] * times)


def standing_at(order, rows, dwell_s, target=()):
    given = np.array(rows, float), np.full(len(rows), dwell_s), tuple(target)
    return replace(order, commanded=Configurations(order.commanded.axes, *given))


def draw_rows(n):
    return np.random.default_rng(3).uniform([10, 10, -290], [490, 390, -10], (n, 3))


@pytest.fixture
def measure(polled, motion, order, journal):
    def made(order=order, settings=QUICK):
        made.running = Running(order, polled, motion, journal, settings)
        made.running.measurement.run()
        file = journal.of(messages.RunClosed)[-1].run_file
        return journal.states[-1], made.running.run if file else None

    return made
