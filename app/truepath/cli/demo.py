"""Calibration without a service: simulated devices, real links, a Run, error tables.

The simulated machine knows its true errors, so at the end the result is compared with
them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from truepath.answers.calibration_report import render_analysis, write_analysis
from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_report import write_verification
from truepath.cli.summary import print_result, summarise_result, warn_of_verdict
from truepath.cli.terminal import NotedProgress, print_json, say, show_progress
from truepath.compensation.active_files import read_active_files
from truepath.compensation.export import export_files
from truepath.compensation.residual_error import remove_rigid_motion
from truepath.errors import BadInput, MeasurementFailed, PlanningError
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.files.bundle.machine_file import decode_machine
from truepath.files.bundle.run import Run
from truepath.files.earlier.result_file import read_result, result_from_json
from truepath.jobs.running.live_estimation import LiveEstimation, LiveSteering
from truepath.jobs.running.live_process import LiveEstimateOrder
from truepath.jobs.running.plan_requests import plan_measurement, request_first_part
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.messages import (
    CellConfig,
    CellState,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import travel_time_s
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_points
from truepath.motion.workspace import check_travel
from truepath.planning.default_path import default_path
from truepath.plugins import load
from truepath.results.analysis import analyse
from truepath.results.prediction import predict
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path as ToolPath

FEWEST_LINES = 8
ADAPTIVE_MINUTES = 5.0
SILENCE_S = 30.0  # without a word from the cell process: something is broken
_POINTS = 500  # places in the volume at which errors are compared
_PROOF = ("statements", "agreement", "map_scale", "volumetric_error_um")
_FORMAT = "isg-csv"  # carries all error motions with their lever arms
_SEED = 7  # of the points, which the measurement does not use


@dataclass(frozen=True, slots=True)
class TruthComparison:
    """Volumetric error at points all over the travel, without rigid motion.

    before_um, after_um : mean length of the true error, and of the residual one
    covered : fraction of all components that lie within two standard uncertainties
    """

    before_um: float
    after_um: float
    covered: float

    @property
    def share_left(self) -> float:
        """Residual as a fraction of the original error."""
        return self.after_um / self.before_um


@dataclass(frozen=True, slots=True)
class Demo:
    """Demonstration according to the options of the command.

    minutes : on the machine's clock; None for the default path
    """

    output: Path
    feed_mm_min: float
    minutes: float | None
    speed: float
    seed: int
    faults: tuple[str, ...] = ()
    target_um: float | None = None
    adaptive: bool = False
    compensate: bool = False

    def run(self, *, as_json: bool) -> None:
        """Measure, analyse, compare with the truth, and print the results."""
        self.output.mkdir(parents=True, exist_ok=True)
        with self._bench() as bench:
            run, lost = self._measure(bench)
            with show_progress("analyse") as on_progress:
                analysis = render_analysis(analyse(run, on_progress=on_progress))
            write_analysis(analysis, self.output)
            write_bundle(run, self.output / "bundle")
            found = compare_with_truth(analysis.result, bench.truth_at)
            left = self._compensate(bench) if self.compensate else None
        warn_of_verdict(analysis.result["verdict"])
        if as_json:
            samples = {"samples": len(run.tracker), "lost_samples": lost}
            truth = {"against_truth": {**asdict(found), "left": found.share_left}}
            proof = {} if left is None else {"as_left": {k: left[k] for k in _PROOF}}
            summary = summarise_result(analysis.result, self.output)
            print_json(summary | samples | truth | proof)
        else:
            print_result(analysis.result, self.output)
            _print_truth_comparison(found, len(run.tracker), lost)
            for statement in () if left is None else left["statements"]:
                print(f"as left: {statement}")

    def _bench(self) -> Any:
        make = load("truepath.simulators", "bench")
        try:
            return make(seed=self.seed, speed=self.speed, faults=self.faults)
        except ValueError as error:
            raise BadInput(str(error)) from error

    def _compensate(self, bench: Any) -> dict[str, Any]:
        result = self.output / "result.json"
        account = export_files(result, _FORMAT, self.output / "compensation" / "tables")
        error = account["volumetric_error_um"]
        before, after = error["before"]["mean"], error["after"]["mean"]
        say(f"tables for {account['control']}: {before:.1f} to {after:.2f} µm expected")
        files = [Path(name) for name in account["files"]]
        bench.load_compensation(files)
        machine = decode_machine(json.dumps(bench.machine).encode())
        points = make_verification_points(
            machine, [VerificationKind.RANDOM_POINTS], _SEED
        )
        run_file = self.output / "as-left.sqlite"
        run_file.unlink(missing_ok=True)
        order = MeasurementOrder("demo, as left", str(run_file), machine, points)
        _run_measurement(Cell(_configure(bench)), order, None, None)
        active = read_active_files(files, _FORMAT, machine)
        assert active is not None  # noqa: S101 (an account names its files)
        with show_progress("verify") as on_progress:
            found = verify(
                read_result(result),
                open_run(run_file),
                correction=active.additional_correction_at,
                on_progress=on_progress,
            )
        left = self.output / "as-left"
        return write_verification(found, left, compensation=active.describe())

    def _measure(self, bench: Any) -> tuple[Run, int]:
        machine = decode_machine(json.dumps(bench.machine).encode())
        request: dict[str, Any] | None = None
        if self.adaptive:
            minutes = self.minutes or ADAPTIVE_MINUTES
            request = {"mode": "otf", "minutes": minutes}
            request["feeds_mm_min"] = [self.feed_mm_min]
            path = _plan_first_part(machine, request)
        else:
            path = plan_path(machine, self.feed_mm_min, self.minutes)
        say(f"tracker on {_describe_options(bench.tracker_options)}")
        say(f"CNC on Modbus TCP {_describe_options(bench.motion_options)}")
        run_file = self.output / "run.sqlite"
        run_file.unlink(missing_ok=True)
        order = MeasurementOrder(
            "demo", str(run_file), machine, path, grows=self.adaptive
        )
        closed = _run_measurement(
            Cell(_configure(bench)), order, self.target_um, request
        )
        return open_run(run_file), closed.lost_samples


def _configure(bench: Any) -> CellConfig:
    return CellConfig(
        "streaming",
        bench.tracker_options,
        "modbus",
        bench.motion_options,
        thermometer_driver="modbus-registers",
        thermometer_options=bench.thermometer_options,
    )


def plan_path(machine: Machine, feed_mm_min: float, minutes: float | None) -> ToolPath:
    """The default path, or one of as many lines as take `minutes`."""
    path = default_path(machine, feed_mm_min)
    if minutes is not None:
        line_s = travel_time_s(path) / (len(path) - 1)
        lines = round(60.0 * minutes / line_s)
        if lines < FEWEST_LINES:
            least = FEWEST_LINES * line_s / 60.0
            raise PlanningError(
                f"{minutes:g} min is too short at {feed_mm_min:g} mm/min; "
                f"give --minutes {least:.1f} or more, or a higher --feed"
            )
        path = default_path(machine, feed_mm_min, lines=lines)
    check_travel(machine, path)
    return path


def compare_with_truth(
    result: Mapping[str, Any], truth_um: Callable[[np.ndarray], np.ndarray]
) -> TruthComparison:
    """Compare a result with the truth.

    truth_um : axis positions (n, 3) in mm to true volumetric errors (n, 3) in µm
    """
    loaded = result_from_json(result)
    low = np.array([axis.low for axis in loaded.machine.linear_axes])
    high = np.array([axis.high for axis in loaded.machine.linear_axes])
    share = np.random.default_rng(_SEED).random((_POINTS, 3))
    position_mm = low + share * (high - low)
    predicted = predict(loaded, position_mm)
    before = remove_rigid_motion(position_mm, truth_um(position_mm))
    left = before - remove_rigid_motion(position_mm, predicted.error_um)
    return TruthComparison(
        float(np.linalg.norm(before, axis=1).mean()),
        float(np.linalg.norm(left, axis=1).mean()),
        float((np.abs(left) <= 2 * predicted.uncertainty_um).mean()),
    )


def _plan_first_part(machine: Machine, request: Mapping[str, Any]) -> Commanded:
    with show_progress("plan") as on_progress:
        order = request_first_part(machine, request)
        return decode_commanded_json(
            plan_measurement(machine, order, on_progress=on_progress)
        )


def _run_measurement(
    cell: Cell,
    order: MeasurementOrder,
    target_um: float | None,
    request: Mapping[str, Any] | None,
) -> RunClosed:
    """Limits of further parts are in `request`, as in `plan_requests`.

    Raises DeviceError, MeasurementFailed. Stops the machine in any case.
    """
    with ExitStack() as stack:
        on_progress = stack.enter_context(show_progress("measure"))
        stack.callback(cell.close)
        cell.start()
        cell.connect()
        steering = None
        if target_um is not None or order.grows:
            asked = LiveEstimateOrder(order.machine, order.commanded, request=request)
            live = LiveEstimation(asked, lambda _: None)
            stack.callback(live.close)
            live.start()
            first = order.commanded if order.grows else None
            steering = LiveSteering(live, cell, first, target_um, _describe_part)
        cell.begin(replace(order, live=steering is not None))
        return _follow_events(cell, on_progress, steering)


def _follow_events(
    cell: Cell, on_progress: NotedProgress, steering: LiveSteering | None
) -> RunClosed:
    failure = MeasurementFailed("the measurement ended early")
    heard_s = host_clock.now_s()
    while host_clock.now_s() - heard_s < SILENCE_S:
        for event in cell.poll(0.2):
            heard_s = host_clock.now_s()
            match event:
                case MeasurementProgress():
                    share = event.done / event.total if event.total else 0.0
                    note = f"{event.samples} samples, {event.lost_samples} lost"
                    on_progress(min(share, 1.0), event.stage, note)
                case FaultReported(text=text, action=action):
                    failure = MeasurementFailed("; ".join(filter(None, [text, action])))
                case RunClosed(outcome=CellState.FINISHED):
                    return event
                case RunClosed():
                    raise failure
                case _ if steering is not None:
                    steering.handle(event)
                case _:
                    pass
        if steering is not None:
            steering.advance()
        if not cell.alive:
            raise MeasurementFailed("the cell process has died; its Run can be opened")
    raise MeasurementFailed(f"the cell process is silent for {SILENCE_S:.0f} s")


def _describe_part(_rows: Commanded, part: Mapping[str, Any]) -> None:
    lines = f"part {part['part']}: {part['rows']} lines, {part['duration_s']:.0f} s"
    say(f"{lines}; predicted to leave {2.0 * part['predicted_um']:.2f} µm (k = 2)")


def _describe_options(options: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in options.items())


def _print_truth_comparison(found: TruthComparison, samples: int, lost: int) -> None:
    print(f"{samples} samples, {lost} lost")
    print(
        f"against the truth over the whole travel: mean {found.before_um:.1f} µm, "
        f"{found.after_um:.2f} µm left ({100 * found.share_left:.1f} %); "
        f"{100 * found.covered:.0f} % of the components within 2 u"
    )
