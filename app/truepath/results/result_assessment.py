"""Whether a result may be used, from the consistency of the whole fit.

Data left out are a reason, and so is a shift of the set-up that was solved for. The
estimated noise may not hide a broken fit: residuals are compared with the stated noise
of the tracker, with the correlated part that is typical, and with a drift of the set-up
during the Run, to which positions measured early and late add.

An estimate cannot distinguish a program that was scaled, sheared or shifted from a
machine that is so. Errors of machines are far smaller than changes of programs, so a
large one is a doubt.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Driving, Observations
from truepath.alignment.stream.left_out import LeftOut
from truepath.errors import Unidentifiable
from truepath.estimation.checks.lack_of_fit import LackOfFit, RangeOffsetScore
from truepath.estimation.checks.robust_estimate import CheckedEstimate
from truepath.estimation.checks.run_segments import SetupShift
from truepath.estimation.checks.setup_shifts import RANGE, TILT
from truepath.estimation.problem.confounded_prior import guess_full_prior
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.noise import compute_places_um
from truepath.estimation.problem.normal_equations import (
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior_model import PriorModel
from truepath.estimation.solve.known_scale import KnownScale
from truepath.files.bundle.run import RunSummary, number_names, summarize_run
from truepath.files.earlier.verdict import Reason, State, Value, Verdict
from truepath.files.environment import (
    NOBODY,
    Refraction,
    find_cause,
    range_scale_uncertainty_ppm,
)
from truepath.files.units import UM_PER_MM, URAD_PER_RAD
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.other_chains import list_orders
from truepath.kinematics.machine.symbols import LINEAR
from truepath.kinematics.model import EstimatedModel, list_lengths
from truepath.results.volumetric_error import VolumetricError

if TYPE_CHECKING:
    from truepath.discovery.discover import Discovery
    from truepath.estimation.live.innovation_gate import LiveCheck

_SENTENCES = 12  # on what is left out of one Run; the rest is counted
_LEFT_OUT = 0.05, 0.25  # of the samples: doubtful, not usable
_RESIDUAL = 1.6, 4.0  # times what the tracker's noise would leave
_WHITE = 1.6, np.inf  # times the stated noise of a sample; it is in the uncertainty
_PLACES = 1.6, 4.0  # the same: told, and doubtful, as a wrong machine looks so too
_DRIFT_GAIN = 110.0  # of 36 parameters: by chance once in 100 million
_DRIFT_MM = 0.001, 0.02  # root mean square
_COMMON_SLOPE = 30e-6  # of good machines: air, 2 K of steel, and how they were set up
_OWN_SLOPE, _OWN_MM = (
    10e-6,
    0.004,
)  # of each axis beside it: of its screw, of its travel
_APART = 6.0  # χ² of two parameters: by chance once in 20
_RANGE_GAIN = 45.0  # of one parameter: other effects that a model lacked made 34
_RANGE_MM = 0.01, 0.1  # of the tracker's distances; a map is off by a fifteenth of it
# White and correlated, of what the tracker states: correlated noise would take what is
# wrong with the chain for the air's.
_NOISE = (1.0, 1.0), (1e-3, 1e-3, 1e-3)
_OTHER_CHAIN = 2.0, 4.0  # times χ² of the best order
_WITHOUT_DATA = {"no-pass": "lines-without-data", "no-stop": "points-without-data"}
_BESIDE = ("before", "after")  # of the path
_LINES = 0.1, 0.5  # of the lines without data
_GAIN = 0.35, 1.0  # expected to be left, of the mean error found
_SLOPE = 4e-4  # of scale and squareness: poor machines reach half of it
_TURN_SLOPE = 7e-4  # of rotary axes, whose errors are large for short turns
_SHIFT_MM, _SHIFT_RAD = 0.3, 1e-3  # of axes against rotary axes
_STEP = 0.01  # mm or deg
_ALIKE = 1e-6  # of the strongest column: what is left of it is rounding


def assess(checked: CheckedEstimate, names: Sequence[str]) -> Verdict:
    """Reasons from a checked estimate.

    names : of the Runs given
    """
    runs = checked.estimate.runs
    reasons: list[Reason] = []
    for number, name in enumerate(names):
        own = [k for k, given in enumerate(checked.given) if given == number]
        said = [
            *_assess_excluded(
                checked.left_out[number],
                sum(runs[k].lines for k in own),
                sum(runs[k].used_samples for k in own),
            ),
            *_assess_setup_shifts([k for k in checked.setup_shifts if k.run == number]),
            *_assess_noise(
                max(checked.misfits[k].ratio for k in own),
                max(max(runs[k].noise.white) for k in own),
                (1.25, 4.0),  # root of χ² over its freedom
            ),
            *_assess_places(
                *max((max(runs[k].noise.place), runs[k].place_um) for k in own)
            ),
            *_assess_ramps(max(runs[k].noise.ramp_sigma_mm for k in own)),
            *_assess_drift([checked.misfits[k] for k in own]),
            *_assess_unseen(
                checked.left_out[number], [checked.misfits[k] for k in own]
            ),
        ]
        reasons += _name_run(said, name, names)
    return Verdict(tuple(reasons))


def assess_driving(drivings: Sequence[Driving | None], names: Sequence[str]) -> Verdict:
    """Reasons from the execution of the program and its recording.

    drivings : of the Runs given; none of standstill points
    """
    reasons = [
        reason
        for driving, name in zip(drivings, names, strict=True)
        if driving is not None
        for reason in _name_run(_assess_driving(driving), name, names)
    ]
    return Verdict(tuple(reasons))


def _name_run(
    reasons: Iterable[Reason], name: str, names: Sequence[str]
) -> list[Reason]:
    """With the Run that they are about, where there are several."""
    return [replace(one, run=name if len(names) > 1 else "") for one in reasons]


def assess_recording(seen: Observations) -> Verdict:
    """Reasons from a recording, before anything is estimated."""
    left_out = _assess_excluded(seen.left_out, len(seen.measured_rows), seen.used)
    return Verdict.merge(
        [Verdict(tuple(left_out)), assess_driving([seen.driving], [""])]
    )


def assess_sensors(summaries: Sequence[RunSummary]) -> Verdict:
    """Sensors with impossible readings; doubtful where one is missing."""
    reasons: list[Reason] = []
    for one in summaries:
        used = {sensor.name for sensor in one.sensors if sensor.is_used}
        last = {text.partition(":")[0]: text for text in one.sensors_left_out}
        for name, text in last.items():
            state = "usable" if name in used else "doubtful"
            run = one.name if len(summaries) > 1 else ""
            reasons.append(Reason("sensor-left-out", state, {"what": text}, run))
    return Verdict(tuple(reasons))


def assess_air(refractions: Sequence[Refraction], names: Sequence[str]) -> Verdict:
    """Runs that are not corrected for the air, or for assumed air only."""
    reasons: list[Reason] = []
    for one, name in zip(refractions, names, strict=True):
        if one.by != NOBODY and not one.why:
            continue
        kind, why = find_cause(one)
        values: dict[str, Value] = {"why": why, "why_kind": kind}
        if one.by == NOBODY:
            found = Reason("air-uncorrected", "doubtful", values)
        else:
            values["within_um"] = 2.0 * range_scale_uncertainty_ppm(one)[0]
            found = Reason("air-assumed", "usable", values)
        reasons += _name_run([found], name, names)
    return Verdict(tuple(reasons))


def assess_scale(found: EstimatedModel, known: KnownScale | None = None) -> Verdict:
    """Scale by known lengths, and whether all axes share one scale error.

    known : scale by known lengths; the estimate is without it
    """
    if known is None:
        return Verdict(
            tuple(_assess_common_slope(found, "all-axes-scaled", "doubtful"))
        )
    values: dict[str, Value] = {
        "lengths": known.lengths,
        "distance_um": 1e6 * known.off,
        "within_um": 1e6 * 2.0 * known.sigma,
    }
    # Both wrong alike: either the bar is, or two unlikely things have happened. Fewer
    # axes do not tell which.
    state = "usable" if known.is_expected else "doubtful"
    is_told = len(list_lengths(found.model)) == len(LINEAR)
    slope = _assess_common_slope(found, "machine-scaled", state)
    return Verdict(
        (Reason("scale-known", "usable" if is_told else state, values), *slope)
    )


def _assess_common_slope(
    found: EstimatedModel, kind: str, state: State
) -> Iterator[Reason]:
    motions = list_lengths(found.model)
    if len(motions) < len(LINEAR):
        return
    slopes = np.zeros((len(motions), found.model.size))
    travel_mm = np.array([motion.axis.high - motion.axis.low for motion in motions])
    for row, motion in zip(slopes, motions, strict=True):
        at_mm = np.linspace(motion.axis.low, motion.axis.high, 2 * motion.spline.size)
        away_mm = at_mm - at_mm.mean()
        row[found.model.slices[motion.name]] = (
            away_mm @ motion.rows(at_mm) / (away_mm @ away_mm)
        )
    slope, covariance = slopes @ found.theta, slopes @ found.covariance @ slopes.T
    covariance += np.diag(_OWN_SLOPE**2 + (_OWN_MM / travel_mm) ** 2)
    weight = np.linalg.solve(covariance, np.ones(len(slope)))
    common, sigma = float(weight @ slope / weight.sum()), float(weight.sum() ** -0.5)
    apart = slope - common
    disagreement = float(apart @ np.linalg.solve(covariance, apart))
    expected = float(np.hypot(sigma, _COMMON_SLOPE))
    if disagreement > _APART or abs(common) < 2.0 * expected:
        return
    values: dict[str, Value] = {
        "distance_um": UM_PER_MM * 1000.0 * common,
        "within_um": UM_PER_MM * 1000.0 * 2.0 * sigma,
    }
    yield Reason(kind, state, values)


def assess_range(
    scores: Sequence[RangeOffsetScore | None],
    given: Sequence[int],
    names: Sequence[str],
) -> Verdict:
    """Whether the distances of a Run all have the same offset.

    scores : of each Run of the estimate; given : the Run that it is of
    """
    worst: dict[int, RangeOffsetScore] = {}
    for score, number in zip(scores, given, strict=True):
        if score is None or score.gain < _RANGE_GAIN:
            continue
        if abs(score.offset_mm) < _RANGE_MM[0]:
            continue
        if number not in worst or score.gain > worst[number].gain:
            worst[number] = score
    reasons: list[Reason] = []
    for number, score in worst.items():
        values: dict[str, Value] = {
            "distance_um": UM_PER_MM * score.offset_mm,
            "within_um": UM_PER_MM * 2.0 * score.sigma_mm,
        }
        state = _grade(abs(score.offset_mm), _RANGE_MM)
        found = Reason("range-off", state, values)
        reasons += _name_run([found], names[number], names)
    return Verdict(tuple(reasons))


def assess_chain(fit: Fit, scores: Sequence[RangeOffsetScore | None]) -> Verdict:
    """Whether the data contradict the order of the linear axes.

    fit : whose result is contradicted; scores : of each of its Runs. The order is
        accepted where an offset of all distances explains as much.
    """
    other, times = _find_better_order(fit, scores)
    if times < _OTHER_CHAIN[0]:
        return Verdict()
    declared = fit.model.machine.chain
    values: dict[str, Value] = {"other": other, "declared": declared}
    state = _grade(times, _OTHER_CHAIN)
    return Verdict((Reason("chain-other", state, values | {"times_ratio": times}),))


def assess_gain(volumetric: VolumetricError) -> Verdict:
    """Whether a compensation is expected to improve the machine."""
    left_um, found_um = volumetric.after.mean.value_um, volumetric.before.mean.value_um
    state = _grade(left_um / max(found_um, 1e-9), _GAIN)
    if state == "usable":
        return Verdict()
    values: dict[str, Value] = {"left_um": left_um, "found_um": found_um}
    return Verdict((Reason("little-gained", state, values),))


def assess_live(check: LiveCheck, lines: int) -> Verdict:
    """Reasons from a measurement in progress.

    lines : that the estimate is made from
    """
    settled = [each for each in check.left_out if each.row not in check.held]
    reasons = [
        *_assess_excluded(settled, lines, check.used_samples),
        *_assess_setup_shifts(check.setup_shifts),
        *_assess_noise(check.residual, check.white),
        *_assess_places(check.place, check.place_um),
    ]
    if check.held:
        values: dict[str, Value] = {
            "lines": _list_lines(check.held),
            "distance_um": UM_PER_MM * check.held_mm,
        }
        reasons.append(Reason("lines-off", "not-usable", values))
    return Verdict(tuple(reasons))


def assess_discovery(found: Discovery, parent: PriorModel | None) -> Verdict:
    """Reasons from a discovery, and from the model that it made.

    Effects found are in the model, so that the residual counts: on lines held out of
    the fit, over that of a complete model, and the estimated noise, over the stated
    noise of the tracker.

    parent : what the Runs were compared with
    """
    names = number_names([one.run.name for one in found.aligned])
    reasons: list[Reason] = []
    for name, one in zip(names, found.aligned, strict=True):
        seen = one.coarse
        said = _assess_excluded(seen.left_out, len(seen.measured_rows), seen.used)
        reasons += _name_run(said, name, names)
    gap = found.gap
    noise = gap.noise_floor_um / gap.beside_places_um
    left = max(gap.after_um / max(gap.expected_um, 1e-12), 1.0)
    white = max(max(run.noise.white) for run in found.baseline.runs)
    reasons += _assess_noise(noise * left, white)
    for run in found.baseline.runs:
        seen = run.observations
        distance_mm = float(np.linalg.norm(seen.tracker_mm, axis=1).mean())
        tracker = seen.at.machine.tracker
        place_um = compute_places_um(tracker, distance_mm, run.noise)
        reasons += _assess_places(max(run.noise.place), place_um)
    used = Verdict() if parent is None else parent.assess_use()
    sensors = assess_sensors([summarize_run(one.run) for one in found.aligned])
    return Verdict.merge([Verdict(tuple(reasons)), sensors, used])


def _assess_excluded(
    left_out: Sequence[LeftOut], measured: int, used: int
) -> Iterator[Reason]:
    """Reasons from samples that are not used.

    measured : lines with data; used : samples
    """
    silent = ("spikes", "astray", "again", *_BESIDE, *_WITHOUT_DATA)
    lost = [each for each in left_out if each.cause not in silent]
    worst = sorted(lost, key=lambda each: -each.samples)[:_SENTENCES]
    for each in sorted(worst, key=lambda each: each.begin_s):
        values: dict[str, Value] = {
            "samples": each.samples,
            "line": each.row,
            "from_s": each.begin_s,
            "to_s": each.end_s,
            "distance_um": UM_PER_MM * each.off_mm,
        }
        yield Reason("samples-left-out", "usable", values)
    for each in left_out:
        if each.cause == "astray":
            values = {
                "line": each.row,
                "from_s": each.begin_s,
                "to_s": each.end_s,
                "distance_um": UM_PER_MM * each.off_mm,
            }
            yield Reason("stream-astray", "doubtful", values)
    for each in left_out:
        if each.cause == "again":
            values = {
                "samples": each.samples,
                "used_samples": used,
                "from_s": each.begin_s,
                "to_s": each.end_s,
            }
            yield Reason("recorded-again", "usable", values)
    beside = {each.cause: each.samples for each in left_out if each.cause in _BESIDE}
    if beside:
        yield Reason("path-cut-short", "usable", dict.fromkeys(_BESIDE, 0) | beside)
    spikes = [each for each in left_out if each.cause == "spikes"]
    few = [each for each in lost if each not in worst] + spikes
    if few:
        values = {
            "samples": sum(each.samples for each in few),
            "distance_um": UM_PER_MM * max(each.off_mm for each in few),
        }
        yield Reason("spikes-left-out", "usable", values)
    for cause, kind in _WITHOUT_DATA.items():
        rows = [each.row for each in left_out if each.cause == cause]
        if rows:
            state = _grade(len(rows) / (measured + len(rows)), _LINES)
            yield Reason(kind, state, {kind.split("-")[0]: _list_lines(rows)})
    apart = ("astray", "again", *_BESIDE)
    # Lines off the path are judged by the lines that they leave without data.
    share = sum(each.samples for each in left_out if each.cause not in apart)
    share /= max(share + used, 1)
    if share > _LEFT_OUT[0]:
        yield Reason(
            "much-left-out",
            _grade(share, _LEFT_OUT),
            {
                "left_out_percent": 100.0 * share,
                "usual_percent": 100.0 * _LEFT_OUT[0],
            },
        )


def _assess_driving(driving: Driving) -> Iterator[Reason]:
    if not driving.is_complete:
        values: dict[str, Value] = {
            "first": max(driving.first, 1),
            "last": driving.last,
            "lines": driving.rows - 1,
        }
        yield Reason("path-not-whole", "usable", values)
    if driving.feed:
        values = {
            "lines": _list_lines(sorted(driving.feed)),
            "lowest_percent": 100.0 * min(driving.feed.values()),
            "highest_percent": 100.0 * max(driving.feed.values()),
        }
        yield Reason("other-feed", "usable", values)
    if driving.holds:
        values = {
            "times": len(driving.holds),
            "lines": _list_lines([row for row, _, _ in driving.holds]),
            "longest_s": max(stood_s for _, _, stood_s in driving.holds),
        }
        yield Reason("held-on-the-way", "usable", values)
    if driving.clock != 1.0:
        values = {"took_percent": 100.0 * driving.clock}
        yield Reason("clock-off", "doubtful", values)
    if driving.missing:
        values = {
            "samples": driving.missing,
            "times": len(driving.gaps_s),
            "longest_s": max(driving.gaps_s),
        }
        yield Reason("samples-missing", "usable", values)


def _assess_ramps(scatter_mm: float) -> Iterator[Reason]:
    if scatter_mm > 0.002:  # less is no matter
        values: dict[str, Value] = {"distance_um": UM_PER_MM * scatter_mm}
        yield Reason("ramps-swing", "usable", values)


def _list_lines(rows: Sequence[int]) -> str:
    more = ", …" if len(rows) > _SENTENCES else ""
    return ", ".join(map(str, rows[:_SENTENCES])) + more


def _assess_setup_shifts(knocks: Sequence[SetupShift]) -> Iterator[Reason]:
    for knock in knocks:
        kind, values = "set-up-moved", {"distance_um": UM_PER_MM * knock.moved_mm}
        if knock.kind == TILT:
            kind, values = (
                "tracker-tilted",
                {"angle_urad": URAD_PER_RAD * knock.turned_rad},
            )
        elif knock.kind == RANGE:
            kind = "range-offset-changed"
        yield Reason(kind, "usable", values | {"at_s": knock.time_s})


def _assess_noise(
    residual: float, white: float, of_fit: tuple[float, float] = _RESIDUAL
) -> Iterator[Reason]:
    for kind, ratio, limits in (
        ("fit-beyond-noise", residual, of_fit),
        ("noise-beyond-stated", white, _WHITE),
    ):
        if ratio > limits[0]:
            values = {"ratio": float(ratio), "limit_ratio": limits[0]}
            yield Reason(kind, _grade(float(ratio), limits), values)


def _assess_places(ratio: float, place_um: Sequence[float]) -> Iterator[Reason]:
    if ratio > _PLACES[0]:
        distances = zip(("range", "azimuth", "elevation"), place_um, strict=True)
        values: dict[str, Value] = {f"{name}_um": um for name, um in distances}
        state = "doubtful" if ratio > _PLACES[1] else "usable"
        yield Reason("places-differ", state, values | {"ratio": ratio})


def _assess_drift(misfits: Sequence[LackOfFit]) -> Iterator[Reason]:
    worst = max(misfits, key=lambda misfit: misfit.drift_mm)
    if worst.drift > _DRIFT_GAIN and worst.drift_mm > _DRIFT_MM[0]:
        yield Reason(
            "loop-open",
            _grade(worst.drift_mm, _DRIFT_MM),
            {
                "distance_um": UM_PER_MM * worst.drift_mm,
                "limit_um": UM_PER_MM * _DRIFT_MM[0],
            },
        )


def _assess_unseen(
    left_out: Sequence[LeftOut], misfits: Sequence[LackOfFit]
) -> Iterator[Reason]:
    """A shift of the set-up that would not show, and may have made data wrong.

    Where the target changes, and nothing from before is measured again, the seats of
    later targets and the locations of axes follow a shift of the set-up.
    """
    unseen = frozenset[int]().union(*(misfit.unseen for misfit in misfits))
    rows = {each.row for each in left_out if each.row >= 0}
    near = sorted(row for row in rows if unseen & {row - 1, row, row + 1})
    if near:
        yield Reason("knock-unseen", "doubtful", {"rows": _list_lines(near)})
    elif unseen:
        values: dict[str, Value] = {"rows": _list_lines(sorted(unseen))}
        yield Reason("not-measured-again", "usable", values)


def _grade(value: float, limits: tuple[float, float]) -> State:
    return ("usable", "doubtful", "not-usable")[int(np.searchsorted(limits, value))]


def _find_better_order(
    fit: Fit, scores: Sequence[RangeOffsetScore | None]
) -> tuple[str, float]:
    """The chain that fits best, and by which factor χ² is less than declared.

    The factor is 1 where the declared one fits as well once distances are corrected.
    The order moves no nominal point, only the levers of turns: alignment cannot see it,
    and the fit bends, or takes it for an error of the tracker.
    """
    declared = fit.model.machine
    names = [axis.name for axis in declared.linear_axes]
    exact = [0.0] * len(fit.runs)
    orders = list_orders(declared, names)
    left = {m.chain: _fit_order(fit, m, exact) for m in orders}
    if np.isinf(left[declared.chain]):  # the data do not determine it
        return declared.chain, 1.0
    best = min(left, key=lambda chain: left[chain])
    offsets_mm = [0.0 if score is None else score.offset_mm for score in scores]
    if _fit_order(fit, declared, offsets_mm) <= left[best]:
        return declared.chain, 1.0
    return best, left[declared.chain] / left[best]


def _fit_order(fit: Fit, machine: Machine, too_long_mm: Sequence[float]) -> float:
    """χ² of an order; infinite where the data do not determine the machine."""
    inputs: list[RunInput] = []
    for run, offset_mm in zip(fit.runs, too_long_mm, strict=True):
        seen, (white, ou) = run.observations, _NOISE
        range_mm = np.linalg.norm(seen.tracker_mm, axis=1)[:, None]
        seen = replace(
            seen,
            at=replace(seen.at, machine=machine),
            tracker_mm=seen.tracker_mm * (1.0 - offset_mm / range_mm),
        )
        noise = replace(run.noise, white=white, ou=ou, place=(0.0, 0.0, 0.0))
        inputs.append(RunInput(seen, run.linearisation.pose, noise))
    offsets_mm = [each.observations.at.offset_mm for each in inputs]
    model, _ = build_identifiable_model(machine, *offsets_mm)
    data = combine_runs(collect_information(inputs, model))
    try:
        return guess_full_prior(model).fit(data)[1].misfit
    except Unidentifiable:
        return np.inf


def assess_program(machine: Machine, volumetric: VolumetricError) -> Verdict:
    """A doubt for each change of the program that explains much of the error."""
    size = _fit_changes(machine, volumetric)
    reasons: list[Reason] = []
    for (kind, axes), value in size.items():
        rotary = not isinstance(machine.axes[axes[0]], LinearAxis)
        most, by = _TURN_SLOPE if rotary else _SLOPE, f"{1e6 * value:+.0f} ppm"
        if kind == "axis-shifted" and rotary:
            most, by = _SHIFT_RAD, f"{np.degrees(value):+.3f}°"
        elif kind == "axis-shifted":
            most, by = _SHIFT_MM, f"{value:+.2f} mm"
        if abs(value) > most:
            names = " ".join(machine.axis_names[k] for k in axes)
            reasons.append(Reason(kind, "doubtful", {"axes": names, "by": by}))
    return Verdict(tuple(reasons))


def _fit_changes(
    machine: Machine, volumetric: VolumetricError
) -> dict[tuple[str, tuple[int, ...]], float]:
    """Size of each change of the program in the error, in mm, rad or ratio."""
    q = volumetric.position_mm
    place = make_standstill(machine, q).point_mm
    moves = [_differentiate(machine, q, k) for k in range(q.shape[1])]
    away = q - (q.min(axis=0) + q.max(axis=0)) / 2.0
    linear = [k for k, axis in enumerate(machine.axes) if isinstance(axis, LinearAxis)]
    columns: dict[tuple[str, tuple[int, ...]], Float64[np.ndarray, "n 3"]] = {}
    for k, move in enumerate(moves):
        unit = 1.0 if k in linear else np.pi / 180.0
        columns["axis-scaled", (k,)] = unit * away[:, [k]] * move
        if machine.rotary_axes:
            columns["axis-shifted", (k,)] = move
    for a, b in combinations(linear, 2):
        columns["axes-leaning", (a, b)] = away[:, [a]] * moves[b]
    flat = np.stack([c.reshape(-1) for c in columns.values()], axis=1)
    error = volumetric.error_um.reshape(-1) / UM_PER_MM
    both = _drop_rigid(place, np.column_stack([flat, error]))
    strength = np.linalg.norm(both[:, :-1], axis=0)
    told = strength > _ALIKE * np.linalg.norm(flat, axis=0)
    size = np.zeros(len(columns))
    scaled = both[:, :-1][:, told] / strength[told]
    size[told] = np.linalg.lstsq(scaled, both[:, -1])[0] / strength[told]
    return dict(zip(columns, size.tolist(), strict=True))


def _differentiate(
    machine: Machine, q: Float64[np.ndarray, "n a"], axis: int
) -> Float64[np.ndarray, "n 3"]:
    """Motion of the target per mm or radian of an axis."""
    step = np.zeros(q.shape[1])
    step[axis] = _STEP
    ahead, behind = (make_standstill(machine, q + s * step).point_mm for s in (1, -1))
    unit = 1.0 if isinstance(machine.axes[axis], LinearAxis) else np.pi / 180.0
    return (ahead - behind) / (2.0 * _STEP * unit)


def _drop_rigid(
    place: Float64[np.ndarray, "n 3"], columns: Float64[np.ndarray, "m c"]
) -> Float64[np.ndarray, "m c"]:
    """Columns without the rigid motions of all points."""
    rigid = np.zeros((len(place), 3, 6))
    rigid[:, :, :3] = np.eye(3)
    for k, turn in enumerate(np.eye(3)):
        rigid[:, :, 3 + k] = np.cross(turn, place - place.mean(axis=0))
    basis = np.linalg.qr(rigid.reshape(-1, 6))[0]
    return columns - basis @ (basis.T @ columns)
