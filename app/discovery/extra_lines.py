"""Lines chosen one after another for the questions that they are to decide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.alignment.surroundings import with_surroundings
from app.discovery.scene import Scene
from app.discovery.telling_apart import Question
from app.discovery.view import Base, View
from app.files.run import Run
from app.motion.motion_times import Drive, drive_of
from app.motion.paths import ACCELERATION_MM_S2, DEFAULT_FEED_MM_MIN, check_travel
from app.motion.travel import DECIMALS, inner_travel
from app.planning.planner import with_resting_axes
from app.planning.rehearsal import rehearsed
from drivers.interfaces.records import Path

DECIDED = 12.0  # expected log Bayes factor: few fall short of 5
MOST_LINES = 9
_FEWEST_LINES = 4  # tell the tracker's new place well
_DWELL_S = 0.35
_SLOWER = (1.0, 0.4, 0.15)  # of the highest feed of the Runs
_ANYWHERE = 10  # ends of lines that are drawn at random
_CREEPS = 30.0  # an axis that moves less, mm, stands: it may lose its motion on the way
_SPREAD_MM = 40.0  # of the stops off one line: how they are recognised
ANY_POSE = (1.0, 1e-3)
# The first lines tell nothing where the tracker's place is open: what they will tell
# once it is known leads them.
_NEAR_POSE, _LEADS = (0.02, 2e-5), 0.2


@dataclass(frozen=True)
class _Drafted:
    """Lines so far: stops, feeds towards them, sums of each question, its promise."""

    position: Float64[np.ndarray, "s a"]
    feed_mm_min: Float64[np.ndarray, " s"]
    sums: tuple[Float64[np.ndarray, "q q"], ...]
    expected: tuple[float, ...]
    merit: float = 0.0

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.position) - 1

    @property
    def is_recognised(self) -> bool:
        """Whether its stops tell which is which, and where the tracker stands."""
        if self.lines < _FEWEST_LINES:
            return False
        off = self.position - self.position.mean(axis=0)
        spread = np.linalg.svd(off, compute_uv=False)
        apart = float(np.linalg.norm(self.position[-1] - self.position[0]))
        return float(spread[1]) > _SPREAD_MM and apart > _SPREAD_MM

    @property
    def is_enough(self) -> bool:
        """Whether every question is expected to be decided."""
        return self.is_recognised and min(self.expected) >= DECIDED


@dataclass(frozen=True)
class ExtraLines:
    """Chooses lines for questions about the machine of a scene.

    scene, base : of a Run so far, and where its tracker stands
    feed_mm_min : the highest of the Runs
    """

    scene: Scene
    base: Base
    questions: Sequence[Question]
    feed_mm_min: float
    rng: np.random.Generator

    @cached_property
    def drive(self) -> Drive:
        """How the machine moves."""
        machine, most = self.scene.run.machine, ACCELERATION_MM_S2
        return drive_of(machine, acceleration_mm_s2=most, dwell_s=_DWELL_S)

    def chosen(self) -> tuple[Path, tuple[float, ...]]:
        """Return the lines and the log Bayes factor each question expects of them."""
        low, _ = self._travel()
        nothing = tuple(np.zeros((q.size, q.size)) for q in self.questions)
        draft = _Drafted(
            low[None], np.array([self.feed_mm_min]), nothing, (0.0,) * len(nothing)
        )
        while draft.lines < MOST_LINES and not draft.is_enough:
            draft = self._longer(draft)
        path = self._path(draft.position, draft.feed_mm_min)
        check_travel(self.scene.run.machine, path)
        return path, draft.expected

    def _longer(self, draft: _Drafted) -> _Drafted:
        """Return the draft with the line more that promises most a second."""
        tried = [self._with(draft, end, feed) for end, feed in self._ends(draft)]
        told = [t for t in tried if t.is_recognised or t.lines < _FEWEST_LINES]
        return max(told or tried, key=lambda t: self._worth(draft, t))

    def _worth(self, before: _Drafted, after: _Drafted) -> float:
        begin, end = after.position[-2:]
        feed = after.feed_mm_min[-1:]
        time_s = float(self.drive.times_s(begin[None], end[None], feed)[0])
        return (after.merit - before.merit) / time_s

    def _with(
        self, draft: _Drafted, end: Float64[np.ndarray, " a"], feed: float
    ) -> _Drafted:
        position = np.vstack([draft.position, end])
        feeds = np.append(draft.feed_mm_min, feed)
        view = View(self._expected(self._path(position, feeds)), self.questions[0].base)
        sums = tuple(
            s + q.sums(view) for q, s in zip(self.questions, draft.sums, strict=True)
        )
        pairs = list(zip(self.questions, sums, strict=True))
        expected = tuple(q.log_bayes(s, ANY_POSE) for q, s in pairs)
        leading = [q.log_bayes(s, _NEAR_POSE) for q, s in pairs]
        merit = sum(min(e, DECIDED) for e in expected)
        merit += _LEADS * sum(min(e, DECIDED) for e in leading)
        return _Drafted(position, feeds, sums, expected, merit)

    def _ends(
        self, draft: _Drafted
    ) -> Iterator[tuple[Float64[np.ndarray, " a"], float]]:
        """Yield ends of the next line and feeds: back, along an axis, anywhere."""
        low, high = self._travel()
        here = draft.position[-1]
        share = self.rng.random((_ANYWHERE, len(low)))
        pinned = self.rng.random(share.shape) < 0.5
        share[pinned] = np.rint(share[pinned])
        one = np.eye(len(low))
        inside = low + self.rng.random(len(low)) * (high - low)
        along = [here + one * (place - here) for place in (low, high, inside)]
        ends = np.vstack([low + share * (high - low), draft.position[-2:-1], *along])
        away = np.abs(ends - here) >= _CREEPS
        for end in np.where(away, np.round(ends, DECIMALS), here):
            for slower in _SLOWER:
                feed = round(slower * self.feed_mm_min, 1)
                length = float(self.drive.length(here[None], end[None])[0])
                if length >= self.drive.shortest_mm(feed):
                    yield end, feed

    def _travel(self) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]]:
        """Return the travel of the straight axes less a margin."""
        machine = self.scene.run.machine
        low, high = inner_travel(machine)
        count = len(machine.linear_axes)
        return low[:count], high[:count]

    def _path(
        self, linear: Float64[np.ndarray, "s a"], feed: Float64[np.ndarray, " s"]
    ) -> Path:
        machine = self.scene.run.machine
        position = with_resting_axes(machine, linear)
        name = machine.target().name
        return Path(
            machine.axis_names,
            position,
            feed,
            np.full(len(linear), _DWELL_S),
            (name,) * len(linear) if name else (),
        )

    def _expected(self, path: Path) -> Observations:
        """Return what the last line of a path would give, in its surroundings."""
        pose = self.base.pose
        station_mm = pose.invert().apply(np.zeros((1, 3)))[0]
        seen = rehearsed(self.scene.run.machine, path, station_mm)
        seen = seen.taken(np.flatnonzero(seen.row == len(path) - 1))
        seen = replace(seen, tracker_mm=pose.apply(seen.at.point_mm), pose=pose)
        return with_surroundings(seen, path, None, self.questions[0].base.runs - 1)


def highest_feed_mm_min(runs: Sequence[Run]) -> float:
    """Return the highest feed that the Runs have driven."""
    feeds = [r.commanded.feed_mm_min for r in runs if isinstance(r.commanded, Path)]
    if not feeds:
        return DEFAULT_FEED_MM_MIN
    return max(float(feed[1:].max()) for feed in feeds)
