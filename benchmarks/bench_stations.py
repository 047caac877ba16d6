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
from pathlib import Path

import numpy as np
from station_worlds import (
    MOVE_S,
    TRACKERS,
    USUAL,
    Site,
    make_sites,
    measure,
    plan_for,
    rms,
)

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table, write_section

from truepath.errors import PlanningError
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.planning.plan import Plan

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
    """Return the root mean square over the last axis."""
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
    """Judge, keep the rows, and write the tables of all rows kept."""
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
    """Add a row to those that are kept."""
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    kept.setdefault(key, []).append(row)
    file.write_text(json.dumps(kept), encoding="utf-8")


def _place(place_mm: np.ndarray) -> tuple[float, float, float]:
    x, y, z = place_mm.tolist()
    return x, y, z


if __name__ == "__main__":
    main()
