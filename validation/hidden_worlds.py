"""Worlds in which something is hidden, or nothing: drawn by seed, recorded at once.

Machines of any size and chain, measured on planned or on random lines at any usual
feed; effects of 1.5 to 6 µm as the tracker sees them. An effect that even an ideal test
would hardly see is drawn anew: nobody could be asked to find it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from ideal_test import signal_to_noise
from recordings import PERFECT, plan_program, random_air, random_content

from truepath_simulators.hidden.effect import HiddenEffect, Occasion
from truepath_simulators.hidden.effects_by_name import CATALOGUED, UNCATALOGUED, draw
from truepath_simulators.hidden.structure import ThermalGrowth
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import Recording
from truepath_simulators.worlds.synthetic import ROUGH, Setting

KINDS = (
    "single",
    "pair",
    "triple",
    "clean",
    "off-catalogue",
    "tenth",
    "tenfold",
    "rough-stream",
    "poor-hall",
    "standstill",
)
ONE_EFFECT = ("single", "tenth", "tenfold", "rough-stream", "poor-hall")
_SCALES = {"tenth": 0.1, "tenfold": 10.0}
STANDING = (
    "",
    "backlash",
    "lateral-backlash",
    "thermal-growth",
    "spindle-growth",
    "table-drift",
    "elastic-sag",
    "tracker-eccentricity",
    "tracker-range-offset",
    "setup-step",
)
_POINTS = (60, 120)
_POOR = {"share": 1.0 / 3.0, "noise_scale": 2.0}
SIZES_UM = (1.5, 6.0)
# A log-likelihood ratio of 32: after the price of looking for thousands of shapes.
LEAST_SIGNAL_TO_NOISE = 8.0
_DRAWS, _APART = 100, 100_000


@dataclass(frozen=True)
class World:
    """One recording and what it hides.

    size_um : as drawn; signal_to_noise : of the ideal test; one for each effect
    """

    seed: int
    kind: str
    recording: Recording
    size_um: tuple[float, ...]
    signal_to_noise: tuple[float, ...]

    @property
    def truth(self) -> list[dict[str, Any]]:
        """The hidden effects in the form of `discovery.json`."""
        return self.recording.hidden_truth()

    @property
    def is_catalogued(self) -> bool:
        """Whether all that is hidden has a name in the catalogue."""
        return all(effect.in_catalogue for effect in self.recording.hidden)


def draw_world(seed: int, kind: str, lines: tuple[int, int] = (22, 40)) -> World:
    """Draw a world of a kind.

    seed : neighbouring seeds go through all effects in turn
    """
    names = _choose_names(seed, kind)
    for attempt in range(_DRAWS):
        made = _draw_once(seed + _APART * attempt, kind, names, lines)
        least = 0.0 if kind == "tenth" else LEAST_SIGNAL_TO_NOISE
        if all(value >= least for value in made.signal_to_noise):
            return replace(made, seed=seed)
    raise RuntimeError(f"world {seed}: {names} were not to be seen in {_DRAWS} draws")


def _draw_once(
    seed: int, kind: str, names: tuple[str, ...], lines: tuple[int, int]
) -> World:
    rng = np.random.default_rng([seed, 11])
    content, air = random_content(seed), random_air(seed)
    if any(name.startswith("tracker-") for name in names):
        # Within its specification an error of the tracker is no news.
        content["tracker"]["specification"] = PERFECT
    program = (
        _sample_points(content, seed, rng)
        if kind == "standstill"
        else draw_program(content, rng, lines)
    )
    setting = Setting(air=air, sensors=bool(rng.uniform() < 0.5))
    if kind == "rough-stream":
        setting = replace(setting, defects=ROUGH)
    if kind == "poor-hall":
        air = replace(air, share=_POOR["share"])
        setting = replace(setting, air=air, noise_scale=_POOR["noise_scale"])
    scale = _SCALES.get(kind, 1.0)
    sizes = tuple(scale * float(s) for s in rng.uniform(*SIZES_UM, len(names)))
    hidden = _draw_effects(seed, names, sizes, content, program)
    mode = "standstill" if kind == "standstill" else "otf"
    recording = _record(content, program, seed, setting, hidden, mode)
    return World(
        seed, kind, recording, sizes, _measure_signal(recording, setting, seed)
    )


def _choose_names(seed: int, kind: str) -> tuple[str, ...]:
    if kind in ONE_EFFECT:
        return (CATALOGUED[seed % len(CATALOGUED)],)
    if kind in ("pair", "triple"):
        first = CATALOGUED[seed % len(CATALOGUED)]
        others = [name for name in CATALOGUED if name != first]
        more = 1 if kind == "pair" else 2
        rng = np.random.default_rng([seed, 12])
        return first, *map(str, rng.choice(others, more, replace=False))
    if kind == "standstill":
        name = STANDING[seed % len(STANDING)]
        return (name,) if name else ()
    if kind == "off-catalogue":
        return (UNCATALOGUED[seed % len(UNCATALOGUED)],)
    return ()


def draw_program(
    content: dict[str, Any], rng: np.random.Generator, lines: tuple[int, int]
) -> Program:
    """Draw the product's path or random chords, at one feed or at several."""
    count = int(rng.integers(*lines, endpoint=True))
    feed = float(np.round(rng.uniform(3000.0, 9000.0), -2))
    if rng.uniform() < 0.5:
        program = plan_program(content, feed, count)
    else:
        chords = int(rng.integers(1 << 30))
        program = paths.chord_path(parse_machine(content), chords, count + 1, feed)
    if rng.uniform() < 0.5:
        return program
    shares = rng.choice([0.5, 0.75, 1.0], len(program))
    return replace(program, feed_mm_s=np.round(60.0 * program.feed_mm_s * shares) / 60)


def _sample_points(
    content: dict[str, Any], seed: int, rng: np.random.Generator
) -> Program:
    """Draw where the machine is to stand."""
    count = int(rng.integers(*_POINTS, endpoint=True))
    return paths.standstill_points(parse_machine(content), seed, count, dwell_s=1.0)


def _draw_effects(
    seed: int,
    names: tuple[str, ...],
    sizes_um: tuple[float, ...],
    content: dict[str, Any],
    program: Program,
) -> tuple[HiddenEffect, ...]:
    machine = parse_machine(content)
    motion = make_program_timeline(program, program.position[0], 0.0, Setting().limits)
    usual = replace(
        Occasion.usual(machine, 1.0),
        duration_s=motion.end_s,
        feed_mm_s=float(np.median(program.feed_mm_s)),
    )
    return tuple(
        draw(name, seed, replace(usual, size_um=size))
        for name, size in zip(names, sizes_um, strict=True)
    )


def _record(
    content: Mapping[str, Any],
    program: Program,
    seed: int,
    setting: Setting,
    hidden: tuple[HiddenEffect, ...],
    mode: str,
) -> Recording:
    for effect in hidden:
        if isinstance(effect, ThermalGrowth):
            setting = replace(setting, sensors=effect.has_sensor)
    return synthetic.record(
        content, program, seed, mode, replace(setting, hidden=hidden)
    )


def _measure_signal(
    recording: Recording, setting: Setting, seed: int
) -> tuple[float, ...]:
    """Return the ideal test's signal-to-noise ratio of each effect."""
    if not recording.hidden:
        return ()
    quiet = replace(setting, noise_scale=0.0)
    alone = [
        _record(
            recording.content, recording.program, seed, quiet, effects, recording.mode
        )
        for effects in ((), *((effect,) for effect in recording.hidden))
    ]
    shifts = [one.position_mm - alone[0].position_mm for one in alone[1:]]
    return tuple(map(float, signal_to_noise(recording, shifts, setting.air)))
