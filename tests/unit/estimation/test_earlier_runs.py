"""A measurement that goes on knows what its earlier Runs have shown."""

import pytest

from truepath.estimation.live.earlier_runs import align_earlier
from truepath.estimation.live.live import LiveEstimator
from truepath.planning.adaptive_plan import AdaptivePlanner
from truepath.planning.plan_order import PlanOrder
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def measured(record):
    """Two Runs of one machine, each from a place of its own; the first is earlier."""
    earlier, _ = record(31, rows=16)
    run, _ = record(32, rows=12, setting=Setting(machine_seed=31))
    return align_earlier([earlier]), run


def follow(run, earlier):
    live = LiveEstimator(run.machine, run.commanded, earlier=earlier)
    live.take(run.tracker)
    live.finish()
    return live, live.estimate()


def test_the_live_estimate_adds_what_earlier_runs_tell(measured):
    earlier, run = measured
    _, alone = follow(run, ())
    _, both = follow(run, earlier)
    assert both.volumetric_sigma_mm < 0.75 * alone.volumetric_sigma_mm


def test_what_earlier_runs_took_is_off_the_minutes_that_are_left(measured):
    earlier, run = measured
    live, now = follow(run, earlier)
    whole = AdaptivePlanner(run.machine, run.commanded, PlanOrder(minutes=60.0))
    used_min = whole._used_s / 60.0
    order = PlanOrder(minutes=used_min + 0.5)

    def choose(earlier):
        planner = AdaptivePlanner(run.machine, run.commanded, order, earlier)
        return planner.next(live.findings(), now.volumetric_sigma_mm)

    assert choose(()).commanded is not None
    assert choose(earlier).commanded is None
