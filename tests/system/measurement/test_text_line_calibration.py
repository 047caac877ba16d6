"""Runs recorded from lines of text, over every link, give the tables of the machine."""

import numpy as np
import pytest

from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import MeasurementOrder
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.time_limits import EngineSettings
from truepath.planning.lines.default_path import default_path
from truepath.plugins import load
from truepath.results.analysis import analyse
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.text_relay import TextRelay
from truepath_simulators.scenario import load_machine

WRAPS = 65_536


def write_line(columns):
    """Write metres with decimal commas, semicolons between."""

    def write(samples, k):
        stamps = {
            "time": f"{samples.device_time_s[k]:.6f}",
            "counter": str(samples.sequence[k] % WRAPS),
        }
        cells = [stamps[name] for name in columns.split(",") if name in stamps]
        cells += [f"{v / 1e3:.8f}" for v in samples.position_mm[k]]
        return ";".join([*cells, str(samples.status[k])]).replace(".", ",")

    return write


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("link", "rate_hz", "columns", "feed_mm_min"),
    [
        ("tcp", 500.0, "counter,time,x,y,z,status", 12_000.0),
        ("udp", 500.0, "time,x,y,z,status", 12_000.0),
        ("pty", 500.0, "counter,x,y,z,status", 12_000.0),
        ("pty", 50.0, "time,x,y,z,status", 6_000.0),
        ("udp", 50.0, "counter,x,y,z,status", 6_000.0),
    ],
)
def test_lines_of_text_calibrate_the_machine(
    link, rate_hz, columns, feed_mm_min, tmp_path, journal, rigid_free
):
    content = dict(load_machine("demo"))
    content["tracker"] = {**content["tracker"], "rate_hz": rate_hz}
    machine, file = machine_from_json(content), tmp_path / "run.sqlite"
    path = default_path(machine, feed_mm_min, lines=24)
    order = MeasurementOrder(
        "text", str(file), machine, path, rate_hz=rate_hz, reserve_bytes=0
    )
    with (
        Bench(content, 11, tracker="tcp", rtu=False) as bench,
        TextRelay(
            StreamingTracker(**bench.tracker_options),
            write_line(columns),
            rate_hz=rate_hz,
            link=link,
        ) as relay,
        TextLineTracker(
            **relay.options,
            rate_hz=rate_hz,
            columns=columns,
            delimiter="semicolon",
            decimal_comma=True,
            unit="m",
            counter_wraps=WRAPS if "counter" in columns else 0,
        ) as tracker,
        load("truepath.motion_controllers", "modbus")(**bench.motion_options) as motion,
    ):
        devices = {"tracker": tracker.connect(), "motion": motion.connect()}
        settings = EngineSettings()
        Measurement(order, tracker, motion, devices, journal.report, settings).run()
        health, truth = tracker.health, bench.truth
    assert journal.states[-1] == "finished", journal.events[-3:]
    assert (health.lost_samples, health.crc_errors) == (0, 0)
    write_bundle(open_run(file), tmp_path / "bundle")
    found = analyse(read_bundle(tmp_path / "bundle"))
    low, high = ([getattr(a, end) for a in machine.axes] for end in ("low", "high"))
    q = np.random.default_rng(1).uniform(low, high, (300, 3))
    at = make_standstill(found.estimate.model.machine, q)
    maps = build_volumetric_map(found.estimate.model)
    before = rigid_free(q, truth.deviation_mm(q))
    left = before - rigid_free(q, maps.error_mm(at, found.estimate.theta))
    inside = np.abs(left) < 2 * maps.sigma_mm(at, found.estimate.covariance)
    was, rest = (1e3 * np.linalg.norm(v, axis=1).mean() for v in (before, left))
    print(f"{link} {rate_hz:g} Hz {columns}: {was:.1f} to {rest:.2f} µm")
    print(f"{inside.mean():.1%} inside 2u")
    assert found.verdict.state == "usable"
    assert rest < 0.06 * was
    assert inside.mean() > 0.85
