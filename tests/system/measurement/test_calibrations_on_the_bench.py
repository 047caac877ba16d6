"""Lines of text and polled trackers give the tables of the machine as well."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.measurement.engine.measurement import Measurement
from truepath.measurement.messages import MeasurementOrder
from truepath.measurement.run_file.run_loader import open_run
from truepath.measurement.time_limits import EngineSettings
from truepath.motion.paths.default_points import default_points
from truepath.planning.default_path import default_path
from truepath.plugins import load
from truepath.results.analysis import analyse
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.text_relay import TextRelay
from truepath_simulators.machine_file import load_machine

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]

WRAPS = 65_536
QUICK = EngineSettings(poll_s=0.02, settle_s=0.1, arrival=0.02)


@pytest.fixture
def calibrate(tmp_path, journal, rigid_free):
    def made(bench, tracker, commanded, settings):
        """Return (mean error before over after, share of the truth within 2u)."""
        machine, file = machine_from_json(bench.machine), tmp_path / "run.sqlite"
        given = "bench", str(file), machine, commanded, machine.tracker.rate_hz
        order = MeasurementOrder(*given, reserve_bytes=0)
        factory = load("truepath.motion_controllers", "modbus")
        with factory(**bench.motion_options) as motion:
            devices = {"tracker": tracker.connect(), "motion": motion.connect()}
            report = journal.report
            Measurement(order, tracker, motion, devices, report, settings).run()
        assert journal.states[-1] == "finished", journal.events[-3:]
        write_bundle(open_run(file), tmp_path / "bundle")
        found = analyse(read_bundle(tmp_path / "bundle"))
        assert found.verdict.state == "usable"
        low, high = ([getattr(a, end) for a in machine.axes] for end in ("low", "high"))
        q = np.random.default_rng(1).uniform(low, high, (300, 3))
        model = found.estimate.model
        at, maps = make_standstill(model.machine, q), build_volumetric_map(model)
        before = rigid_free(q, bench.truth.deviation_mm(q))
        left = before - rigid_free(q, maps.error_mm(at, found.estimate.theta))
        inside = np.abs(left) < 2 * maps.sigma_mm(at, found.estimate.covariance)
        was, rest = (np.linalg.norm(each, axis=1).mean() for each in (before, left))
        print(f"{was / rest:.1f} times better, {inside.mean():.1%} within 2u")
        return was / rest, float(inside.mean())

    return made


def load_demo(**figures):
    content = load_machine("demo")
    return content | {"tracker": {**content["tracker"], **figures}}


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
def test_text_lines_calibrate_a_machine(calibrate, link, rate_hz, columns, feed_mm_min):
    def write_line(samples, k):
        stamps = {"time": f"{samples.device_time_s[k]:.6f}"}
        stamps["counter"] = str(samples.sequence[k] % WRAPS)
        cells = [stamps[name] for name in columns.split(",") if name in stamps]
        cells += [f"{v / 1e3:.8f}" for v in samples.position_mm[k]]
        return ";".join([*cells, str(samples.status[k])]).replace(".", ",")

    content = load_demo(rate_hz=rate_hz)
    path = default_path(machine_from_json(content), feed_mm_min, lines=24)
    options = {"rate_hz": rate_hz, "columns": columns, "delimiter": "semicolon"}
    options |= {"decimal_comma": True, "unit": "m"}
    options["counter_wraps"] = WRAPS if "counter" in columns else 0
    how = {"rate_hz": rate_hz, "link": link}
    with (
        Bench(content, 11, tracker="tcp", rtu=False) as bench,
        TextRelay(
            StreamingTracker(**bench.tracker_options), write_line, **how
        ) as relay,
        TextLineTracker(**relay.options, **options) as tracker,
    ):
        better, inside = calibrate(bench, tracker, path, EngineSettings())
        damaged = tracker.health.crc_errors
    assert damaged == 0
    assert better > 1 / 0.06
    assert inside > 0.85


@pytest.mark.parametrize(
    ("name", "factor", "figures"),
    [
        ("geocom", 3.0, {"range_sigma_um": 30.0, "angle_sigma_urad": 2.5}),
        ("t2sa", 6.0, {"range_sigma_um": 5.0, "angle_sigma_urad": 3.0}),
    ],
)
def test_a_polled_tracker_calibrates_the_machine(calibrate, name, factor, figures):
    content = load_demo(rate_hz=2.0, **figures)
    points = default_points(machine_from_json(content), count=40)
    points = replace(points, dwell_s=np.full(len(points), 0.08))
    given = {"protocol": name, "tracker": "tcp", "error_scale": 3.0}
    with (
        Bench(content, 7, 20.0, **given) as bench,
        load("truepath.trackers", name)(**bench.tracker_options) as tracker,
    ):
        better, inside = calibrate(bench, tracker, points, QUICK)
    assert better > factor
    assert 0.85 < inside <= 1.0
