"""Every registered driver keeps what the interfaces promise."""

import time
from functools import partial
from importlib.metadata import entry_points

import numpy as np
import pytest

from truepath_drivers.conformance import checking, motion, tracker
from truepath_drivers.conformance.checking import on_terms
from truepath_drivers.conformance.polled_tracker import POLLED_CHECKS
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_simulators.bench.bench import Bench

TRACKERS = {one.name: one for one in entry_points(group="truepath.trackers")}
MOTION = "truepath.motion_controllers"
CONTROLLERS = {one.name: one for one in entry_points(group=MOTION)}
POLLED = {"geocom": "pty", "t2sa": "tcp"}  # each has simulated instruments of its own
# Where drivers of ours find a device; a new one needs a word here.
HERE = {"streaming", "modbus", *POLLED}
# Behind a relay, a real one, and a process of its own.
ELSEWHERE = {"text-line", "linuxcnc", "grbl"}
ABSENT = {
    "text-line": {"port": "/dev/truepath-no-such-port", "rate_hz": 500.0},
    "streaming": {"port": "/dev/truepath-no-such-port"},
    "geocom": {"port": "/dev/truepath-no-such-port"},
    "t2sa": {"host": "127.0.0.1", "port": 9},
    "modbus": {"serial_port": "/dev/truepath-no-such-port"},
    "linuxcnc": {"host": "127.0.0.1", "port": 9},
    "grbl": {"port": "/dev/truepath-no-such-port"},
}


@pytest.fixture(
    scope="module", params=["pty", pytest.param("tcp", marks=pytest.mark.long)]
)
def tracker_bench(request):
    with Bench(tracker=request.param, rtu=False) as bench:
        yield bench


@pytest.fixture(scope="module")
def motion_bench():
    # Ten times faster, so that motions are over soon; watchdogs stay in wall seconds.
    with Bench(speed=5.0) as bench:
        yield bench


def test_every_registered_driver_of_ours_has_a_peer():
    points = [*TRACKERS.values(), *CONTROLLERS.values()]
    ours = {p.name for p in points if p.module.startswith("truepath_drivers.")}
    assert ours == HERE | ELSEWHERE == set(ABSENT)


@pytest.mark.parametrize("check", tracker.TRACKER_CHECKS)
def test_the_streaming_tracker_conforms(tracker_bench, check):
    check(partial(TRACKERS["streaming"].load(), **tracker_bench.tracker_options))


@pytest.fixture(scope="module", params=POLLED)
def polled_bench(request):
    name = request.param
    with Bench(protocol=name, speed=20.0, rtu=False, tracker=POLLED[name]) as bench:
        yield name, bench


@pytest.mark.long
@pytest.mark.parametrize("check", POLLED_CHECKS)
def test_polled_trackers_conform(polled_bench, check):
    name, bench = polled_bench
    check(partial(TRACKERS[name].load(), **bench.tracker_options))


@pytest.mark.long
@pytest.mark.parametrize("polled_bench", ["t2sa"], indirect=True)
def test_a_plan_gives_the_place_of_the_points_beside_it(polled_bench):
    _, bench = polled_bench
    with T2saTracker(**bench.tracker_options) as tracker:
        point = tracker.measure(0.2)
    with T2saTracker(**bench.tracker_options, plan="cell") as tracker:
        plan = tracker.measure(0.0)
    assert point.count > 1
    assert np.linalg.norm(point.position_mm - plan.position_mm) < 0.2


@pytest.mark.parametrize("wire", ["motion_options", "motion_options_rtu"])
@pytest.mark.parametrize("check", motion.MOTION_CHECKS)
def test_the_modbus_controller_conforms(motion_bench, wire, check):
    check(partial(CONTROLLERS["modbus"].load(), **getattr(motion_bench, wire)))


# What brings each trouble about on the bench; lost replies are in faults/.
TROUBLES = {
    motion.an_alarm_ends_the_motion: "cnc:alarm+15s",
    motion.an_open_door_ends_the_motion: "cnc:door+15s",
    motion.an_unhomed_machine_does_not_move: "cnc:unhomed+15s",
    motion.a_blocked_device_is_told_in_time: "cnc:silence+15s",
}


@pytest.mark.long
@pytest.mark.parametrize("check", TROUBLES)
def test_modbus_keeps_in_trouble_what_it_promises(check):
    with Bench(speed=5.0, rtu=False) as bench:
        make = partial(CONTROLLERS["modbus"].load(), **bench.motion_options)
        check(make, partial(bench.inject, TROUBLES[check]))


@pytest.mark.parametrize("name", ABSENT)
def test_absent_devices_are_device_errors(name):
    factory = {**TRACKERS, **CONTROLLERS}[name].load()
    checking.a_device_that_is_not_there_is_a_device_error(
        lambda: factory(**ABSENT[name])
    )


@pytest.mark.parametrize("rate_hz", [100.0, 5000.0])
def test_the_rate_is_a_term_and_none_of_5_khz_is_lost(tracker_bench, rate_hz):
    make = partial(TRACKERS["streaming"].load(), **tracker_bench.tracker_options)
    with on_terms(rate_hz=rate_hz, patience_s=2.0):
        tracker.times_are_those_of_the_samples(make)
    with make() as connected:
        connected.start(rate_hz)
        first = connected.read(2.0)
        assert len(first) > 0
        time.sleep(0.5)
        samples = connected.read(2.0)
        assert len(samples) == pytest.approx(0.5 * rate_hz, rel=0.5)
        assert TrackerSamples.join([first, samples]).lost == 0
