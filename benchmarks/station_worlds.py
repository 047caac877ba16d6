"""Machines, trackers with faults of their own, and what a plan leaves on them."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from judging import map_mm, true_map_mm, volume
from recordings import machine_content, random_air, random_content, run_of
from target_seats import draw_machine, remove_rigid_motion

from truepath.alignment.align import align_all
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
from truepath_simulators.hidden.tracker import TrackerEccentricity, TrackerRangeOffset
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
        """The machine."""
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
        """Return the error of the elevation."""
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
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
