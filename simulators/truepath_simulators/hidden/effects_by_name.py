"""Effects by name, sampled by seed, and as text for other processes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden import drives, setup, structure
from truepath_simulators.hidden.effect import HiddenEffect, Occasion
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.randomness import generator
from truepath_simulators.timeline import standing

EFFECTS: dict[str, type[HiddenEffect]] = {
    kind.name: kind
    for kind in (
        drives.Backlash,
        drives.LateralBacklash,
        drives.ScrewCyclic,
        structure.ThermalGrowth,
        setup.TableDrift,
        structure.ElasticSag,
        structure.Squareness,
        drives.ServoMismatch,
        drives.ReversalSpike,
        setup.TrackerEccentricity,
        setup.TrackerRangeOffset,
        drives.Vibration,
        setup.SetupStep,
        structure.SpindleGrowth,
        structure.CoolantCycle,
        structure.WavyGuide,
        structure.Twist,
        structure.FloatingSlide,
        structure.LeaningColumn,
        setup.SettlingStand,
        setup.WarmPlume,
        drives.WornScrew,
        setup.LooseNest,
        drives.InertialBend,
        setup.RangeCycle,
    )
}
CATALOGUED = tuple(
    n for n, kind in EFFECTS.items() if kind.in_catalogue and not kind.needs_model
)
UNCATALOGUED = tuple(
    n
    for n, kind in EFFECTS.items()
    if not kind.in_catalogue and not kind.on_ramps_alone
)
GROUP = "truepath.hidden_effects"  # of the entry points: effects of others, by name
_TYPICAL_UM = 4.0
_AT_REST = np.zeros(1)


def draw(name: str, seed: int, occasion: Occasion) -> HiddenEffect:
    """Random effect of a name; raises SimulatorError listing the known names."""
    rng = generator(seed, f"hidden: {name}")
    return _kind(name).draw(rng, occasion)


def parse_hidden(text: str, seed: int, machine: MachineFile) -> HiddenEffect:
    """Effect from a text.

    `name[*size_um]` samples one for a recording of typical length; a JSON object,
    `{"name": "backlash", "axis": "X", "width_um": 8}`, gives its numbers.

    Raises SimulatorError on an unknown name, a size that is no number, or numbers that
    the machine cannot have.
    """
    if text.lstrip().startswith("{"):
        return _try_effect(text, machine)
    name, _, size = text.partition("*")
    try:
        size_um = float(size or _TYPICAL_UM)
    except ValueError as error:
        raise SimulatorError(f"hidden: {text!r} is not name*size_um") from error
    return draw(name, seed, Occasion.usual(machine, size_um))


def as_json(effect: HiddenEffect) -> dict[str, Any]:
    return {"name": effect.name, **asdict(effect)}


def from_json(content: Mapping[str, Any]) -> HiddenEffect:
    """From the content of `as_json`; raises SimulatorError on an invalid one."""
    values = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in content.items()
        if key != "name"
    }
    try:
        return _kind(str(content.get("name"))).__call__(**values)
    except TypeError as error:
        raise SimulatorError(f"hidden: {content.get('name')}: {error}") from error


def _try_effect(text: str, machine: MachineFile) -> HiddenEffect:
    """Proven by moving the machine at rest."""
    try:
        content = json.loads(text)
    except ValueError as error:
        raise SimulatorError(f"hidden: {text}: not JSON: {error}") from error
    effect = from_json(content)
    motion = Motion(machine, standing(machine.low, 0.0, 0))
    try:
        moved = effect.added_error_motions(motion, _AT_REST)
        _ = (
            effect.common_shift_mm(motion, _AT_REST),
            effect.reading_error(np.ones((1, 3))),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise SimulatorError(
            f"hidden: {text}: machine {machine.name} cannot have it: {error}"
        ) from error
    strangers = sorted(set(moved) - set(machine.axis_names))
    if strangers:
        raise SimulatorError(f"hidden: {text}: the machine has no axis {strangers[0]}")
    return effect


def _kind(name: str) -> type[HiddenEffect]:
    if name in EFFECTS:
        return EFFECTS[name]
    for point in entry_points(group=GROUP, name=name):
        kind: type[HiddenEffect] = point.load()
        return kind
    raise SimulatorError(f"hidden: no effect {name!r}; there are {list_names()}")


def list_names() -> list[str]:
    """Ours, then those of other distributions."""
    return [*EFFECTS, *sorted(entry_points(group=GROUP).names)]
