"""Circles executed on the fly, and the prediction of a result for them.

The prediction is of the same sectors in the same senses: with the direction, the speed
and the distance since the reversal of each axis there, so that lost motion, reversal
spikes and following errors are in it where the result's model has them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.stream.cleaning import detect_valid_samples
from truepath.answers.verification.circle_figures import (
    CommandedCircle,
    DrivenCircle,
    Sectors,
    StatedFigures,
    average_over_sectors,
    compute_figures,
    estimate_figures,
    list_sector_angles,
    sample_normal,
)
from truepath.estimation.problem.normal_equations import RunInput
from truepath.files.bundle.run import Run
from truepath.files.earlier.result_file import CalibrationResult
from truepath.files.environment import state_length_ppm
from truepath.files.units import PER_PPM, UM_PER_MM
from truepath.kinematics.conditions import Conditions, observe_targets
from truepath.kinematics.effects.base import Effect
from truepath.numerics.rigid import RigidTransform
from truepath_drivers.interfaces.arcs import measure_radius_mm, turn_about
from truepath_drivers.interfaces.records import Path

_Displace = Callable[[Conditions], Float64[np.ndarray, "n 3"]]
"""Predicted displacement of the target from nominal, mm."""


@dataclass(frozen=True, slots=True)
class CircleInMotion:
    """One circle, in the senses in which it was executed completely.

    driven : by sense; radial_um, expected_um : about the commanded centre
    first_row : of the plan, that its Run begins with
    """

    driven: dict[str, DrivenCircle]
    measured: StatedFigures
    predicted_um: dict[str, float]
    predicted_uncertainty_um: dict[str, float]
    expected_um: dict[str, Sectors]
    first_row: int = 0

    @property
    def row(self) -> dict[str, int]:
        """Rows of the plan, by sense."""
        return {s: self.first_row + one.drive.row for s, one in self.driven.items()}

    @property
    def commanded(self) -> CommandedCircle:
        """In one of its senses."""
        return next(iter(self.driven.values())).commanded

    @property
    def radial_um(self) -> dict[str, Sectors]:
        """Radius less the commanded one by sense, in each sector."""
        return {name: UM_PER_MM * one.radial_mm for name, one in self.driven.items()}


@dataclass(frozen=True, slots=True)
class CirclesInMotion:
    """Circles of a Run.

    whole : rows of the plan whose arcs are evaluated
    broken : rows of circles without a complete arc, however often they were executed
    """

    circles: tuple[CircleInMotion, ...] = ()
    whole: tuple[int, ...] = ()
    broken: tuple[int, ...] = ()


def evaluate_circles(
    run: Run,
    observations: Observations,
    fitted: RunInput,
    result: CalibrationResult,
    displace: _Displace,
    errors: Sequence[Effect],
    first_row: int,
) -> CirclesInMotion:
    """Circles of a Run; of a repeated one the latest.

    fitted : for pose and noise; errors : of the tracker within its specification
    first_row : of the plan, that the Run begins with
    """
    path = run.commanded
    if not isinstance(path, Path) or not any(path.arc):
        return CirclesInMotion()
    usable = detect_valid_samples(run.tracker, path.target)
    groups: dict[tuple[object, ...], dict[str, DrivenCircle]] = {}
    whole: set[int] = set()
    for drive in observations.arcs:
        commanded = read_commanded(run, path, drive.row)
        rows = drive.first + np.flatnonzero(usable[drive.first : drive.last])
        stream = run.tracker.device_time_s[rows], run.tracker.position_mm[rows]
        driven = average_over_sectors(
            commanded, drive, *stream, fitted.pose, fitted.noise, run.machine.tracker
        )
        if driven is not None:
            whole.add(first_row + drive.row)
            groups.setdefault(_key(commanded), {})[commanded.sense] = driven
    missing: dict[tuple[object, ...], int] = {}
    for row, arc in enumerate(path.arc):
        if arc is not None and row > 0:
            commanded = read_commanded(run, path, row)
            if commanded.sense not in groups.get(_key(commanded), ()):
                missing.setdefault((_key(commanded), commanded.sense), first_row + row)
    circles: list[CircleInMotion] = []
    for senses in groups.values():
        ordered = sorted(senses.items(), reverse=True)  # counterclockwise first
        driven = {
            sense: (one, _build_conditions(one, run, path, observations, fitted.pose))
            for sense, one in ordered
        }
        one = _evaluate(driven, run, result, displace, errors)
        circles.append(replace(one, first_row=first_row))
    return CirclesInMotion(
        tuple(circles), tuple(sorted(whole)), tuple(missing.values())
    )


def merge_circles(parts: Sequence[CirclesInMotion]) -> CirclesInMotion:
    """Circles of all parts of a Run, each in the frame of its own part.

    Senses in different parts are not combined: the tracker may have moved.
    """
    whole = {row for part in parts for row in part.whole}
    broken = {row for part in parts for row in part.broken} - whole
    circles = tuple(one for part in parts for one in part.circles)
    return CirclesInMotion(circles, tuple(sorted(whole)), tuple(sorted(broken)))


def _key(one: CommandedCircle) -> tuple[object, ...]:
    centre = np.round(one.centre_mm, 2).tolist()
    return (one.plane, *centre, round(one.radius_mm, 2), round(one.feed_mm_min, 3))


def read_commanded(run: Run, path: Path, row: int) -> CommandedCircle:
    """The arc to a row, in the frame that the tracker is mounted on."""
    arc = path.arc[row]
    if arc is None:
        raise ValueError(f"row {row} is driven to on a straight line")
    begin = path.position[row - 1]
    columns = [path.axes.index(name) for name in arc.axes]
    points = np.tile(begin, (3, 1))
    points[:, columns] = arc.centre_mm
    points[[1, 2], columns] += 1.0
    order = [path.axes.index(name) for name in run.machine.axis_names]
    target = run.machine.target(path.target[row] if path.target else "")
    observed = observe_targets(run.machine, points[:, order], [target]).point_mm
    out = begin[columns] - arc.centre_mm
    return CommandedCircle(
        arc.axes,
        observed[0],
        observed[1:] - observed[0],
        measure_radius_mm(path.axes, begin, arc),
        float(np.degrees(np.arctan2(out[1], out[0]))),
        arc.turn_deg,
        float(path.feed_mm_min[row]),
    )


def _evaluate(
    driven: Mapping[str, tuple[DrivenCircle, Conditions]],
    run: Run,
    result: CalibrationResult,
    displace: _Displace,
    errors: Sequence[Effect],
) -> CircleInMotion:
    senses = {sense: one for sense, (one, _) in driven.items()}
    radius_mm = next(iter(senses.values())).commanded.radius_mm
    expected: dict[str, Sectors] = {}
    columns: dict[str, Float64[np.ndarray, "s p"]] = {}
    common: dict[str, Float64[np.ndarray, "s c"]] = {}
    for sense, (one, at) in driven.items():
        out = one.commanded.outwards(list_sector_angles())
        turned = [np.zeros((len(at), 3, 0)), *(e.jacobian(at) for e in errors)]
        common[sense] = np.einsum("si,sip->sp", out, np.concatenate(turned, axis=2))
        expected[sense] = np.einsum("si,si->s", out, displace(at))
        columns[sense] = np.einsum("si,sip->sp", out, result.model.jacobian(at))
    ppm = state_length_ppm(run.refraction, run.machine.tracker.range_ppm)
    measured = estimate_figures(
        {sense: one.radial_mm for sense, one in senses.items()},
        {sense: one.covariance_mm2 for sense, one in senses.items()},
        common,
        PER_PPM * ppm * radius_mm,
    )
    parameters = sample_normal(np.random.default_rng(2), result.covariance)
    spread = compute_figures(
        {s: expected[s][:, None] + columns[s] @ parameters for s in senses}
    )
    plain = compute_figures({s: expected[s][:, None] for s in senses})
    return CircleInMotion(
        senses,
        measured,
        {name: UM_PER_MM * float(one[0]) for name, one in plain.items()},
        {
            name: UM_PER_MM * float(np.sqrt(np.mean((one - plain[name]) ** 2)))
            for name, one in spread.items()
        },
        {sense: UM_PER_MM * one for sense, one in expected.items()},
    )


def _build_conditions(
    driven: DrivenCircle,
    run: Run,
    path: Path,
    observations: Observations,
    pose: RigidTransform,
) -> Conditions:
    """Conditions in the middle of each sector, as measured.

    Temperatures and other axes are those of the cell nearest in time.
    """
    row, commanded = driven.drive.row, driven.commanded
    arc = path.arc[row]
    if arc is None:
        raise ValueError(f"row {row} is driven to on a straight line")
    cells = observations.at
    nearest = np.abs(cells.time_s - driven.time_s[:, None]).argmin(axis=1)
    at = cells.select(nearest)
    machine_axes = run.machine.axis_names
    columns = [machine_axes.index(name) for name in arc.axes]
    order = [path.axes.index(name) for name in machine_axes]
    angle_deg = list_sector_angles()
    begin = path.position[row - 1]
    position = turn_about(path.axes, begin, arc, angle_deg - commanded.begin_deg)
    sign, angle = float(np.sign(arc.turn_deg)), np.radians(angle_deg)
    way = sign * np.column_stack([-np.sin(angle), np.cos(angle)])
    speed = driven.feed_mm_min / 60.0
    rate, gone = np.zeros_like(at.position_mm), np.full_like(at.position_mm, np.inf)
    approach, inwards = at.approach.copy(), np.zeros_like(at.position_mm)
    rate[:, columns], approach[:, columns] = speed * way, np.sign(way)
    # Distance of both axes since they reversed.
    past = np.column_stack([(sign * (angle_deg - first)) % 180.0 for first in (0, 90)])
    gone[:, columns] = commanded.radius_mm * (1.0 - np.cos(np.radians(past)))
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    inwards[:, columns] = -(speed**2) / commanded.radius_mm * out
    recorded = at.recorded
    if recorded is not None:
        recorded = replace(
            recorded,
            rate=rate,
            span_s=driven.span_s,
            since_reversal=gone,
            tracker_mm=pose.apply(commanded.place_mm(angle_deg)),
        )
    return replace(
        at,
        position_mm=position[:, order],
        time_s=driven.time_s,
        line=np.full(len(nearest), row),
        line_time_s=np.zeros(len(nearest)),
        velocity_mm_s=speed * way @ commanded.along,
        approach=approach,
        recorded=recorded,
        acceleration=inwards,
    )
