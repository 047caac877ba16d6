"""The place of the tracker that a plan chooses against random ones; one against three.

Every plan is driven by simulated machines, which know nothing of the estimator, and
every recording is estimated as any measurement is. What counts is the error left over
the travel, root mean square over worlds: machines, noise and, where it has any, the
tracker's own faults, drawn from its specification. All places see the same worlds.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table, write_section
from judging import map_mm, true_map_mm, volume
from recordings import machine_content, random_air, random_content, run_of
from target_seats import draw_machine, remove_rigid_motion

from truepath.alignment.align import align_all
from truepath.errors import PlanningError
from truepath.estimation.solve.batch import estimate
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.workspace import Box, StationAreas, Workspace
from truepath.planning.plan import Plan, make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath_drivers.interfaces.records import Path as MachinePath
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.setup import TrackerEccentricity, TrackerRangeOffset
from truepath_simulators.machine.tracker_head import TrackerPose
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import Recording

PERFECT = TrackerSpecification(0.0, 0.0, 0.0, 0.0)
USUAL = TrackerSpecification()
MOVE_S = 180.0
_GRID = 300  # places of a travel with rotary axes


@dataclass(frozen=True)
class Site:
    """A machine, where its tracker may stand, and how long it is measured.

    aside_mm : nearest and farthest from the travel
    """

    name: str
    content: dict[str, Any]
    aside_mm: tuple[float, float]
    minutes: float
    feed_mm_min: float
    mode: str = "otf"

    @cached_property
    def machine(self) -> Machine:
        return machine_from_json(self.content, file="machine.json")

    @property
    def areas(self) -> tuple[Box, ...]:
        """The floor before the machine, behind it, and at its right."""
        x, y, z = (axis.high for axis in self.machine.linear_axes)
        near, far = self.aside_mm
        low, high = -300.0, 0.6 * z
        return (
            Box((-far, -far, low), (x + far, -near, high)),
            Box((-far, y + near, low), (x + far, y + far, high)),
            Box((x + near, -near, low), (x + far, y + near, high)),
        )


def make_sites() -> dict[str, Site]:
    """Return the sites; machines without a name of their own are drawn by a seed."""
    gantry = machine_content("w-b-X-Y-Z-t", (6000.0, 2500.0, 1200.0), (0.0, 0.0, -250))
    mills = {
        f"mill-{seed}": Site(
            f"mill {seed}, {random_content(seed)['kinematic_chain']}",
            random_content(seed),
            (500.0, 1600.0),
            2.0,
            6e3,
        )
        for seed in (1001, 1002)
    }
    five = draw_machine(1000)
    return {
        **mills,
        "gantry": Site("gantry, 6 x 2.5 x 1.2 m", gantry, (700.0, 2200.0), 4.0, 2e4),
        "five-axis": Site(
            f"five axes, {five['kinematic_chain']}",
            five,
            (500.0, 1600.0),
            6.0,
            6e3,
            "standstill",
        ),
    }


_WORSE = {name: 5.0 * value for name, value in asdict(USUAL).items()}
TRACKERS = {
    "perfect": PERFECT,
    "usual specification": USUAL,
    "five times that": replace(USUAL, **_WORSE),
}


@dataclass(frozen=True)
class Index(HiddenEffect):
    """An elevation's zero that is off, and air that bends the beam, as sight levels."""

    name = "index-and-bending"
    in_catalogue = False
    index_rad: float
    bending_rad_per_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, occasion: Any) -> Index:
        """Draw none: sizes come from the specification."""
        raise NotImplementedError

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        error = np.zeros_like(polar)
        level_mm = polar[:, 0] * np.cos(polar[:, 2])
        error[:, 2] = self.index_rad + 0.5 * self.bending_rad_per_mm * level_mm
        return error


def draw_faults(
    specification: TrackerSpecification, seed: int
) -> tuple[HiddenEffect, ...]:
    """Draw a tracker of a specification; none where that is perfect."""
    if specification == PERFECT:
        return ()
    rng = np.random.default_rng([seed, 77])
    circles = tuple(
        TrackerEccentricity(
            circle,
            1e6 * specification.eccentricity_rad,
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )
        for circle in ("azimuth", "elevation")
    )
    index, offset, bending = rng.normal(size=3)
    return (
        *circles,
        Index(
            index * specification.index_rad, bending * specification.bending_rad_per_mm
        ),
        TrackerRangeOffset(1e3 * offset * specification.range_offset_mm),
    )


def record(
    site: Site, plan: Plan, seed: int, number: int, faults: tuple[HiddenEffect, ...]
) -> Recording:
    """Drive a plan on the machine of a seed, the tracker set down at any turn."""
    rows = plan.commanded
    feed = np.full(len(rows), site.feed_mm_min)
    if isinstance(rows, MachinePath):
        feed = rows.feed_mm_min
    turn = np.random.default_rng([seed, number, 78]).uniform(-np.pi, np.pi)
    sine, cosine = np.sin(turn), np.cos(turn)
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    setting = synthetic.Setting(
        machine_seed=seed,
        air=random_air(seed),
        pose=TrackerPose(plan.station_mm, rotation),
        hidden=faults,
        sensors=False,
    )
    program = Program(rows.position, feed / 60.0, rows.dwell_s, rows.target)
    return synthetic.record(
        site.content, program, 100 * seed + number, site.mode, setting
    )


def measure(
    site: Site, plans: tuple[Plan, ...], seed: int, specification: TrackerSpecification
) -> tuple[float, float]:
    """Return the error left and the stated uncertainty of one estimate of all, mm."""
    faults = draw_faults(specification, seed)
    made = [record(site, plan, seed, k, faults) for k, plan in enumerate(plans)]
    runs = [run_of(one) for one in made]
    seen = align_all(runs, [f"station {k + 1}" for k in range(len(runs))])
    models = build_run_models(site.machine, [one.at for one in seen])
    return judge(site, estimate(models, seen), made[0])


def judge(site: Site, found: EstimatedModel, made: Recording) -> tuple[float, float]:
    """Return the error left over the travel, and the stated uncertainty, mm."""
    machine = site.machine
    if not machine.rotary_axes:
        within = volume(machine)
        error, sigma = map_mm(within, found.model, found.theta, found.covariance)
        left = true_map_mm(within, made.truth) - error
        return within.rms_length(left), within.rms_length(sigma)
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    q = np.random.default_rng(7).uniform(low, high, (_GRID, len(low)))
    nominal, name = perfect(parse_machine(site.content)), machine.targets[0].name
    place = nominal.nominal_point_mm(q, nominal.machine.reflector(name))
    actual = made.truth.point_mm(q, made.truth.machine.reflector(name))
    still, maps = make_standstill(machine, q), build_volumetric_map(found.model)
    told = maps.error_mm(still, found.theta)
    left = remove_rigid_motion(place, actual - place - told)
    sigma = maps.sigma_mm(still, found.covariance)
    return rms(np.linalg.norm(left, axis=1)), rms(np.linalg.norm(sigma, axis=1))


def plan_for(
    site: Site,
    place: tuple[float, float, float] | None,
    seconds: float,
    specification: TrackerSpecification,
    stations: int = 1,
) -> Plan:
    """Return the plan from a place, or from those that it chooses."""
    areas = StationAreas(site.areas, (), MOVE_S, specification)
    workspace = Workspace((), place, 200.0, stations=None if place else areas)
    order = PlanRequirements(
        mode=site.mode,
        minutes=seconds / 60.0,
        feeds_mm_min=(site.feed_mm_min,) if site.mode == "otf" else (),
        workspace=workspace,
        stations=stations,
    )
    return make_plan(site.machine, order)


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


FIRST_WORLD = 1001


def draw_places(site: Site, count: int) -> list[tuple[float, float, float]]:
    """Draw places, evenly over the volume of the areas."""
    rng = np.random.default_rng(5)
    low, high = (
        np.array([getattr(b, k) for b in site.areas]) for k in ("low_mm", "high_mm")
    )
    size = np.prod(high - low, axis=1)
    which = rng.choice(len(size), count, p=size / size.sum())
    x = np.round(rng.uniform(low[which], high[which]), 1)
    return [(float(a), float(b), float(c)) for a, b, c in x]


def measure_worlds(
    site: Site,
    plans: tuple[Plan, ...],
    specification: TrackerSpecification,
    worlds: int,
) -> np.ndarray:
    """Return error left and stated uncertainty in each world, (worlds, 2) in µm."""
    seeds = range(FIRST_WORLD, FIRST_WORLD + worlds)
    each = 1e3 * np.array([measure(site, plans, s, specification) for s in seeds])
    print(
        site.name,
        [p.station_mm.round().tolist() for p in plans],
        each.round(3),
        file=sys.stderr,
        flush=True,
    )
    return each


def assess_stations(site: Site, places: int, worlds: int) -> list[str]:
    """Return the row of the chosen place against random ones, usual specification."""
    seconds = 60.0 * site.minutes
    plans = [plan_for(site, None, seconds, USUAL)]
    for place in draw_places(site, places):
        try:
            plans.append(plan_for(site, place, seconds, USUAL))
        except PlanningError as error:
            print(f"{place}: {error}", file=sys.stderr)
    found = [measure_worlds(site, (plan,), USUAL, worlds) for plan in plans]
    each, told = np.moveaxis(np.array(found), -1, 0)
    left, stated = rms_over_worlds(each), rms_over_worlds(told)
    return [
        site.name,
        f"{worlds}",
        f"{left[0]:.2f}",
        f"{left[1:].min():.2f}",
        f"{np.median(left[1:]):.2f}",
        f"{left[1:].max():.2f}",
        f"**{compare_to_best(each):.2f}**",
        f"{stated[0] / stated[1:].min():.2f}",
    ]


def rms_over_worlds(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=-1))


def compare_to_best(left: np.ndarray) -> float:
    """Return what the first place leaves against the best of the others.

    The best is the best in half of the worlds, and is compared in the other half: in
    the worlds that it was picked by, it is also the luckiest.

    left : (places, worlds), worlds at least 2
    """
    halves = left[:, ::2], left[:, 1::2]
    ratios = [
        rms_over_worlds(there)[0] / rms_over_worlds(there)[best]
        for here, there in (halves, halves[::-1])
        if (best := 1 + int(np.argmin(rms_over_worlds(here)[1:])))
    ]
    return float(np.sqrt(np.prod(ratios)))


PLACES_HEAD = [
    "error left, µm",
    "worlds",
    "chosen place",
    "best of 20",
    "median",
    "worst",
    "chosen / best, in other worlds",
    "stated u, chosen / best",
]


def compare_stations(site: Site, said: str, worlds: int) -> list[str]:
    """Return what one place and three leave, and what was foretold of each."""
    specification, seconds = TRACKERS[said], 60.0 * site.minutes
    one = plan_for(site, None, seconds, specification)
    assert one.stations is not None
    advised = len(one.stations.recommended.place_mm)
    three = plan_for(site, None, seconds, specification, stations=3)
    longer_s = one.duration_s + 2.0 * MOVE_S
    long = plan_for(site, _place(one.station_mm), longer_s, specification)
    left = [
        rms(measure_worlds(site, plans, specification, worlds)[:, 0])
        for plans in ((one,), three.at_stations, (long,))
    ]
    systematic_mm = [o.left.systematic_mm for o in one.stations.options]
    told = [
        1e3 * float(np.hypot(plan.outcome.random_mm, systematic_mm[k]))
        for plan, k in ((one, 0), (three, 2), (long, 0))
    ]
    return [
        site.name,
        said,
        f"{worlds}",
        *(f"{a:.2f} ({b:.2f})" for a, b in zip(left, told, strict=True)),
        f"{left[1] / left[0]:.2f} ({told[1] / told[0]:.2f})",
        f"**{left[1] / left[2]:.2f}** ({told[1] / told[2]:.2f})",
        f"{advised}",
    ]


STATIONS_HEAD = [
    "error left (foretold), µm",
    "tracker",
    "worlds",
    "one place",
    "three, a third of the time each",
    "one place, two moves of 3 min longer",
    "three / one",
    "three / one as long",
    "advised",
]


def main() -> None:
    sites = make_sites()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--places", type=int, default=20)
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--only", choices=["places", "stations", "nothing"])
    parser.add_argument("--site", choices=sites, help="else all")
    parser.add_argument("--tracker", choices=TRACKERS, help="of stations; else all")
    parser.add_argument(
        "--keep", type=Path, default=Path("stations.json"), help="rows of several calls"
    )
    options = parser.parse_args()
    for name in [options.site] if options.site else sites:
        if options.only in (None, "places"):
            row = assess_stations(sites[name], options.places, options.worlds)
            _keep(options.keep, "places", row)
        if options.only in (None, "stations"):
            for said in [options.tracker] if options.tracker else TRACKERS:
                row = compare_stations(sites[name], said, options.worlds)
                _keep(options.keep, "stations", row)
    kept = json.loads(options.keep.read_text(encoding="utf-8"))
    for key, head in (("places", PLACES_HEAD), ("stations", STATIONS_HEAD)):
        if kept.get(key):
            write_section(f"station-{key}", table(head, sorted(kept[key])))


def _keep(file: Path, key: str, row: list[str]) -> None:
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    kept.setdefault(key, []).append(row)
    file.write_text(json.dumps(kept), encoding="utf-8")


def _place(place_mm: np.ndarray) -> tuple[float, float, float]:
    x, y, z = place_mm.tolist()
    return x, y, z


if __name__ == "__main__":
    main()
