"""Detached machines that drove another program than the one that is stated.

The machine drives a program that was mirrored, scaled, turned, shifted, put in another
order, edited, cut or taken from another file; the recording is analysed with the one
that was meant. No row may be wrong and call itself usable; a shift or turn of the whole
program is the same as another place of the tracker where all axes are straight. On the
fly, at standstill, and of machines with rotary axes; each row on a machine of its own.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from disturbed_runs import LINES, Outcome, measure
from document import table, write_section
from recordings import plan_program, random_content
from target_seats import draw_machine

from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.synthetic import Setting, record

SEED = 9901
_FEWEST_INSIDE = 0.85  # of the components inside 2 u
Wrong = Callable[[Program, np.random.Generator], Program]
Meant = tuple[dict[str, object], Program, str]


def move(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Wrong:
    """Return what changes the positions of a program."""
    return lambda program, rng: replace(
        program, position=np.round(change(program.position.copy(), rng), 4)
    )


def order(choose: Callable[[int, np.random.Generator], np.ndarray]) -> Wrong:
    """Return what drives the rows of a program in another order, or some of them."""

    def change(program: Program, rng: np.random.Generator) -> Program:
        rows = choose(len(program), rng)
        target = tuple(program.target[k] for k in rows) if program.target else ()
        return Program(
            program.position[rows],
            program.feed_mm_s[rows],
            program.dwell_s[rows],
            target,
        )

    return change


def mirror(*axes: int) -> Wrong:
    """Mirror axes about their middle, as G51.1 does."""

    def change(position: np.ndarray, _: np.random.Generator) -> np.ndarray:
        for axis in axes:
            ends = position[:, axis].min() + position[:, axis].max()
            position[:, axis] = ends - position[:, axis]
        return position

    return move(change)


def scale(factor: float, *axes: int) -> Wrong:
    """Scale axes about their middle, as G51 does; all where none is named."""

    def change(position: np.ndarray, _: np.random.Generator) -> np.ndarray:
        chosen = list(axes or range(3))
        middle = position[:, chosen].mean(axis=0)
        position[:, chosen] = middle + factor * (position[:, chosen] - middle)
        return position

    return move(change)


def turn(degrees: float) -> Wrong:
    """Turn about Z, as G68 does."""

    def change(position: np.ndarray, _: np.random.Generator) -> np.ndarray:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        middle = position[:, :2].mean(axis=0)
        turned = (position[:, :2] - middle) @ np.array([[c, s], [-s, c]])
        position[:, :2] = middle + turned
        return position

    return move(change)


def shift(*by: float) -> Wrong:
    return move(lambda q, _: q + np.pad(by, (0, q.shape[1] - len(by))))


def edit(rows: int, by: float) -> Wrong:
    """Move some rows, each by so much in one direction."""

    def change(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        chosen = rng.choice(np.arange(1, len(position)), rows, replace=False)
        away = rng.normal(size=(rows, 3))
        position[chosen, :3] += by * away / np.linalg.norm(away, axis=1)[:, None]
        return position

    return move(change)


def swap(a: int, b: int) -> Wrong:
    def change(position: np.ndarray, _: np.random.Generator) -> np.ndarray:
        position[:, [a, b]] = position[:, [b, a]]
        return position

    return move(change)


def skew(slope: float) -> Wrong:
    """Lean Y over X, as a program of another kinematic does."""

    def change(position: np.ndarray, _: np.random.Generator) -> np.ndarray:
        position[:, 0] += slope * (position[:, 1] - position[:, 1].mean())
        return position

    return move(change)


def drop(share: float) -> Wrong:
    return order(
        lambda n, rng: np.sort(rng.choice(n, round((1 - share) * n), replace=False))
    )


def swap_neighbours(count: int) -> Wrong:
    """Drive some rows before the ones ahead of them."""

    def choose(n: int, rng: np.random.Generator) -> np.ndarray:
        rows = np.arange(n)
        for k in rng.choice(np.arange(1, n - 2), count, replace=False):
            rows[[k, k + 1]] = rows[[k + 1, k]]
        return rows

    return order(choose)


WRONG: dict[str, Wrong] = {
    "as stated": lambda program, _: program,
    "X mirrored": mirror(0),
    "Z mirrored": mirror(2),
    "X, Y, Z mirrored": mirror(0, 1, 2),
    "X and Y swapped": swap(0, 1),
    "scaled by 0.999": scale(0.999),
    "scaled by 0.99": scale(0.99),
    "scaled by 0.9": scale(0.9),
    "scaled by 1/25.4": scale(1 / 25.4),
    "X scaled by 0.9995": scale(0.9995, 0),
    "X scaled by 0.998": scale(0.998, 0),
    "X scaled by 0.95": scale(0.95, 0),
    "Y leaning by 0.0005": skew(0.0005),
    "Y leaning by 0.002": skew(0.002),
    "Y leaning by 0.05": skew(0.05),
    "backwards": order(lambda n, _: np.arange(n)[::-1]),
    "another order": order(lambda n, rng: rng.permutation(n)),
    "2 neighbours swapped": swap_neighbours(2),
    "halves swapped": order(lambda n, _: np.roll(np.arange(n), n // 2)),
    "twice": order(lambda n, _: np.tile(np.arange(n), 2)),
    "every second row": order(lambda n, _: np.arange(0, n, 2)),
    "a fifth left out": drop(0.2),
    "first half": order(lambda n, _: np.arange(n // 2)),
    "a row 0.05 mm aside": edit(1, 0.05),
    "a row 0.5 mm aside": edit(1, 0.5),
    "3 rows 5 mm aside": edit(3, 5.0),
    "a fifth 0.1 mm aside": edit(8, 0.1),
    "all rounded to 0.1 mm": move(lambda q, _: np.round(q, 1)),
    "all rounded to 1 mm": move(lambda q, _: np.round(q)),
    "turned by 0.5° about Z": turn(0.5),
    "shifted by 1 mm": shift(1.0, -0.7, 0.4),
}
FREE: dict[str, Wrong] = {
    "shifted by 40 mm": shift(20.0, -20.0, 28.0),
    "turned by 5° about Z": turn(5.0),
    "X and Y mirrored": mirror(0, 1),
}

RIGID = (*FREE, "turned by 0.5° about Z", "shifted by 1 mm")


def plan_lines(seed: int) -> Meant:
    content = random_content(seed)
    return content, plan_program(content, 5000.0, 40), "otf"


def plan_points(seed: int) -> Meant:
    content = random_content(seed)
    machine = parse_machine(content)
    return (
        content,
        paths.standstill_points(machine, seed, 70, dwell_s=0.8),
        "standstill",
    )


def plan_turns(seed: int) -> Meant:
    content = draw_machine(seed)
    machine = parse_machine(content)
    points = paths.turning_points(machine, seed, 150, dwell_s=0.6)
    return content, points, "standstill"


def plan_turning_lines(seed: int) -> Meant:
    content = draw_machine(seed)
    machine = parse_machine(content)
    return content, paths.turning_path(machine, seed, 80, 6000.0), "otf"


TURNED: dict[str, Wrong] = {
    "first rotary axis the other way": mirror(3),
    "first rotary axis shifted by 1°": shift(0, 0, 0, 1.0),
    "first rotary axis shifted by 30°": shift(0, 0, 0, 30.0),
    "first rotary axis scaled by 0.999": scale(0.999, 3),
    "first rotary axis scaled by 0.9": scale(0.9, 3),
}
_FEW = (
    "as stated", "X mirrored", "X and Y swapped", "scaled by 0.99", "backwards",
    "another order", "every second row", "3 rows 5 mm aside", "shifted by 1 mm",
    "X scaled by 0.998",
)  # fmt: skip
ROTARY = {name: WRONG[name] for name in _FEW} | FREE | TURNED
KINDS: dict[str, tuple[Callable[[int], Meant], dict[str, Wrong]]] = {
    "lines": (plan_lines, WRONG | FREE),
    "points": (plan_points, WRONG | FREE),
    "rotary-points": (plan_turns, ROTARY),
    "rotary-lines": (plan_turning_lines, ROTARY),
}


def try_wrong(meant: Meant, wrong: Wrong, seed: int) -> Outcome:
    """Drive the wrong program, analyse with the meant one, judge by the truth."""
    content, program, mode = meant
    driven = wrong(program, np.random.default_rng([seed, 6]))
    recording = record(content, driven, seed, mode, Setting())
    stated = replace(recording, program=program)
    return measure(stated, LINES["nothing"], seed)


def is_wrong(found: Outcome) -> bool:
    """Tell whether a table is wrong and does not say so."""
    return found.said.startswith("usable") and found.inside < _FEWEST_INSIDE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--dry", action="store_true", help="write no document")
    options, _ = parser.parse_known_args()
    head = ["program that was driven", "error left", "inside 2 u", "verdict", "right"]
    for number, (kind, (plan, wrongs)) in enumerate(KINDS.items()):
        if kind not in options.kinds.split(","):
            continue
        rows: list[list[str]] = []
        for each, (name, wrong) in enumerate(wrongs.items()):
            if options.only not in name:
                continue
            seed = options.seed + 100 * number + each
            found = try_wrong(plan(seed), wrong, seed)
            told = "" if np.isnan(found.share) else f"{found.share:.1%}"
            inside = "" if np.isnan(found.inside) else f"{found.inside:.0%}"
            is_free = name in RIGID and kind in ("lines", "points")
            right = "**no**" if is_wrong(found) else "yes"
            right = "nobody can tell" if is_free and is_wrong(found) else right
            rows.append([name, told, inside, found.said, right])
            print(seed, kind, *rows[-1], sep=" | ", file=sys.stderr, flush=True)
        if not options.dry:
            write_section(f"wrong-{kind}", table(head, rows))


if __name__ == "__main__":
    main()
