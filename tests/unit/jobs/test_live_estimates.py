"""What a live estimate tells, and how much of it is remembered."""

from multiprocessing import Pipe

import numpy as np
import pytest

from job_builders import make_samples
from truepath.catalogue.job import JobEvent
from truepath.estimation.live.live_estimate import LiveEstimate
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.running.event_bus import JOBS, EventBus
from truepath.jobs.running.live_estimation import WAITING_BLOCKS, LiveEstimation
from truepath.jobs.running.live_process import (
    LiveCommand,
    LiveEstimateOrder,
    estimate_json,
    estimate_live,
)
from truepath.kinematics.effects.location_error import AxisLocation
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.scenario import load_machine


@pytest.fixture
def order(mill, square):
    return LiveEstimateOrder(mill, square)


def test_what_has_no_room_is_dropped_and_counted_at_once(order):
    live = LiveEstimation(order, lambda _: None)
    for _ in range(WAITING_BLOCKS + 7):
        live.offer(make_samples())
    assert live.dropped_blocks == 7
    live.close()


def test_a_stream_that_is_no_measurement_ends_without_a_word(order):
    ours, theirs = Pipe()
    ours.send(TrackerSamples.empty())
    ours.send(LiveCommand.END)
    estimate_live(order, theirs)
    assert not ours.poll()


def test_the_newest_estimates_of_a_few_jobs_are_remembered_each_with_its_course():
    event_bus = EventBus()
    estimates = event_bus.estimates

    def publish(job_id, done, sigma_um):
        told = {"done": done, "elapsed_s": 5.0 * done}
        told["volumetric_uncertainty_um"] = sigma_um
        event_bus.publish(JobEvent("estimate", job_id, told))
        return told

    publish("0", 1, 1.0)
    for done, sigma_um in ((2, 9.0), (2, 9.0), (3, 4.0), (3, 4.0), (3, 3.0)):
        newest = publish("1", done, sigma_um)
    for number in range(2, JOBS + 1):
        publish(str(number), 1, 1.0)
    assert estimates.newest("0") is None
    assert estimates.course("0")["done"] == []
    assert estimates.newest("1") == newest
    assert estimates.course("1") == {
        "elapsed_s": [10.0, 15.0, 15.0],
        "done": [2, 3, 3],
        "volumetric_uncertainty_um": [9.0, 4.0, 3.0],
    }


def test_tables_of_a_rotary_axis_are_over_degrees_with_where_the_axes_are(rng):
    """An estimate of a five-axis machine, every number of it different."""
    machine = machine_from_json(load_machine("head-table"))
    offsets = {t.name: np.array([t.offset_mm]) for t in machine.targets}
    model, _ = build_identifiable_model(machine, np.concatenate(list(offsets.values())))
    theta = rng.normal(scale=1e-3, size=model.size)
    covariance = np.diag(rng.uniform(1e-5, 1e-4, model.size) ** 2)
    told = estimate_json(LiveEstimate(model, theta, covariance, 2e-3, 12, 480, 61.5))
    tables, places = told["error_tables"], told["axis_location"]
    for symbol, table in tables.items():
        place = "position_deg" if symbol[2] in "ABC" else "position_mm"
        value = "um" if symbol[1] in "XYZ" else "urad"
        assert set(table) == {place, f"value_{value}", f"uncertainty_{value}"}
    turning = [table for symbol, table in tables.items() if symbol[2] in "ABC"]
    assert any(max(table["position_deg"]) == 360.0 for table in turning)
    effects = [e for e in model.effects if isinstance(e, AxisLocation)]
    assert {e.symbol for e in effects} == set(places)
    for effect in effects:
        part = model.slices[effect.name]
        value, sigma = theta[part][0], np.sqrt(covariance[part, part][0, 0])
        is_shift = effect.symbol[0] in "XYZ"
        unit, scale = ("um", 1e3) if is_shift else ("urad", 1e6)
        entry = places[effect.symbol]
        assert entry[f"value_{unit}"] == pytest.approx(scale * value, abs=1e-3)
        assert entry[f"uncertainty_{unit}"] == pytest.approx(scale * sigma, abs=1e-3)
