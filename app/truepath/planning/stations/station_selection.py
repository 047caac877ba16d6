"""Choice of the tracker's station, and whether further stations are worth their time.

The station is the one of many with the least uncertainty after the same measuring time:
the part that time averages and, together with it, the part of the tracker's own errors
in the map. Further stations share that time and cost a move each; they are compared
with the single station that measures for the total time. On lines through the volume
one station sees every point under many directions already, so that more stations pay
where one does not see enough, where the tracker's own errors dominate, or where one
leaves a motion weak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, Configurations
from truepath.motion.workspace import (
    DECIMALS,
    StationAreas,
    Workspace,
    add_resting_axes,
    inner_travel,
    moving_targets,
)
from truepath.planning.stations.station_information import (
    StationEvaluator,
    StationInformation,
    StationVariance,
)

_PLACES = 64  # evaluated first; those of the climb come in addition
_WIDER = 1.2  # than the areas: so much of it comes to lie on their borders
_CLIMBERS, _HALVINGS = 2, 3
MOST_STATIONS = 3
_WORTH = 0.9  # of the sigma of one station, or below: further stations pay
APART_MM = 300.0  # of stations: nearer ones see much the same
_UNSEEN = 0.02  # share of the travel that is worth a station


@dataclass(frozen=True)
class StationOption:
    """A number of stations, and their predicted variance.

    stay : variance of the first alone that measures for their total time, moves
        included; both are of like time
    weakest : error motion that gains most
    """

    place_mm: Float64[np.ndarray, "n 3"]
    total_s: float
    left: StationVariance
    stay: StationVariance
    weakest: str

    @property
    def ratio(self) -> float:
        """Their sigma over that of staying."""
        return self.left.sigma_mm / self.stay.sigma_mm

    @property
    def pays(self) -> bool:
        """True if they give at least a tenth less than staying does."""
        return self.ratio < _WORTH

    @property
    def reason(self) -> str:
        """Why they pay: `sight`, `systematic` or the error motion that gains most."""
        if self.left.seen > self.stay.seen + _UNSEEN:
            return "sight"
        random = self.stay.random_mm**2 - self.left.random_mm**2
        systematic = self.stay.systematic_mm**2 - self.left.systematic_mm**2
        return "systematic" if systematic > random else self.weakest


@dataclass(frozen=True)
class StationAdvice:
    """Advice on the tracker's station with a plan.

    options : one, two, three stations
    chosen : True if the station was not given; judged : number of stations evaluated
    best_mm : the best of them; best, worst : variance of the best and the worst
    move_s : time of a move to another station
    """

    options: tuple[StationOption, ...]
    chosen: bool
    judged: int
    best_mm: Float64[np.ndarray, "3"]
    best: StationVariance
    worst: StationVariance
    move_s: float

    @property
    def recommended(self) -> StationOption:
        """The number of stations with the least variance for its time."""
        paying = [option for option in self.options if option.pays]
        return min(paying, key=lambda option: option.ratio, default=self.options[0])


@dataclass(frozen=True)
class StationChoice:
    """Evaluated stations, the best first.

    stated : the given station; it is kept, whatever others would give
    time_s : of measuring, for which stations were evaluated
    """

    evaluator: StationEvaluator
    judged: tuple[StationInformation, ...]
    stated: StationInformation | None
    move_s: float
    time_s: float

    @property
    def first(self) -> StationInformation:
        """The given station, else the best."""
        return self.stated or self.judged[0]

    def choose_stations(self, count: int) -> list[StationInformation]:
        """Stations as many as `count`, `first` at the head.

        Raises PlanningError if the areas do not have as many with enough distance.
        """
        chosen = [self.first]
        while len(chosen) < count:
            chosen = self._add(chosen)
        return chosen

    def compare(self, count: int, time_s: float, random_mm: float) -> float:
        """Ratio of a plan's uncertainty to the survey's for the same time.

        count : of its stations; random_mm : the part that time averages, by its
            forecast
        """
        same = self.evaluator.evaluate(self.choose_stations(count), time_s)
        return random_mm / same.random_mm

    def advise(self, time_s: float, scale: float) -> StationAdvice:
        """Options for a total measuring time.

        scale : correction of the survey's uncertainty
        """

        def predict_residual(
            stations: Sequence[StationInformation], seconds: float
        ) -> StationVariance:
            return self.evaluator.evaluate(stations, seconds).scale_random(scale)

        chosen, options = [self.first], list[StationOption]()
        for count in range(1, MOST_STATIONS + 1):
            if count > 1 and not self._list_apart(chosen):
                break
            if count > 1:
                chosen = self._add(chosen)
            total_s = time_s + (count - 1) * self.move_s
            several = predict_residual(chosen, time_s)
            one = predict_residual([self.first], total_s)
            before, after = map(self.evaluator.motion_sigmas_mm, (one, several))
            gain = {name: before[name] ** 2 - after[name] ** 2 for name in before}
            weakest = max(gain, key=lambda name: gain[name])
            place_mm = np.stack([one.place_mm for one in chosen])
            options.append(StationOption(place_mm, total_s, several, one, weakest))
        best, worst = self.judged[0], self.judged[-1]
        return StationAdvice(
            tuple(options),
            self.stated is None,
            len(self.judged),
            best.place_mm,
            predict_residual([best], time_s),
            predict_residual([worst], time_s),
            self.move_s,
        )

    def _add(self, chosen: Sequence[StationInformation]) -> list[StationInformation]:
        """One station more; the first stays, the others may move."""
        found = [*chosen, self._find_best(chosen)]
        for k in range(1, len(found)):
            found[k] = self._find_best([*found[:k], *found[k + 1 :]])
        return found

    def _find_best(self, others: Sequence[StationInformation]) -> StationInformation:
        def predict_residual_mm(one: StationInformation) -> float:
            return self.evaluator.evaluate([*others, one], self.time_s).sigma_mm

        free = self._list_apart(others)
        if not free:
            raise PlanningError(
                f"the tracker's areas have no {len(others) + 1} places that are "
                f"{APART_MM:g} mm apart; widen them, or plan fewer stations"
            )
        return min(free, key=predict_residual_mm)

    def _list_apart(
        self, others: Sequence[StationInformation]
    ) -> list[StationInformation]:
        taken = np.stack([one.place_mm for one in others])
        return [
            one
            for one in self.judged
            if np.linalg.norm(taken - one.place_mm, axis=1).min() >= APART_MM
        ]


def choose_best_station(
    evaluator: StationEvaluator,
    areas: StationAreas,
    time_s: float,
    stated_mm: Float64[np.ndarray, "3"] | None = None,
) -> StationChoice:
    """Evaluate stations in the areas for a measuring time.

    stated_mm : station of the tracker, if given
    Raises PlanningError if nothing could be measured from any station.
    """
    search = _StationSearch(evaluator, areas, time_s)
    first = search.assess_stations(_draw_places(areas))
    if not first:
        raise PlanningError(
            "from no place of the tracker's areas a line is in range and in sight; "
            "correct the workspace"
        )
    risen = [search.climb(one) for one in search.rank(first)[:_CLIMBERS]]
    judged = search.rank([*first, *(one for found in risen for one in found)])
    stated = None if stated_mm is None else evaluator.assess(stated_mm)
    if stated_mm is not None and stated is None:
        raise PlanningError(
            "where the tracker stands no line is in range and in sight; correct the "
            "workspace"
        )
    return StationChoice(evaluator, tuple(judged), stated, areas.move_s, time_s)


@dataclass(frozen=True)
class _StationSearch:
    evaluator: StationEvaluator
    areas: StationAreas
    time_s: float

    def assess_stations(
        self, place_mm: Float64[np.ndarray, "n 3"]
    ) -> list[StationInformation]:
        found = map(self.evaluator.assess, place_mm[self.areas.allow(place_mm)])
        return [one for one in found if one is not None]

    def rank(self, judged: Sequence[StationInformation]) -> list[StationInformation]:
        return sorted(judged, key=self._predict_residual_mm)

    def climb(self, start: StationInformation) -> list[StationInformation]:
        low = np.min([box.low_mm for box in self.areas.areas], axis=0)
        high = np.max([box.high_mm for box in self.areas.areas], axis=0)
        best, found = start, list[StationInformation]()
        step = 0.25 * (high - low)
        for _ in range(_HALVINGS):
            step = step / 2.0
            moved = best.place_mm + np.vstack([np.diag(step), -np.diag(step)])
            near_mm = np.clip(moved, low, high)
            elsewhere = (near_mm != best.place_mm).any(axis=1)
            near = self.assess_stations(near_mm[elsewhere])
            found += near
            best = min([best, *near], key=self._predict_residual_mm)
        return found

    def _predict_residual_mm(self, one: StationInformation) -> float:
        return self.evaluator.evaluate([one], self.time_s).sigma_mm


def _draw_places(areas: StationAreas) -> Float64[np.ndarray, "n 3"]:
    """Evenly in each area and on its borders (Roberts 2018)."""
    count = -(-_PLACES // len(areas.areas))
    golden = 1.2207440846057596  # the positive root of g⁴ = g + 1
    unit = np.outer(np.arange(1, count + 1), golden ** -np.arange(1.0, 4.0)) % 1.0
    unit = np.clip(0.5 + _WIDER * (unit - 0.5), 0.0, 1.0)
    found: list[Float64[np.ndarray, "n 3"]] = []
    for box in areas.areas:
        low, high = np.array(box.low_mm), np.array(box.high_mm)
        found.append(np.unique(low + unit * (high - low), axis=0))
    return np.vstack(found)


DWELL_S = 1.5
_POINTS, _FEWEST = 5, 4
_APART_MM = 50.0  # off the line through the points: else they determine no turn


def choose_known_points(
    machine: Machine,
    workspace: Workspace,
    places_mm: Sequence[Float64[np.ndarray, "3"]],
    lines: Sequence[Commanded],
) -> Configurations:
    """Points of the travel, far apart, that every station sees.

    lines : rows of each station, after the known points
    Raises PlanningError if there are not enough of them, or none can be reached.
    """
    places = _make_grid(machine)
    for place_mm in places_mm:
        seen = workspace.place_tracker(place_mm)
        places = places[seen.allows(machine, places, places)]
    chosen = _spread(places)
    spread = np.linalg.svd(chosen - chosen.mean(axis=0), compute_uv=False)
    if len(chosen) < _FEWEST or spread[1] < _APART_MM:
        raise PlanningError(
            "not enough places of the travel are in range and in sight of every "
            "station to check one against the other; plan fewer stations, or correct "
            "the workspace"
        )
    unseen = workspace.without_sight
    for order in permutations(chosen.tolist()):
        way = np.array(order)
        if unseen.allows(machine, *_list_moves(way, lines)).all():
            name = moving_targets(machine)[0].name
            target = (name,) * len(way) if len(machine.targets) > 1 else ()
            dwell_s = np.full(len(way), DWELL_S)
            return Configurations(machine.axis_names, way, dwell_s, target)
    raise PlanningError(
        "keep-out boxes stand between the places that check one station against the "
        "other; correct the workspace"
    )


def _list_moves(
    way: Float64[np.ndarray, "n a"], lines: Sequence[Commanded]
) -> tuple[Float64[np.ndarray, "m a"], Float64[np.ndarray, "m a"]]:
    """Begins and ends of moves between known points and lines.

    A check that ends early restarts from any of the points.
    """
    first, last = way[:1], way[-1:]
    begin, end = [way[:-1], way], [way[1:], np.repeat(first, len(way), axis=0)]
    for rows in lines:
        begin += [last, rows.position[-1:]]
        end += [rows.position[:1], first]
    return np.concatenate(begin), np.concatenate(end)


def _make_grid(machine: Machine) -> Float64[np.ndarray, "n a"]:
    low, high = inner_travel(machine)
    unit = np.array(list(product((0.0, 0.5, 1.0), repeat=len(machine.linear_axes))))
    linear = unit.shape[1]
    places = low[:linear] + unit * (high - low)[:linear]
    return np.round(add_resting_axes(machine, places), DECIMALS)


def _spread(places: Float64[np.ndarray, "n a"]) -> Float64[np.ndarray, "m a"]:
    if not len(places):
        return np.zeros((1, places.shape[1]))
    chosen = places[:1]
    while len(chosen) < min(_POINTS, len(places)):
        apart = np.linalg.norm(places[:, None] - chosen, axis=2).min(axis=1)
        chosen = np.vstack([chosen, places[np.argmax(apart)]])
    return chosen
