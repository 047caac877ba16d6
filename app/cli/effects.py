"""Effects of the machine in a line each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_KEYS = ("name", "axis", "motion", "by", "plane", "symbol", "direction", "circle")


def describe_effect(effect: Mapping[str, Any]) -> str:
    """Return name, keys and numbers of an effect as `discovery.json` states it."""
    keys = [effect[key] for key in _KEYS if key in effect]
    numbers = [_describe_number(name, m) for name, m in effect["parameters"].items()]
    return f"{' '.join(keys)}: {', '.join(numbers)} (k = 2)"


def _describe_number(name: str, measured: Mapping[str, Any]) -> str:
    values, sigmas = measured["value"], measured["uncertainty"]
    if not isinstance(values, list):
        values, sigmas = [values], [sigmas]
    texts = [f"{v:.3g} ± {2.0 * s:.2g}" for v, s in zip(values, sigmas, strict=True)]
    return f"{name} {', '.join(texts)}"
