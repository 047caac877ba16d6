"""Cells that read real Modbus sensors of a machine that warms, faults and deaths."""

import numpy as np
import pytest

from driven_cell import CALM, Driven, config_of
from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import summarize_run
from truepath.measurement.messages import MeasurementOrder
from truepath.measurement.run_file.run_loader import open_run
from truepath.planning.default_path import default_path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.hidden.structure import ThermalGrowth

pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]


WARM = ThermalGrowth("X", 11.0, 4.0, 60.0, 3.0)


@pytest.fixture
def bench(tmp_path):
    with Bench(seed=3, speed=8.0, workdir=tmp_path / "b", hidden=[WARM]) as started:
        yield started


@pytest.fixture
def driven(bench):
    """A connected cell with sensors that are asked ten times a second."""
    rows = bench.thermometer_options["registers"]
    quick = [{**row, "period_s": 0.1} for row in rows]
    options = {**bench.thermometer_options, "registers": quick}
    given = {"thermometer_driver": "modbus-registers", "thermometer_options": options}
    config = config_of(bench, timeouts=CALM, **given)
    with Driven(config) as started:
        assert started.cell.connect()["thermometers"].model == "Modbus registers"
        yield started


@pytest.fixture
def order(bench, tmp_path):
    machine = machine_from_json(bench.machine)
    path = default_path(machine, 12_000.0, lines=12)
    return MeasurementOrder("w", str(tmp_path / "w.sqlite"), machine, path)


def test_the_scale_of_a_warm_axis_is_seen_to_warm(driven, order):
    driven.cell.begin(order)
    closed = driven.until_closed(90.0)
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    run = open_run(order.run_file)
    facts = {one.name: one for one in summarize_run(run).sensors}
    assert len(facts) == 7
    assert all(one.is_used for one in facts.values())
    at = run.temperature
    warm = at.celsius[:, at.names.index("X")]
    assert warm[-3:].mean() - warm[:3].mean() > 0.5
    assert abs(facts["Y_degC"].change) < 0.2
    cells = add_surroundings(align(run), run.commanded, run.temperature).at
    assert cells.recorded.sensors == ("X", "Y", "Z", "spindle", "air")
    column = cells.recorded.temperature_degc[:, 0]
    assert np.corrcoef(cells.time_s, column)[0, 1] > 0.9


def test_sensors_fail_one_after_another_and_nothing_else_does(bench, driven, order):
    driven.begin(order, line=2)
    bench.inject("thermometers:broken-wire*1")
    bench.inject("thermometers:exception+2s*4")
    driven.until_line(4)
    bench.inject("thermometers:disconnect")
    driven.until_line(6)
    bench.inject("thermometers:silence+8s")
    closed = driven.until_closed(90.0)
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    codes = set(driven.faults)
    assert codes <= {"sensor-implausible", "sensor-silent"}
    assert "sensor-implausible" in codes
    run = open_run(order.run_file)
    shown = run.temperature.celsius[np.isfinite(run.temperature.celsius)]
    assert (np.abs(shown - 21.5) < 4.0).all()
    late = run.temperature.celsius[len(run.temperature.celsius) // 2 :, 0]
    assert np.isnan(late).all()
    assert any("X_degC" in text for text in summarize_run(run).sensors_told)
