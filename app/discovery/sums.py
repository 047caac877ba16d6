"""Sums over lines of everything that may explain them, in folds of whole lines.

Each line is whitened by itself, and its phase and speed are integrated out. So the sums
of some lines tell what would be known without the others, and what is asked of the
others, without touching a sample again: what is held out is always whole lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from app.alignment.observations import Observations
from app.alignment.reduction import beam_frame
from app.estimation.information import Information
from app.estimation.noise import NoiseModel, whiten
from app.kinematics.effects.base import Conditions, Effect
from app.kinematics.effects.catalogue import Wave
from app.kinematics.effects.of_run import OfRun
from app.kinematics.effects.timing_law import TimingLaw
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.model import MachineModel
from app.numerics.correlated_noise import Whitener
from app.numerics.rigid import RigidTransform

TIMING = 2
_NOTHING = 1e-12
_FEWEST_LINES = 2  # in each fold, of a further Run that is held out


@dataclass(frozen=True)
class Base:
    """What all explanations of a Run share: machine, pose, noise; linear about them.

    theta : (p,) of the model, about which the machine is linear: 0 where it is fitted
    runs : how many Runs are explained together, each with a pose of its own
    """

    model: MachineModel
    pose: RigidTransform
    centre_mm: tuple[float, float, float]
    noise: NoiseModel
    theta: Float64[np.ndarray, " p"]
    runs: int = 1

    @property
    def size(self) -> int:
        """Number of parameters of machine and poses."""
        return self.model.size + 6 * self.runs

    @property
    def poses(self) -> tuple[Effect, ...]:
        """Where the tracker stands, in each Run."""
        return tuple(OfRun(TrackerPose(self.centre_mm), k) for k in range(self.runs))


class FastSums(Protocol):
    """What samples tell within their cells."""

    def sums(
        self, effects: Sequence[Effect], folds: int
    ) -> tuple[Float64[np.ndarray, "k q q"], list[tuple[int, int]]]:
        """Return the sums on fast effects and data, and which columns they are."""
        ...

    def squares(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return the weighted squares of the data."""
        ...

    def wave(
        self, wave: Wave
    ) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
        """Return data and weight of a wave in time."""
        ...

    def freedom(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return their degrees of freedom."""
        ...


@dataclass(frozen=True)
class View:
    """What one Run shows, and what it is held against.

    within : what its samples tell within their cells
    """

    seen: Observations
    base: Base
    within: FastSums | None = None


@dataclass(frozen=True)
class FoldedSums:
    """Sums over each fold of lines; columns are machine, poses, effects, data.

    fold : (k, q, q); freedom : (k,) observations less phases and speeds
    always : (q, q) of the lines that are never held out
    log_determinant : of the noise of all lines
    fast_square, fast_freedom : (k,) of the samples within cells; fast effects have
        their share of them in the sums, the squared data have not
    """

    fold: Float64[np.ndarray, "k q q"]
    freedom: Float64[np.ndarray, " k"]
    always: Float64[np.ndarray, "q q"]
    log_determinant: float
    fast_square: Float64[np.ndarray, " k"]
    fast_freedom: Float64[np.ndarray, " k"]

    def total(self) -> Float64[np.ndarray, "q q"]:
        """Return the sums over all lines."""
        return self.fold.sum(axis=0) + self.always

    def information(self, columns: Int64[np.ndarray, " m"]) -> Information:
        """Return the information of all lines on some of the columns."""
        return information_of(self.total(), columns, self.log_determinant)


def information_of(
    total: Float64[np.ndarray, "q q"],
    columns: Int64[np.ndarray, " m"],
    log_determinant: float = 0.0,
) -> Information:
    """Return the information in sums on some of the columns; data are the last."""
    return Information(
        total[np.ix_(columns, columns)],
        total[columns, -1],
        float(total[-1, -1]),
        log_determinant,
    )


@dataclass(frozen=True)
class Line:
    """One line or standstill: timing, base and data, whitened once for all effects.

    fold : that it is held out with; None if it never is
    white, slow : halves of the columns timing, machine, pose, data
    """

    fold: int | None
    at: Conditions
    frame: Float64[np.ndarray, "n 3 3"]
    whitener: Whitener
    white: Float64[np.ndarray, "m q"]
    slow: Float64[np.ndarray, "s q"]
    freedom: float


class Lines:
    """All lines of all Runs with their base; effects are added to them.

    Line k belongs to fold k modulo the number of folds: neighbours in time, which the
    same moment made alike, are held out by different folds. A further Run of few lines
    is held out nowhere: short of one it would not know where its tracker stood.
    """

    def __init__(self, views: Sequence[View], folds: int) -> None:
        self._folds = folds
        self._size = views[0].base.size
        self._within: list[tuple[FastSums, bool]] = []
        self._lines: list[Line] = []
        for number, view in enumerate(views):
            parts = stretches(view.seen)
            is_held = number == 0 or len(parts) >= _FEWEST_LINES * folds
            for k, (first, last) in enumerate(parts):
                seen = view.seen.taken(np.arange(first, last))
                self._lines.append(
                    _line(seen, view.base, k % folds if is_held else None)
                )
            if view.within is not None:
                self._within.append((view.within, is_held))

    def sums(self, effects: Sequence[Effect]) -> FoldedSums:
        """Return the sums of all lines on machine, poses, effects and data."""
        count = sum(len(e.parameters) for e in effects)
        size = self._size + count + 1
        total, always = np.zeros((self._folds, size, size)), np.zeros((size, size))
        freedom, log_determinant = np.zeros(self._folds), 0.0
        for line in self._lines:
            one, told, log_timing = _timing_out(_with_effects(line, effects))
            log_determinant += line.whitener.log_determinant + log_timing
            if line.fold is None:
                always += one
            else:
                total[line.fold] += one
                freedom[line.fold] += line.freedom - told
        fast = self._with_fast(total, always, effects)
        return FoldedSums(total, freedom, always, log_determinant, *fast)

    def _with_fast(
        self,
        total: Float64[np.ndarray, "k q q"],
        always: Float64[np.ndarray, "q q"],
        effects: Sequence[Effect],
    ) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
        """Add what fast effects have within cells; return its squares and freedom."""
        begin = self._size + np.cumsum([0, *(len(e.parameters) for e in effects)])
        square, freedom = np.zeros((2, self._folds))
        for within, is_held in self._within:
            fast, columns = within.sums(effects, self._folds)
            if columns:
                own = [*(begin[k] + p for k, p in columns), total.shape[1] - 1]
                fast[:, -1, -1] = 0.0
                if is_held:
                    total[np.ix_(range(self._folds), own, own)] += fast
                else:
                    always[np.ix_(own, own)] += fast.sum(axis=0)
            if is_held:
                square += within.squares(self._folds)
                freedom += within.freedom(self._folds)
        return square, freedom


def _line(seen: Observations, base: Base, fold: int | None) -> Line:
    rows, frame = line_rows(seen, base, ())
    whitener = whiten(seen, base.noise, frame)
    across = base.noise.along_sigma_mm == np.inf and seen.at.line[0] >= 0
    return Line(
        fold,
        seen.at,
        frame,
        whitener,
        *whitener.halves(rows),
        (2.0 if across else 3.0) * len(seen),
    )


def _with_effects(line: Line, effects: Sequence[Effect]) -> Float64[np.ndarray, "q q"]:
    """Return the sums of one line on timing, base, effects and data."""
    base = line.white.T @ line.white
    if len(line.slow):
        base -= line.slow.T @ line.slow
    if not effects:
        return base
    rows = np.concatenate([e.jacobian(line.at) for e in effects], axis=2)
    white, slow = line.whitener.halves(np.matmul(line.frame, rows))
    cross, own = line.white.T @ white, white.T @ white
    if len(slow):
        cross -= line.slow.T @ slow
        own -= slow.T @ slow
    return np.block(
        [
            [base[:-1, :-1], cross[:-1], base[:-1, -1:]],
            [cross[:-1].T, own, cross[-1:].T],
            [base[-1:, :-1], cross[-1:], base[-1:, -1:]],
        ]
    )


def stretches(seen: Observations) -> list[tuple[int, int]]:
    """Return first cell and one past the last of each line or standstill."""
    breaks = (np.diff(seen.at.line) != 0) | (np.diff(seen.row) != 0)
    begin = np.flatnonzero(np.concatenate([[True], breaks]))
    return [
        (int(a), int(b))
        for a, b in zip(begin, np.append(begin[1:], len(seen)), strict=True)
    ]


def line_rows(
    seen: Observations, base: Base, effects: Sequence[Effect]
) -> tuple[Float64[np.ndarray, "n 3 q"], Float64[np.ndarray, "n 3 3"]]:
    """Return rows over timing, machine, poses, effects and data; and the beam frame."""
    more = [e.jacobian(seen.at) for e in (*base.poses, *effects)]
    columns = np.concatenate([base.model.jacobian(seen.at), *more], axis=2)
    local = np.zeros((len(seen), 3, TIMING + columns.shape[2] + 1))
    line = int(seen.at.line[0])
    if line >= 0:
        local[:, :, :TIMING] = TimingLaw((line,)).jacobian(seen.at)
    local[:, :, TIMING:-1] = columns
    local[:, :, -1] = base.pose.inverse().apply(seen.tracker_mm) - seen.at.point_mm
    machine = slice(TIMING, TIMING + base.model.size)
    local[:, :, -1] -= local[:, :, machine] @ base.theta
    frame = beam_frame(seen.tracker_mm) @ base.pose.rotation
    return np.matmul(frame, local), frame


def _timing_out(
    total: Float64[np.ndarray, "t t"],
) -> tuple[Float64[np.ndarray, "q q"], int, float]:
    """Integrate phase and speed out, where the line tells them at all."""
    usual = float(np.max(np.diag(total)[:-1]))
    told = [k for k in range(TIMING) if total[k, k] > _NOTHING * usual]
    sums = total[TIMING:, TIMING:]
    if not told:
        return sums, 0, 0.0
    H = total[np.ix_(told, told)]
    half = total[np.ix_(told, range(TIMING, len(total)))]
    _, log_determinant = np.linalg.slogdet(H)
    return sums - half.T @ np.linalg.solve(H, half), len(told), float(log_determinant)
