"""What discovery says of a world, compared with what was hidden in it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from hidden_worlds import World
from recordings import run_of

from truepath.answers.discovery_json import discovery_json
from truepath.discovery.discover import discover
from truepath.errors import EstimationError

NOTHING, UNNAMED = "nothing", "unnamed"
_REFUSED = {
    "effects": [{"name": "refused", "parameters": {}}],
    "unnamed": [],
    "possible": [],
    "gap": dict.fromkeys(("before", "after", "noise_floor"), float("nan")),
}
_KEYS = ("axis", "motion", "by", "direction", "circle")


@dataclass(frozen=True)
class Outcome:
    """One world and what was said of it.

    truth, said : names with their keys; possible : that stand beside, not said;
        unnamed : what was described without a name
    matched : for each true effect the said one that is it, or empty
    wrong : names that were said and are not there
    deviation : error of each parameter of a rightly named effect in units of its
        uncertainty, by effect and parameter
    gap_um : before, after, noise floor
    """

    seed: int
    kind: str
    catalogued: bool
    size_um: tuple[float, ...]
    signal_to_noise: tuple[float, ...]
    truth: tuple[str, ...]
    said: tuple[str, ...]
    unnamed: tuple[str, ...]
    possible: tuple[str, ...]
    matched: tuple[str, ...]
    wrong: tuple[str, ...]
    deviation: dict[str, float]
    gap_um: tuple[float, float, float]
    took_s: float

    @property
    def right(self) -> bool:
        """Whether all that is in the catalogue was named, and nothing else."""
        wanted = len(self.truth) if self.catalogued else 0
        clean = not self.truth and self.describes
        return sum(map(bool, self.matched)) == wanted and not self.wrong and not clean

    @property
    def describes(self) -> bool:
        """Whether something is said without a name that is sure."""
        return bool(self.unnamed or self.possible)

    @property
    def closed(self) -> float:
        """The gap after over the noise floor."""
        return self.gap_um[1] / self.gap_um[2]


def assess_discovery(world: World) -> Outcome:
    """Run discovery on the Run of a world and judge its answer.

    Every world can be fitted: where discovery says otherwise, that is a wrong answer.
    """
    begin = time.perf_counter()
    try:
        content = discovery_json(discover([run_of(world.recording)]))
    except EstimationError:
        content = _REFUSED
    return judge(world, content, time.perf_counter() - begin)


def judge(world: World, content: Mapping[str, Any], took_s: float) -> Outcome:
    """Compare a `discovery.json` with a world.

    A name is right if it and its keys are the truth, or the truth is among what it
    says is indistinguishable from it.
    """
    truth, said = world.truth, list(content["effects"])
    matched = [_find_match(effect, said) for effect in truth]
    named = [effect for effect in said if any(effect is m for m in matched)]
    again = [e for e in said if any(is_same(t, e) for t in truth)]
    deviation: dict[str, float] = {}
    for effect, match in zip(truth, matched, strict=True):
        if match is not None and is_same(effect, match):
            deviation |= measure_deviations(effect, match)
    gap = content["gap"]
    return Outcome(
        world.seed,
        world.kind,
        world.is_catalogued,
        world.size_um,
        world.signal_to_noise,
        tuple(map(label, truth)),
        tuple(map(label, said)),
        tuple(str(e["description"]) for e in content["unnamed"]),
        tuple(map(label, content["possible"])),
        tuple("" if m is None else label(m) for m in matched),
        tuple(label(e) for e in said if e not in named and e not in again),
        deviation,
        (gap["before"], gap["after"], gap["noise_floor"]),
        took_s,
    )


def label(effect: Mapping[str, Any]) -> str:
    keys = [str(effect[key]) for key in _KEYS if key in effect]
    return " ".join([str(effect["name"]), *keys])


def is_same(truth: Mapping[str, Any], said: Mapping[str, Any]) -> bool:
    """Tell whether name and every key of the truth are those said."""
    return all(said.get(k) == truth[k] for k in ("name", *_KEYS) if k in truth)


def _find_match(
    truth: Mapping[str, Any], said: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any] | None:
    """Return the effect that says the truth, by its name before by its equivalents."""
    for effect in said:
        if is_same(truth, effect):
            return effect
    for effect in said:
        others = effect.get("indistinguishable_from", [])
        if any(is_same(truth, other) for other in others):
            return effect
    return None


def measure_deviations(
    truth: Mapping[str, Any], said: Mapping[str, Any]
) -> dict[str, float]:
    """Return found minus true in units of the uncertainty, by effect and parameter.

    Angles are compared on their circle.
    """
    found: dict[str, float] = {}
    for name, entry in truth["parameters"].items():
        true = np.atleast_1d(entry["value"])
        stated = said["parameters"][name]
        off = np.atleast_1d(stated["value"]) - true
        if name.endswith("_rad"):
            off = (off + np.pi) % (2.0 * np.pi) - np.pi
        for k, number in enumerate(off / np.atleast_1d(stated["uncertainty"])):
            place = f" {k + 1}" if len(true) > 1 else ""
            found[f"{truth['name']} {name}{place}"] = float(number)
    return found


def as_row(result: Outcome) -> dict[str, Any]:
    """Return an outcome as the content of a line of JSON."""
    return asdict(result)


def from_row(row: Mapping[str, Any]) -> Outcome:
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in row.items()
    }
    return Outcome(**values)
