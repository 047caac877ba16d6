"""Changes detected during a measurement, named where one explanation is clear.

Each kind of change has a course over the lines: a step from one line on, a growth with
time, a shift of one line. The gain of a fit by it is a score test (`score`) that allows
for the uncertainty of the machine: while few lines have determined its errors, these
can explain a change as well, and it is not detected yet. The likelihood ratio over all
moments is that of Willsky and Jones (1976). Changes are selected one after the other,
each conditional on those before it, which may have occurred slightly earlier or later.
The sums of each line are kept separate: with them, any course over the lines is tested
without returning to the cells.

A change is noticed as soon as it exceeds what chance rarely produces. It is named where
every other kind explains it clearly worse; else only its start is known. Lines that
follow may name it, rename it, or show that it is over. A notice is never withdrawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.score import (
    STEP_MARGIN,
    ScoredColumns,
    compute_limit,
    compute_score,
)
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.noise import assume_typical_noise
from truepath.kinematics.effects.backlash import make_half_width
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.machine.machine import Machine
from truepath.numerics.scaled_cholesky import ScaledCholesky

_POSE = 6
_M_PER_MM = 1e-3


@dataclass(frozen=True, slots=True)
class WatchedColumns:
    """What may change: pose of the set-up, growth and lost motion of axes.

    Order of the columns: six of the pose, one in mm/m a linear axis, half the lost
    motion of each axis, the range offset.
    """

    machine: Machine

    @property
    def pose(self) -> slice:
        return slice(0, _POSE)

    @property
    def growth(self) -> slice:
        """One column for each linear axis, mm/m."""
        return slice(_POSE, _POSE + len(self.machine.linear_axes))

    def lost_motion(self, axis: int) -> slice:
        """Column of one axis, by its number; half the width, mm."""
        begin = self.growth.stop + axis
        return slice(begin, begin + 1)

    @property
    def range(self) -> slice:
        begin = self.lost_motion(len(self.machine.axes)).start
        return slice(begin, begin + 1)

    def build_extra(self, design: DesignMatrix) -> Float64[np.ndarray, "n 3 e"]:
        at = design.observations.at
        columns = [
            compute_arm(f"E{axis.name}{axis.name}", at)
            * (at.axis_mm(axis.name) - 0.5 * (axis.low + axis.high))[:, None]
            * _M_PER_MM
            for axis in self.machine.linear_axes
        ]
        columns += [
            make_half_width(f"E{axis.name}{axis.name}", axis).jacobian(at)[:, :, 0]
            for axis in self.machine.axes
        ]
        along = np.tile(np.eye(3)[:, :1], (len(at), 1, 1))  # of the beam
        turned = design.frame @ np.stack(columns, axis=2)
        return np.concatenate([turned, along], axis=2)


@dataclass(frozen=True)
class WatchSums:
    """Sums of single lines, and of all that a fit of them needs.

    row, time_s : of each line, its middle on the tracker's clock; cells : number in
        each
    lock : number of beam losses before each
    coupling : of the watched columns with those of the fit; own : with each other
    pulled : with measured minus nominal; gram : of the unweighted columns
    data : on machine and pose; freedom : of its squares, parameters of the fit not
        deducted
    """

    about: Linearisation
    columns: WatchedColumns
    row: tuple[int, ...]
    time_s: Float64[np.ndarray, " l"]
    cells: Float64[np.ndarray, " l"]
    lock: Int64[np.ndarray, " l"]
    coupling: Float64[np.ndarray, "l p c"]
    own: Float64[np.ndarray, "l c c"]
    pulled: Float64[np.ndarray, "l c"]
    gram: Float64[np.ndarray, "l c c"]
    data: Information
    freedom: float

    @staticmethod
    def start(about: Linearisation, seen: Sequence[Observations] = ()) -> WatchSums:
        """Sums of the first lines.

        Slow noise is at least at its typical level: single lines do not determine it.
        """
        columns, p = WatchedColumns(about.machine_model.machine), about.size
        c = columns.range.stop
        empty = WatchSums(
            replace(about, noise=assume_typical_noise(about.noise)),
            columns,
            (),
            np.zeros(0),
            np.zeros(0),
            np.zeros(0, np.int64),
            np.zeros((0, p, c)),
            np.zeros((0, c, c)),
            np.zeros((0, c)),
            np.zeros((0, c, c)),
            Information.nothing(p),
            0.0,
        )
        return empty.add(seen)

    def add(self, seen: Sequence[Observations]) -> WatchSums:
        """Sums with further lines or standstills.

        A line on which the beam was lost counts as two.
        """
        lines = [
            self._sum_line(each.select(np.arange(first, last)))
            for each in seen
            for first, last in _cut_at_locks(each)
            if last > first
        ]
        return self if not lines else _join([self, *lines])

    def _sum_line(self, line: Observations) -> WatchSums:
        about, p = self.about, self.about.size
        design = about.build(line)
        extra = self.columns.build_extra(design)
        watched = np.concatenate([design.columns[:, :, p - _POSE :], extra], axis=2)
        fit = np.concatenate([design.rows[:, :, : p + 1], extra], axis=2)
        weighted = design.weigh(design.whiten(about.noise), fit)
        rows = len(line) * 3
        fit, flat = fit.reshape(rows, -1), watched.reshape(rows, -1)
        total = fit[:, : p + 1].T @ weighted.reshape(rows, -1)[:, : p + 1]
        heavy = weighted.reshape(rows, -1)[
            :, np.r_[p - _POSE : p, p + 1 : fit.shape[1]]
        ]
        freedom = 3.0 * len(line) - design.timing.shape[2]
        lock = line.at.recorded and line.at.recorded.lock
        return replace(
            self,
            row=(int(line.row[0]),),
            time_s=np.array([0.5 * (line.at.time_s[0] + line.at.time_s[-1])]),
            cells=np.array([float(len(line))]),
            lock=np.zeros(1, np.int64) if lock is None else lock[-1:],
            coupling=(fit[:, :p].T @ heavy)[None],
            own=(flat.T @ heavy)[None],
            pulled=(fit[:, p] @ heavy)[None],
            gram=(flat.T @ flat)[None],
            data=Information.from_total(total, 0.0),
            freedom=freedom - about.count_untimed(line),
        )


def _cut_at_locks(seen: Observations) -> Iterator[tuple[int, int]]:
    ends = np.union1d([last for _, last in seen.lines], seen.new_locks)
    return pairwise([0, *ends.astype(np.int64).tolist()])


def _join(parts: Sequence[WatchSums]) -> WatchSums:
    first = parts[0]

    def stack(name: str) -> Float64[np.ndarray, "l ..."]:
        return np.concatenate([getattr(part, name) for part in parts])

    return replace(
        first,
        row=tuple(row for part in parts for row in part.row),
        time_s=stack("time_s"),
        cells=stack("cells"),
        lock=stack("lock"),
        coupling=stack("coupling"),
        own=stack("own"),
        pulled=stack("pulled"),
        gram=stack("gram"),
        data=add_information([part.data for part in parts]),
        freedom=sum(part.freedom for part in parts),
    )


KNOCK, LINE, DRIFT, GROWTH = "set-up-moved", "line-off", "set-up-drifts", "axes-grow"
LOST_MOTION, RANGE = "lost-motion-changed", "range-offset-changed"
LASTING = (DRIFT, GROWTH)
_MOST = 3  # changes that are distinguished
_OF_LARGEST = 0.03  # of its gain: a smaller change may be its effect, and waits
_NEAR = 3  # lines and standstills: changes as near as that are one
_NEWEST, _OLDER = 60, 60  # lines tested as the start of a change: all, and some
_DRIFT_ONSETS = 4
_SETTLES = 3.0  # times that a drift which settles falls by e
_UNSEEN_OFFSET = 1e-8  # of its information: rounding
_FEW = 2  # lines before a change or after it


@dataclass(frozen=True)
class Course:
    """Changes of one kind, starting at several moments.

    axis : empty unless the kind concerns one axis
    columns : among the watched columns
    onset : first line of each change; factor : (m, l), weight of each line
    """

    kind: str
    axis: str
    columns: slice
    onset: tuple[int, ...]
    factor: Float64[np.ndarray, "m l"]

    def __getitem__(self, part: slice) -> Course:
        return replace(self, onset=self.onset[part], factor=self.factor[part])


@dataclass(frozen=True)
class Trial(ScoredColumns):
    """Courses conditional on a fit and on changes that are given."""

    course: Course

    @cached_property
    def score(self) -> tuple[Float64[np.ndarray, "l k k"], Float64[np.ndarray, "l k"]]:
        """A new range offset is nearly determined by the specification."""
        if self.course.kind != RANGE:
            return super().score
        return compute_score(self.left, self.raw, self.pulled, _UNSEEN_OFFSET)

    def leave_out(self, onset: int) -> Trial:
        """Ignores starts within 3 lines of a change found; lasting kinds stay."""
        near = np.abs(np.array(self.course.onset) - onset) <= _NEAR
        if self.course.kind in LASTING:
            return self
        return replace(self, pulled=np.where(near[:, None], 0.0, self.pulled))


@dataclass(frozen=True, slots=True)
class Change:
    """One change that the data support.

    kind, axis : of the best explanation; onset : number of its first line
    gain : of the fit, χ²; limit : rarely exceeded by chance
    margin : lead over the next best kind, each less its limit
    size_mm : root mean square over the lines since, at its largest; sigma_mm : its
        standard uncertainty
    """

    kind: str
    axis: str
    onset: int
    gain: float
    limit: float
    margin: float
    size_mm: float
    sigma_mm: float


class ChangeSearch:
    """Searches sums of lines for changes, given the current knowledge.

    known : information on machine and pose from other sources than these lines
    before : first lines of the changes found previously
    """

    def __init__(
        self, sums: WatchSums, known: Information, before: Sequence[int] = ()
    ) -> None:
        self._sums = sums
        self._before = np.array(before, np.int64)
        self._factor = ScaledCholesky.of(sums.data.matrix + known.matrix)
        vector = sums.data.vector + known.vector
        self._theta = self._factor.solve(vector)
        self._square = sums.data.square + known.square - float(vector @ self._theta)
        self._rest = sums.pulled - np.einsum("lpc,p->lc", sums.coupling, self._theta)

    def find(self) -> list[Change]:
        """At most three changes, the one with the largest gain first."""
        trials = [self._prepare(course) for course in self._list_courses()]
        found: list[Change] = []
        explained = largest = 0.0
        while trials and len(found) < _MOST:
            which, k, change = self._find_best(trials, explained)
            largest = max(largest, change.gain)
            if change.gain < max(change.limit, _OF_LARGEST * largest):
                break
            found.append(change)
            for number in (k, k - 1, k + 1):  # its true start is between
                if 0 <= number < len(trials[which].course.onset):
                    given = trials[which].select_one(number)
                    explained += float(given.gain[0])
                    trials = [self._condition_on(given, each) for each in trials]
            near = change.onset if change.kind not in LASTING else -_NEAR - 1
            trials = [each.leave_out(near) for each in trials]
        return found

    def _list_courses(self) -> list[Course]:
        sums, lines = self._sums, len(self._sums.row)
        if lines <= _FEW:
            return []
        columns, machine = sums.columns, sums.columns.machine
        onset = self._choose_onsets(lines)
        number = np.arange(lines)
        step = (number >= onset[:, None]).astype(np.float64)
        time_s = sums.time_s - sums.time_s[0]
        began = np.unique(np.linspace(0, lines - _FEW - 1, _DRIFT_ONSETS).astype(int))
        since_s = np.maximum(time_s - time_s[began][:, None], 0.0)
        share = since_s / since_s.max(axis=1, keepdims=True)
        settled = -np.expm1(-_SETTLES * share) / -np.expm1(-_SETTLES)
        grown = np.concatenate([share, settled])
        whole = slice(columns.pose.start, columns.growth.stop)
        begins = tuple(began.tolist()) * 2
        one = (number == onset[:, None]).astype(np.float64)
        steps = tuple(onset.tolist())
        return [
            Course(KNOCK, "", columns.pose, steps, step),
            Course(LINE, "", slice(0, 3), steps, one),
            Course(DRIFT, "", columns.pose, begins, grown),
            Course(GROWTH, "", whole, begins, grown),
            *(
                Course(LOST_MOTION, axis.name, columns.lost_motion(k), steps, step)
                for k, axis in enumerate(machine.axes)
            ),
            *self._list_new_offsets(),
        ]

    def _list_new_offsets(self) -> Iterator[Course]:
        onset = 1 + np.flatnonzero(np.diff(self._sums.lock))
        if len(onset):
            step = (np.arange(len(self._sums.row)) >= onset[:, None]).astype(np.float64)
            column = self._sums.columns.range
            yield Course(RANGE, "", column, tuple(onset.tolist()), step)

    def _choose_onsets(self, lines: int) -> Int64[np.ndarray, " m"]:
        """Never the first line: all recent ones, a selection of older ones."""
        first_of_newest = max(1, lines - _NEWEST)
        older = np.linspace(1, first_of_newest, _OLDER).round().astype(np.int64)
        stride = 1 + first_of_newest // _OLDER
        near = np.add.outer(self._before, np.arange(-stride, stride + 1)).ravel()
        newest = np.arange(first_of_newest, lines)
        onset = np.unique(np.concatenate([older, near, newest]))
        return onset[(onset >= 1) & (onset < lines)]

    def _prepare(self, course: Course) -> Trial:
        sums, own, factor = self._sums, course.columns, course.factor
        coupling = np.tensordot(factor, sums.coupling[:, :, own], axes=1)
        m, p, k = coupling.shape
        half = self._factor.solve_half(coupling.transpose(1, 0, 2).reshape(p, m * k))
        half = half.reshape(p, m, k).transpose(1, 0, 2)
        raw = np.tensordot(factor**2, sums.own[:, own, own], axes=1)
        left = raw - np.swapaxes(half, 1, 2) @ half
        return Trial(half, raw, left, factor @ self._rest[:, own], course)

    def _condition_on(self, given: Trial, trial: Trial) -> Trial:
        factor = given.course.factor * trial.course.factor
        shared = self._sums.own[:, given.course.columns, trial.course.columns]
        return trial.condition_on(given, np.tensordot(factor, shared, axes=1))

    def _find_best(
        self, trials: Sequence[Trial], explained: float
    ) -> tuple[int, int, Change]:
        excess: list[float] = []
        best: list[int] = []
        for trial in trials:
            gain = trial.gain
            best.append(int(np.argmax(gain)))
            excess.append(float(gain.max()) - self._limit(trial))
        first = int(np.argmax(excess))
        kind = trials[first].course.kind
        # A drift is growth of size 0: it holds where growth of the axes is not needed.
        rival = max(
            value
            for k, (value, trial) in enumerate(zip(excess, trials, strict=True))
            if k != first and (kind, trial.course.kind) != (DRIFT, GROWTH)
        )
        chosen = trials[first].select_one(best[first])
        gain = float(chosen.gain[0])
        rest = (self._square - explained - gain) / max(self._sums.freedom, 1.0)
        scale = max(1.0, rest)
        size_mm, sigma_mm = self._measure(chosen)
        course = chosen.course
        change = Change(
            course.kind,
            course.axis,
            course.onset[0],
            gain / scale,
            STEP_MARGIN * self._limit(chosen),
            (excess[first] - rival) / scale,
            size_mm,
            sigma_mm,
        )
        return first, best[first], change

    def _limit(self, trial: Trial) -> float:
        """Growth includes a drift, so it pays for the columns of both."""
        columns, drift = trial.pulled.shape[1], self._sums.columns.growth.start
        parts = [columns]
        if trial.course.kind == GROWTH:
            parts = [drift, columns - drift]
        return sum(compute_limit(each, len(self._sums.row)) for each in parts)

    def _measure(self, chosen: Trial) -> tuple[float, float]:
        course, sums = chosen.course, self._sums
        root, value = chosen.score[0][0], chosen.value[0]
        moved = course.factor[0] > 0.0
        gram = sums.gram[moved][:, course.columns, course.columns].sum(axis=0)
        gram = gram / sums.cells[moved].sum()
        size_mm = float(np.sqrt(value @ gram @ value))
        slope = root.T @ gram @ value / max(size_mm, 1e-12)
        ways = 2.0 if course.kind == LOST_MOTION else 1.0  # half the width to each side
        return ways * size_mm, ways * float(np.linalg.norm(slope))


UNNAMED = "something-changed"
_LIKELY, _CERTAIN = 8.0, 20.0  # by how much the next kind explains less
_FEWEST, _FEWEST_POINTS = 8, 24  # enough to determine machine and noise
_NEAR_ROWS = 2  # rows: changes as near as that are one


@dataclass(frozen=True, slots=True)
class Notice:
    """One change that was detected during a measurement.

    number : 1, 2, … of the measurement
    kind : of the change, `something-changed` if unnamed; axis : empty unless it
        concerns one
    grade : `certain`, `likely` or `possible`, as in discovery
    since_row : first line or point that shows it; noticed_row : the last one finished
        when it was noticed; noticed_s : when, on the tracker's clock
    size_mm : displacement of the measured points; sigma_mm : its standard uncertainty
    is_over : the newest lines no longer show it
    """

    number: int
    kind: str
    axis: str
    grade: str
    since_row: int
    noticed_row: int
    noticed_s: float
    size_mm: float
    sigma_mm: float
    is_over: bool = False


class ChangeWatch:
    """Monitors the lines (or points) of one measurement for changes."""

    def __init__(self, *, has_lines: bool) -> None:
        self._fewest = _FEWEST if has_lines else _FEWEST_POINTS
        self._sums: WatchSums | None = None
        self._notices: tuple[Notice, ...] = ()

    def start_again(self, about: Linearisation, seen: Sequence[Observations]) -> None:
        """Rebuild the sums from all lines so far, linearised about a new solution."""
        self._sums = WatchSums.start(about, seen)

    def add(self, line: Observations) -> None:
        """Next line or standstill, before any exclusion of cells."""
        if self._sums is not None:
            self._sums = self._sums.add([line])

    def list_notices(self, known: Information, time_s: float) -> tuple[Notice, ...]:
        """All notices so far, by number.

        known : information on machine and pose from other sources than the lines;
            time_s : now
        """
        sums = self._sums
        if sums is None or len(set(sums.row)) < self._fewest:
            return self._notices
        rows = {each.since_row for each in self._notices}
        before = [k for k, row in enumerate(sums.row) if row in rows]
        found = ChangeSearch(sums, known, before).find()
        self._notices = revise(self._notices, found, sums.row, time_s)
        return self._notices


def revise(
    before: Sequence[Notice], found: Sequence[Change], row: Sequence[int], time_s: float
) -> tuple[Notice, ...]:
    """Notices updated with the changes of another search.

    row : of each line so far
    """
    notices = {each.number: replace(each, is_over=True) for each in before}
    known: set[int] = set()
    new_notices = [_describe(change, len(before) + 1, row, time_s) for change in found]
    # An unnamed change may turn out to have begun elsewhere.
    vague = [
        n
        for n in before
        if n.kind == UNNAMED
        and not n.is_over
        and not any(_is_same(n, t) for t in new_notices)
    ]
    for new in new_notices:
        like = [n for n in before if _is_same(n, new)] + vague
        same = next((n for n in like if n.number not in known), None)
        number = len(notices) + 1
        if same is not None:
            number = same.number
            new = replace(new, noticed_row=same.noticed_row, noticed_s=same.noticed_s)
        known.add(number)
        notices[number] = replace(new, number=number)
    return tuple(notices[number] for number in sorted(notices))


def _describe(change: Change, number: int, row: Sequence[int], time_s: float) -> Notice:
    """A change on the newest line only stays unnamed: a shift of this line and one of
    all that follows are indistinguishable.
    """
    is_named = change.margin >= _LIKELY and row[change.onset] != row[-1]
    grade = "certain" if change.margin >= _CERTAIN else "likely"
    return Notice(
        number,
        change.kind if is_named else UNNAMED,
        change.axis if is_named else "",
        grade if is_named else "possible",
        row[change.onset],
        row[-1],
        time_s,
        change.size_mm,
        change.sigma_mm,
    )


def _is_same(old: Notice, new: Notice) -> bool:
    if old.kind == new.kind and old.kind in LASTING:
        return True
    return abs(old.since_row - new.since_row) <= _NEAR_ROWS
