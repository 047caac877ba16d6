"""The tracker's chosen place against random ones; one station against three.

Each place gets a plan of its own and the same time; simulated machines drive it and the
recordings are estimated as any measurement is. What counts is the error left over the
travel, root mean square over machines and noise that are the same for every place.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table
from judging import map_mm, true_map_mm, volume
from recordings import machine_content, random_air, run_of

from app.alignment.align import align_all
from app.errors import PlanningError
from app.estimation.batch import estimate
from app.files.machine_file import machine_from_json
from app.kinematics.coarse_model import build_run_models
from app.kinematics.effects.tracker_error import TrackerSpecification
from app.kinematics.machine import Machine
from app.motion.workspace import Box, StationAreas, Workspace
from app.planning.plan import Plan, PlanOrder, make_plan
from drivers.interfaces.records import Path as MachinePath
from simulators import synthetic
from simulators.hidden.effect import HiddenEffect
from simulators.hidden.tracker_eccentricity import TrackerEccentricity
from simulators.hidden.tracker_range_offset import TrackerRangeOffset
from simulators.recording import Recording
from simulators.timeline import Program
from simulators.tracker_head import TrackerPose

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "planning.md"
PERFECT = TrackerSpecification(0.0, 0.0, 0.0, 0.0)
USUAL = TrackerSpecification()
MOVE_S = 180.0


@dataclass(frozen=True)
class Site:
    """A machine, where its tracker may stand, and how long it is measured."""

    name: str
    travel_mm: tuple[float, float, float]
    aside_mm: tuple[float, float]
    minutes: float
    feed_mm_min: float

    @property
    def content(self) -> dict[str, Any]:
        """The content of machine.json."""
        return machine_content("w-b-X-Y-Z-t", self.travel_mm, (20.0, 30.0, -150.0))

    @property
    def machine(self) -> Machine:
        """The machine."""
        return machine_from_json(self.content, file="machine.json")

    @property
    def areas(self) -> tuple[Box, ...]:
        """The floor before the machine, behind it, and at its right."""
        x, y, z = self.travel_mm
        near, far = self.aside_mm
        low, high = -300.0, 0.6 * z
        return (
            Box((-far, -far, low), (x + far, -near, high)),
            Box((-far, y + near, low), (x + far, y + far, high)),
            Box((x + near, -near, low), (x + far, y + near, high)),
        )


SITES = {
    "mill": Site("mill, 0.7 m", (700.0, 550.0, 450.0), (500.0, 1600.0), 2.0, 6e3),
    "gantry": Site("gantry, 6.2 m", (6200.0, 2400.0, 1100.0), (700.0, 2200.0), 4, 2e4),
}
TRACKERS = {"perfect": PERFECT, "usual specification": USUAL}


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

    @property
    def keys(self) -> dict[str, str]:
        """Nothing."""
        return {}

    def parameters(self, clock: Any) -> dict[str, float]:
        """Return the index."""
        del clock
        return {"index_rad": self.index_rad}

    def misread(self, polar: np.ndarray) -> np.ndarray:
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
    path = plan.commanded
    assert isinstance(path, MachinePath)
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
    program = Program(path.position, path.feed_mm_min / 60.0, path.dwell_s)
    return synthetic.record(site.content, program, 100 * seed + number, "otf", setting)


def measure(
    site: Site, plans: list[Plan], seed: int, specification: TrackerSpecification
) -> tuple[float, float]:
    """Return the error left and the stated uncertainty of one estimate of all, mm."""
    faults = draw_faults(specification, seed)
    made = [record(site, plan, seed, k, faults) for k, plan in enumerate(plans)]
    runs = [run_of(one) for one in made]
    seen = align_all(runs, [f"station {k + 1}" for k in range(len(runs))])
    models = build_run_models(seen[0].at.machine, [one.at.offset_mm for one in seen])
    found = estimate(models, seen)
    within = volume(runs[0].machine)
    error, sigma = map_mm(within, found.model, found.theta, found.covariance)
    truth = true_map_mm(within, made[0].truth)
    return within.rms_length(truth - error), within.rms_length(sigma)


def plan_for(
    site: Site,
    place: tuple[float, float, float] | None,
    seconds: float,
    specification: TrackerSpecification,
    number: int = 0,
) -> Plan:
    """Return the plan from a place, or from the one that it chooses."""
    stations = StationAreas(site.areas, (), MOVE_S, specification)
    workspace = Workspace((), place, 200.0, stations=None if place else stations)
    order = PlanOrder(
        minutes=seconds / 60.0,
        feeds_mm_min=(site.feed_mm_min,),
        workspace=workspace,
        seed=number,
    )
    return make_plan(site.machine, order)


def rms(values: list[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


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


def judge_places(
    site: Site, specification: TrackerSpecification, places: int, worlds: int
) -> list[tuple[float, float]]:
    """Return what the chosen place and random ones leave and state, mm."""
    seconds = 60.0 * site.minutes
    plans = [plan_for(site, None, seconds, specification)]
    for place in draw_places(site, places):
        try:
            plans.append(plan_for(site, place, seconds, specification))
        except PlanningError as error:
            print(f"{place}: {error}", file=sys.stderr)
    found: list[tuple[float, float]] = []
    for plan in plans:
        each = [measure(site, [plan], s, specification) for s in range(1, worlds + 1)]
        found.append((rms([a for a, _ in each]), rms([b for _, b in each])))
        print(
            site.name,
            np.round(plan.station_mm).tolist(),
            *(f"{1e3 * v:.3f}" for v in found[-1]),
            file=sys.stderr,
            flush=True,
        )
    return found


def places_table(sites: list[Site], places: int, worlds: int) -> str:
    """Return the chosen place against random ones."""
    rows = []
    for site in sites:
        for said, specification in TRACKERS.items():
            found = np.array(judge_places(site, specification, places, worlds))
            left, stated = 1e3 * found.T
            rows.append(
                [
                    site.name,
                    said,
                    f"{left[0]:.2f}",
                    f"{left[1:].min():.2f}",
                    f"{np.median(left[1:]):.2f}",
                    f"{left[1:].max():.2f}",
                    f"**{left[0] / left[1:].min():.2f}**",
                    f"{stated[0] / stated[1:].min():.2f}",
                ]
            )
    head = [
        f"error left, µm, of {worlds} worlds",
        "tracker",
        "chosen place",
        f"best of {places}",
        "median",
        "worst",
        "chosen / best",
        "stated u, chosen / best",
    ]
    return table(head, rows)


def stations_row(
    site: Site, said: str, specification: TrackerSpecification, worlds: int
) -> list[str]:
    """Return what one place and three leave in the same time, and what was foretold."""
    seconds = 60.0 * site.minutes
    one = plan_for(site, None, seconds, specification)
    assert one.stations is not None
    three = one.stations.options[2]
    long = plan_for(site, _place(one.station_mm), three.total_s, specification)
    several = [
        plan_for(site, _place(place), seconds / 3.0, specification, number)
        for number, place in enumerate(three.place_mm)
    ]
    left = [
        rms([measure(site, plans, s, specification)[0] for s in range(1, worlds + 1)])
        for plans in ([one], several, [long])
    ]
    foretold = (one.stations.options[0].left, three.left, three.stay)
    return [
        site.name,
        said,
        *(
            f"{1e3 * value:.2f} ({1e3 * told.sigma_mm:.2f})"
            for value, told in zip(left, foretold, strict=True)
        ),
        f"{left[1] / left[0]:.2f}",
        f"**{left[1] / left[2]:.2f}** ({three.ratio:.2f})",
    ]


def stations_table(sites: list[Site], worlds: int) -> str:
    """Return one station against three, without and with the tracker's own errors."""
    worse = replace(USUAL, **{k: 5.0 * v for k, v in asdict(USUAL).items()})
    rows = [
        stations_row(site, said, specification, worlds)
        for site in sites
        for said, specification in {**TRACKERS, "five times that": worse}.items()
    ]
    head = [
        f"error left (foretold), µm, of {worlds} worlds",
        "tracker",
        "one place",
        "three, a third of the time each",
        "one place, two moves of 3 min longer",
        "three / one",
        "three / one as long",
    ]
    return table(head, rows)


def main() -> None:
    """Print the tables; with --write put them into the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--places", type=int, default=20)
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--only", choices=["places", "stations"])
    parser.add_argument("--site", choices=SITES, help="else all")
    parser.add_argument("--write", action="store_true", help=f"into {DOCUMENT.name}")
    options = parser.parse_args()
    sites = [SITES[options.site]] if options.site else list(SITES.values())
    texts = {
        "places": lambda: places_table(sites, options.places, options.worlds),
        "stations": lambda: stations_table(sites, options.worlds),
    }
    for name, make in texts.items():
        if options.only in (None, name):
            text = make()
            print(f"\n{text}\n", flush=True)
            if options.write:
                _write(name, text)


def _place(place_mm: np.ndarray) -> tuple[float, float, float]:
    x, y, z = place_mm.tolist()
    return x, y, z


def _write(name: str, text: str) -> None:
    content = DOCUMENT.read_text(encoding="utf-8")
    place = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
    written = place.sub(lambda m: f"{m[1]}\n{text}\n\n{m[2]}", content)
    DOCUMENT.write_text(written, encoding="utf-8")


if __name__ == "__main__":
    main()
