"""The shortest lines that decide between competing hypotheses about a machine.

Each hypothesis is a Gaussian over the machine's parameters, mean + root z with z
standard normal. Data y of the lines have the log Bayes factor log p(y | a) − log p(y |
b); its expectation under a is the divergence of both predictions and never below 0
(Kullback & Leibler 1951). The tracker's next pose and the timing of each line are
integrated out, as in the decision.

Lines are chosen one after another, each from the end of the last one, by the expected
gain of the log Bayes factor per second (Box & Hill 1967): back, along an axis or
across, at the feeds of the Runs and slower ones. They end when every question is
expected to be decided.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.discovery.line_blocks import PlacedLine, RunData, build_line
from truepath.estimation.problem.design_matrix import Linearisation
from truepath.estimation.problem.prior import diagonal_precision
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.machine.machine import Machine, remove_rotary_axes
from truepath.motion.motion_times import Drive, Legs, Stops, travel_time_s
from truepath.motion.workspace import (
    DECIMALS,
    add_resting_axes,
    check_travel,
    inner_travel,
)
from truepath.planning.simulated_cells import predict_cells
from truepath_drivers.interfaces.records import Path

DECIDED = 12.0  # expected log Bayes factor: few fall short of 5
MOST_LINES = 9
_FEWEST_LINES = 4  # determine the tracker's new pose well
_DWELL_S = 0.35
_SLOWER = (1.0, 0.4, 0.15)  # of the highest feed of the Runs
_RANDOM_ENDS = 10
_LEAST_MOTION = 30.0  # mm; less may be lost on the way, so the axis rests instead
_SPREAD_MM = 40.0  # of the stops off one line: how they are recognised
_UNKNOWN_POSE = {"mm": 1.0, "rad": 1e-3}
# The first lines decide nothing while the tracker's pose is unknown. What they will
# decide once it is known guides their choice.
_KNOWN_POSE, _GUIDANCE = {"mm": 0.02, "rad": 2e-5}, 0.2
_POSE = TrackerPose((0.0, 0.0, 0.0)).parameters
POSE = len(_POSE)

_Columns = tuple[Int64[np.ndarray, " k"], int]
"""Columns of root and mean of a hypothesis in the normal equations."""


@dataclass(frozen=True)
class Question:
    """Two hypotheses about the machine, between which lines are to decide.

    left, right : in words, the right one empty where the question is whether or not
    ranks : number of columns of the root of each hypothesis
    measure : gives the normal equations of lines of the next Run, their timing
        integrated out; columns are both roots, both means, the tracker's pose
    """

    left: str
    right: str
    ranks: tuple[int, int]
    measure: Callable[[Sequence[PlacedLine]], Float64[np.ndarray, "q q"]]

    @property
    def size(self) -> int:
        return sum(self.ranks) + 2 + POSE

    def expect_log_bayes(
        self, normal: Float64[np.ndarray, "q q"], pose_sigma: Mapping[str, float]
    ) -> float:
        """Expected log Bayes factor for the truth that is harder to confirm.

        normal : normal equations of lines; pose_sigma : standard uncertainty of the
            tracker's next pose, mm and rad
        """
        known = diagonal_precision(_POSE, pose_sigma)
        begin = len(normal) - POSE
        cross = normal[begin:, :begin]
        absorbed = np.linalg.solve(normal[begin:, begin:] + known, cross)
        rest = normal[:begin, :begin] - cross.T @ absorbed
        middle = self.ranks[0]
        one = np.arange(middle), begin - 2
        other = np.arange(middle, begin - 2), begin - 1
        return min(_divergence(rest, one, other), _divergence(rest, other, one))


@dataclass(frozen=True)
class DiscriminationDesign:
    """Lines to measure, and the questions that they are to decide.

    expected : log Bayes factor expected for each question
    """

    questions: tuple[Question, ...]
    path: Path
    expected: tuple[float, ...]

    @property
    def lines(self) -> int:
        """One less than the rows of the path."""
        return len(self.path) - 1

    @property
    def duration_s(self) -> float:
        return travel_time_s(self.path)

    @property
    def decides(self) -> bool:
        return min(self.expected) >= DECIDED


@dataclass(frozen=True)
class _Draft:
    """Lines so far.

    normal : normal equations of each question; merit : objective of the choice
    """

    stops: Stops
    normal: tuple[Float64[np.ndarray, "q q"], ...]
    expected: tuple[float, ...]
    merit: float = 0.0

    @property
    def lines(self) -> int:
        return len(self.stops) - 1

    @property
    def is_recognisable(self) -> bool:
        if self.lines < _FEWEST_LINES:
            return False
        position = self.stops.position
        spread = np.linalg.svd(position - position.mean(axis=0), compute_uv=False)
        apart = float(np.linalg.norm(position[-1] - position[0]))
        return float(spread[1]) > _SPREAD_MM and apart > _SPREAD_MM

    @property
    def is_enough(self) -> bool:
        return self.is_recognisable and min(self.expected) >= DECIDED


@dataclass(frozen=True)
class LineChoice:
    """Chooses lines for questions about a machine.

    base : machine and poses, the last one that of the Run that the lines will be
    feed_mm_min : the highest of the Runs so far
    """

    machine: Machine
    base: Linearisation
    questions: Sequence[Question]
    feed_mm_min: float
    rng: np.random.Generator

    @property
    def drive(self) -> Drive:
        """Motion limits of the machine, with the dwell of this design."""
        return Drive.of_machine(self.machine, _DWELL_S)

    def choose(self) -> DiscriminationDesign:
        """At most nine lines, from the lower end of the travel. Checks the travel."""
        low, _ = inner_travel(remove_rotary_axes(self.machine))
        nothing = tuple(np.zeros((q.size, q.size)) for q in self.questions)
        first = Stops(low[None], np.array([self.feed_mm_min]))
        draft = _Draft(first, nothing, (0.0,) * len(nothing))
        while draft.lines < MOST_LINES and not draft.is_enough:
            draft = self._extend(draft)
        path = self._path(draft.stops)
        check_travel(self.machine, path)
        return DiscriminationDesign(tuple(self.questions), path, draft.expected)

    def _extend(self, draft: _Draft) -> _Draft:
        drafts = [self._add_line(draft, end, feed) for end, feed in self._ends(draft)]
        usable = [d for d in drafts if d.is_recognisable or d.lines < _FEWEST_LINES]
        return max(usable or drafts, key=lambda d: self._merit_per_s(draft, d))

    def _merit_per_s(self, before: _Draft, after: _Draft) -> float:
        line = after.stops.select(slice(-2, None)).legs
        return (after.merit - before.merit) / float(self.drive.times_s(line)[0])

    def _add_line(
        self, draft: _Draft, end: Float64[np.ndarray, " a"], feed: float
    ) -> _Draft:
        stops = draft.stops.append(end, feed)
        seen = self._predict_last_line(self._path(stops))
        data, number = RunData(seen, self.base), self.base.runs - 1
        line = [build_line(data, number, *cells) for cells in seen.lines]
        normal = tuple(
            s + q.measure(line)
            for q, s in zip(self.questions, draft.normal, strict=True)
        )
        expected = self._expect(normal, _UNKNOWN_POSE)
        guidance = self._expect(normal, _KNOWN_POSE)
        merit = sum(min(e, DECIDED) for e in expected)
        merit += _GUIDANCE * sum(min(e, DECIDED) for e in guidance)
        return _Draft(stops, normal, expected, merit)

    def _expect(
        self,
        normal: Sequence[Float64[np.ndarray, "q q"]],
        pose_sigma: Mapping[str, float],
    ) -> tuple[float, ...]:
        pairs = zip(self.questions, normal, strict=True)
        return tuple(q.expect_log_bayes(s, pose_sigma) for q, s in pairs)

    def _ends(self, draft: _Draft) -> Iterator[tuple[Float64[np.ndarray, " a"], float]]:
        low, high = inner_travel(remove_rotary_axes(self.machine))
        position = draft.stops.position
        here = position[-1]
        share = self.rng.random((_RANDOM_ENDS, len(low)))
        pinned = self.rng.random(share.shape) < 0.5
        share[pinned] = np.rint(share[pinned])
        one = np.eye(len(low))
        inside = low + self.rng.random(len(low)) * (high - low)
        along = [here + one * (place - here) for place in (low, high, inside)]
        ends = np.vstack([low + share * (high - low), position[-2:-1], *along])
        away = np.abs(ends - here) >= _LEAST_MOTION
        for end in np.where(away, np.round(ends, DECIMALS), here):
            for slower in _SLOWER:
                feed = round(slower * self.feed_mm_min, 1)
                line = Legs(here[None], end[None], np.array([feed]))
                if self.drive.length(line)[0] >= self.drive.shortest_mm(feed):
                    yield end, feed

    def _path(self, stops: Stops) -> Path:
        machine, count = self.machine, len(stops)
        name = machine.target().name
        return Path(
            machine.axis_names,
            add_resting_axes(machine, stops.position),
            stops.feed_mm_min,
            np.full(count, _DWELL_S),
            (name,) * count if name else (),
        )

    def _predict_last_line(self, path: Path) -> Observations:
        pose = self.base.pose
        station_mm = pose.invert().apply(np.zeros((1, 3)))[0]
        seen = predict_cells(self.machine, path, station_mm)
        seen = seen.select(np.flatnonzero(seen.row == len(path) - 1))
        seen = replace(seen, tracker_mm=pose.apply(seen.at.point_mm), pose=pose)
        return add_surroundings(seen, path, None, self.base.runs - 1)


def _divergence(
    normal: Float64[np.ndarray, "q q"], truth: _Columns, other: _Columns
) -> float:
    """E[log p(y | truth) − log p(y | other)] under the truth."""
    own, others = (_expect_log(normal, truth, model) for model in (truth, other))
    return own - others


def _expect_log(
    normal: Float64[np.ndarray, "q q"], truth: _Columns, model: _Columns
) -> float:
    """E[log p(y | model)] under the truth, up to a constant of all models.

    With y less the model's mean d + n, and its root's information S, log p = −½ |y −
    mean|² + ½ rᵀ (I + S)⁻¹ r − ½ log det (I + S).
    """
    (z, mean), (w, own) = truth, model
    off = normal[mean, mean] - 2.0 * normal[mean, own] + normal[own, own]
    misfit = float(off) + float(np.trace(normal[np.ix_(z, z)]))
    S = normal[np.ix_(w, w)]
    r = normal[w, mean] - normal[w, own]
    shared = normal[np.ix_(w, z)]
    spread = np.outer(r, r) + shared @ shared.T + S
    one = np.eye(len(S)) + S
    _, log_determinant = np.linalg.slogdet(one)
    fitted = float(np.trace(np.linalg.solve(one, spread)))
    return -0.5 * misfit + 0.5 * fitted - 0.5 * float(log_determinant)
