"""Most effective changes, by trial: one more line, or another set-up of the tracker.

Lines along each axis at the ends and the middle of the others, and the diagonals of the
travel; each is evaluated by the same algebra as the measurement itself. The decrease of
the motion's variance at the tool decides.

Errors of the tracker do not decrease with lines or time, but by the same rows from
another station, from the same one with the base turned, or in the second face: the same
error then acts differently.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.machine.machine import Machine, position_unit
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Commanded, join_rows, select_rows
from truepath.motion.workspace import inner_travel
from truepath.numerics.design_criteria import IntegratedVariance
from truepath.planning.forecast import Assumptions, Forecast, predict_with_each
from truepath.planning.simulated_cells import EXPECTED_NOISE, predict_cells
from truepath_drivers.interfaces.records import Path

_POINTS = 12  # cells of a line, or points on it
_SAMPLES = 100  # in the mean of a cell
_TURNS_RAD = (0.5 * np.pi, np.pi)  # of the base: errors once and twice a turn change
_TURN_S = 300.0  # to turn the base, and to let it settle
_FACE_S = 60.0  # to turn the head over and to lock again
_PLACES = {"low": "low end", "middle": "middle", "high": "high end"}


@dataclass(frozen=True, slots=True)
class Remedy:
    """A line to add, or standstill points on it: in words, and its ends.

    begin, end : axis positions in the column order of the machine
    """

    text: str
    begin: Float64[np.ndarray, " a"]
    end: Float64[np.ndarray, " a"]


def find_best_line(
    symbol: str,
    seen: Observations,
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
    gram: Float64[np.ndarray, "p p"],
) -> Remedy:
    """The line that reduces a motion's uncertainty most.

    covariance : of the model's θ after the measurement
    """
    part = model.slices[symbol]
    own = np.zeros_like(gram)
    own[part, part] = gram[part, part]
    lines = list(_lines(model.machine))
    rows = np.stack([_rows(line, seen, model) for line in lines])
    return lines[
        int(np.argmax(IntegratedVariance(covariance, own).compute_drops(rows)))
    ]


def append_line(commanded: Commanded, line: Remedy) -> Commanded:
    is_path = isinstance(commanded, Path)
    share = np.array([0.0, 1.0]) if is_path else np.linspace(0.0, 1.0, _POINTS)
    more, last = len(share), select_rows(commanded, slice(-1, None))
    added = replace(
        last,
        position=line.begin + share[:, None] * (line.end - line.begin),
        dwell_s=np.full(more, commanded.dwell_s.max()),
        target=last.target * more,
    )
    if isinstance(added, Path):
        added = replace(added, feed_mm_min=np.repeat(added.feed_mm_min, more))
    return join_rows([commanded, added])


@dataclass(frozen=True, slots=True)
class SetUpRemedy:
    """The rows once more, with the tracker set up differently.

    change : `second-place`, `turned-base` or `other-face`
    turn_rad : of the base, relative to before
    added_s : its time, moving and measuring
    sigma_mm : volumetric, of both measurements together
    removed_mm : decrease relative to the plan
    """

    change: str
    place_mm: Float64[np.ndarray, "3"]
    turn_rad: float
    added_s: float
    sigma_mm: float
    removed_mm: float

    @property
    def mm_per_s(self) -> float:
        return self.removed_mm / self.added_s


def list_set_up_remedies(
    machine: Machine,
    commanded: Commanded,
    found: Forecast,
    assumed: Assumptions,
    *,
    here_mm: Float64[np.ndarray, "3"],
    elsewhere_mm: Sequence[Float64[np.ndarray, "3"]],
    takes_s: float,
    move_s: float,
) -> tuple[SetUpRemedy, ...]:
    """Most effective changes against the tracker's errors, by decrease per second.

    commanded, takes_s : the rows that are measured once more; found : after the plan
    here_mm : station of the tracker; elsewhere_mm : other possible stations
    move_s : time to move it
    """
    if not any(map(is_tracker_error, found.model.effects)):  # a perfect tracker
        return ()
    ways = [("second-place", machine, place, 0.0, move_s) for place in elsewhere_mm]
    ways += [("turned-base", machine, here_mm, turn, _TURN_S) for turn in _TURNS_RAD]
    if face := machine.tracker.face:
        turned_over = replace(machine, tracker=replace(machine.tracker, face=3 - face))
        ways.append(("other-face", turned_over, here_mm, 0.0, _FACE_S))
    cells = [
        predict_cells(seen, commanded, place, turn_rad=turn)
        for _, seen, place, turn, _ in ways
    ]
    left_mm = predict_with_each(machine, found, cells, assumed)
    best: dict[str, SetUpRemedy] = {}
    for (change, _, place, turn, set_up_s), sigma_mm in zip(ways, left_mm, strict=True):
        removed_mm = found.volumetric_sigma_mm - sigma_mm
        added_s = set_up_s + takes_s
        one = SetUpRemedy(change, place, turn, added_s, sigma_mm, removed_mm)
        if change not in best or one.mm_per_s > best[change].mm_per_s:
            best[change] = one
    return tuple(sorted(best.values(), key=lambda one: -one.mm_per_s))


def _lines(machine: Machine) -> Iterator[Remedy]:
    low, high = inner_travel(machine)
    middle = (low + high) / 2.0
    rest = np.array([np.clip(0.0, a.low, a.high) for a in machine.rotary_axes])
    linear = len(machine.linear_axes)
    at = {"low": low, "middle": middle, "high": high}
    for column, axis in enumerate(machine.axes):
        others = [k for k in range(linear) if k != column]
        for places in itertools.product(_PLACES, repeat=len(others)):
            begin = np.concatenate([middle[:linear], rest])
            for k, place in zip(others, places, strict=True):
                begin[k] = at[place][k]
            end = begin.copy()
            begin[column], end[column] = low[column], high[column]
            where = " and ".join(
                f"the {_PLACES[place]} of {machine.axes[k].name}"
                for k, place in zip(others, places, strict=True)
            )
            yield Remedy(f"a line along {axis.name} at {where}", begin, end)
    for corner in itertools.product((0, 1), repeat=max(linear - 1, 0)):
        side = np.array([0, *corner])
        begin = np.concatenate([np.where(side, high[:linear], low[:linear]), rest])
        end = np.concatenate([np.where(side, low[:linear], high[:linear]), rest])
        corners = [_format_place(machine, end) for end in (begin, end)]
        yield Remedy(f"the diagonal from {' to '.join(corners)}", begin, end)


def _format_place(machine: Machine, position: Float64[np.ndarray, " a"]) -> str:
    return " ".join(
        f"{axis.name}{value:.0f}{'°' if position_unit(axis) == 'deg' else ''}"
        for axis, value in zip(machine.axes, position, strict=True)
    )


def _rows(
    line: Remedy, seen: Observations, model: MachineModel
) -> Float64[np.ndarray, "r p"]:
    """Rows of a line in units of the noise, phase and speed projected out."""
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    position = line.begin + share[:, None] * (line.end - line.begin)
    offset = np.tile(seen.at.offset_mm[0], (_POINTS, 1))
    at = make_standstill(model.machine, position, offset)
    aside = seen.at.on_workpiece
    if aside is not None:
        at = at.view_from(seen.at.observer, np.tile(aside[:1], _POINTS))
    columns = model.jacobian(at)
    direction = at.point_mm[-1] - at.point_mm[0]
    length = float(np.linalg.norm(direction))
    if length > 0.0:
        direction = direction / length
        along = np.einsum("d,ndp->np", direction, columns)
        law = np.stack([np.ones(_POINTS), share], axis=1)
        known = law @ (np.linalg.pinv(law) @ along)
        columns = columns - direction[None, :, None] * known[:, None, :]
    distance = np.linalg.norm(seen.tracker_mm, axis=1)
    stated = seen.at.machine.tracker.sigma_mm(distance[:, None].mean(axis=0))[0]
    white, ou = EXPECTED_NOISE.white[1], EXPECTED_NOISE.ou[1]
    scale = np.sqrt(white**2 / _SAMPLES + ou**2)
    sigma_mm = scale * np.sqrt((stated[0] ** 2 + 2.0 * stated[1] ** 2) / 3.0)
    return columns.reshape(3 * _POINTS, -1) / float(sigma_mm)
