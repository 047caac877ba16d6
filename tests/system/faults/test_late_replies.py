"""A controller whose replies are late, halved, of another request, or that it is busy.

Its requests arrive: what decides is how old the last valid status is.
"""

import time

import pytest

from measuring import measuring_on
from truepath.measurement.messages import RunClosed, StateChanged
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

HARMS = {
    "late": Harm(latency_s=0.35),
    "halved": Harm(halve=True),
    "of another request": Harm(renumber=True),
    "half a second late": Harm(latency_s=0.6),
}


# The machine's own watchdog is later than what the age of a status brings about.
PATIENT = {"watchdog_s": 2.0}


@pytest.fixture
def measuring(tmp_path):
    with (
        Bench(seed=12, speed=2.0, rtu=False) as bench,
        LinkProxy(bench.motion_options, seed=3) as proxy,
        ModbusController(**bench.motion_options, **PATIENT) as onlooker,
    ):
        options = proxy.options | PATIENT
        with measuring_on(bench, tmp_path / "r.sqlite", motion_options=options) as one:
            yield one, bench, proxy, onlooker


def until_it(measuring, onlooker, is_so, within_s):
    begun_s = time.monotonic()
    measuring.until(lambda: is_so(onlooker.status()), timeout_s=within_s)
    return time.monotonic() - begun_s


@pytest.mark.fault_row(44)
def test_no_status_holds_the_feed_by_the_age_of_the_last_one(measuring, measured):
    running, _, proxy, onlooker = measuring
    for name, harm in HARMS.items():
        proxy.harm(to_host=harm)
        held_s = until_it(running, onlooker, lambda s: s.state == "held", 2.0)
        measured(f"{name}: held after {held_s:.2f} s")
        assert onlooker.status().hold_reason == "command"
        proxy.harm()
        until_it(running, onlooker, lambda s: s.state == "running", 6.0)
        running.until(lambda: running.of(StateChanged)[-1].state == "running")
    assert running.faults == {"control-late"}
    assert not running.of(RunClosed)


@pytest.mark.fault_row(44)
def test_a_controller_that_is_busy_for_long_is_named_as_that(measuring):
    """Exception 6 for three seconds of the wall: its watchdog holds meanwhile."""
    running, bench, _, onlooker = measuring
    bench.inject("cnc:exception+6s*6")
    running.until(lambda: bool(running.faults), timeout_s=5.0)
    assert running.faults == {"control-busy"}
    running.until_closed(timeout_s=10.0)
    assert running.faults == {"control-busy"}
    assert onlooker.status().state == "held"


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        pytest.param(
            "cnc:zeroed+30s", "position-implausible", marks=pytest.mark.fault_row(42)
        ),
        pytest.param(
            "cnc:shifted+30s", "position-implausible", marks=pytest.mark.fault_row(42)
        ),
        pytest.param(
            "tracker:frozen", "tracker-frozen", marks=pytest.mark.fault_row(41)
        ),
    ],
)
def test_what_cannot_be_is_held_over_real_links(measuring, fault, code):
    running, bench, _, onlooker = measuring
    bench.inject(fault)
    until_it(running, onlooker, lambda s: s.state == "held", 8.0)
    running.until(lambda: running.of(StateChanged)[-1].state == "paused")
    assert running.faults == {code}
