"""The texts of the page, one JSON file a language."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from functools import cache
from importlib.resources import files

from app.kinematics.effects.catalogue import list_families

LANGUAGES = ("en", "de")
DEFAULT_LANGUAGE = "en"


def catalogue(language: str) -> dict[str, str]:
    """Return the texts of one of `LANGUAGES` by key, those of effects among them."""
    if language not in LANGUAGES:
        raise KeyError(language)
    return _read_texts(language) | _effect_texts(language)


@cache
def _read_texts(language: str) -> dict[str, str]:
    path = files("app.web") / "static" / "locales" / f"{language}.json"
    return json.loads(path.read_text(encoding="utf-8"))


def _effect_texts(language: str) -> dict[str, str]:
    """Return the words of all installed effects that have them in the language.

    A discovery comes with the English sentences; only others are needed here.
    """
    texts: dict[str, str] = {}
    for family in list_families():
        if words := family.words.get(language):
            key = f"effect.{family.name}"
            texts[key] = words.title
            if language != DEFAULT_LANGUAGE:
                sentences = {f"{key}.{k}": text for k, text in asdict(words).items()}
                texts |= {k: s for k, s in sentences.items() if k != f"{key}.title"}
    return texts


def choose_language(remembered: str | None, accepted: str | None) -> str:
    """Choose a language: the one the operator set, else the browser's, else English.

    accepted : an Accept-Language header
    """
    wanted = [remembered or "", *_sort_by_preference(accepted or "")]
    known = (tag.split("-")[0].lower() for tag in wanted)
    return next((tag for tag in known if tag in LANGUAGES), DEFAULT_LANGUAGE)


def _sort_by_preference(header: str) -> Iterable[str]:
    tags = [_parse_weight(part) for part in header.split(",") if part.strip()]
    return (tag for _, tag in sorted(tags, key=lambda pair: -pair[0]))


def _parse_weight(part: str) -> tuple[float, str]:
    tag, _, parameter = part.strip().partition(";")
    weight = parameter.strip().removeprefix("q=")
    try:
        return float(weight or 1.0), tag.strip()
    except ValueError:
        return 0.0, tag.strip()
