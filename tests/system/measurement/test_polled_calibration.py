"""A calibration at standstill points on the simulated machine, by polled trackers."""

from dataclasses import replace

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
from truepath.motion.paths.default_points import default_points
from truepath.plugins import load
from truepath.results.analysis import analyse
from truepath_simulators.bench.bench import Bench
from truepath_simulators.scenario import load_machine

QUICK = EngineSettings(poll_s=0.02, settle_s=0.1, arrival=0.02)


@pytest.fixture
def calibrate(tmp_path, journal, rigid_free):
    """Calibrate with a driver; return the findings and the judgement of the truth."""

    def made(name, points=40, **figures):
        content = dict(load_machine("demo"))
        content["tracker"] = {**content["tracker"], "rate_hz": 2.0, **figures}
        machine = machine_from_json(content)
        rows = default_points(machine, count=points)
        rows = replace(rows, dwell_s=np.full(len(rows), 0.08))
        file = tmp_path / "run.sqlite"
        order = MeasurementOrder(name, str(file), machine, rows, reserve_bytes=0)
        with (
            Bench(
                content, 7, 20.0, protocol=name, tracker="tcp", error_scale=3.0
            ) as bench,
            load("truepath.trackers", name)(**bench.tracker_options) as tracker,
            load("truepath.motion_controllers", "modbus")(
                **bench.motion_options
            ) as motion,
        ):
            devices = {"tracker": tracker.connect(), "motion": motion.connect()}
            Measurement(order, tracker, motion, devices, journal.report, QUICK).run()
            truth = bench.truth
        assert journal.states[-1] == "finished", journal.events[-3:]
        write_bundle(open_run(file), tmp_path / "bundle")
        found = analyse(read_bundle(tmp_path / "bundle"))
        return found, *_judge(found, truth, machine, rigid_free)

    return made


def _judge(found, truth, machine, rigid_free):
    """Return (mean error before over after, share of the truth within 2u)."""
    low, high = ([getattr(a, end) for a in machine.axes] for end in ("low", "high"))
    q = np.random.default_rng(1).uniform(low, high, (300, 3))
    model = found.estimate.model
    at, maps = make_standstill(model.machine, q), build_volumetric_map(model)
    before = rigid_free(q, truth.deviation_mm(q))
    left = before - rigid_free(q, maps.error_mm(at, found.estimate.theta))
    inside = np.abs(left) < 2 * maps.sigma_mm(at, found.estimate.covariance)
    sizes = [np.linalg.norm(each, axis=1).mean() for each in (before, left)]
    return sizes[0] / sizes[1], float(inside.mean())


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "factor", "figures"),
    [
        ("geocom", 3.0, {"range_sigma_um": 30.0, "angle_sigma_urad": 2.5}),
        ("t2sa", 6.0, {"range_sigma_um": 5.0, "angle_sigma_urad": 3.0}),
    ],
)
def test_a_polled_tracker_calibrates_the_machine(calibrate, name, factor, figures):
    found, reached, inside = calibrate(name, **figures)
    print(f"{name}: {reached:.1f} times better, {inside:.1%} within 2u")
    assert found.verdict.state == "usable"
    assert reached > factor
    assert 0.85 < inside <= 1.0
