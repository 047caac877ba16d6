"""Texts, names and numbers in one language, from one table of all languages.

Names of error motions and sentences of verdicts are those of the operator page, names
of effects the catalogue's: each is defined once.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Literal

from truepath.answers.shown.page import format_expanded, format_number
from truepath.errors import BadInput, TruepathError
from truepath.files.earlier.verdict import Reason
from truepath.kinematics.effects.family import find_family
from truepath.kinematics.machine.symbols import (
    LINEAR,
    SQUARENESS,
    TURNS,
    is_location,
    is_positioning,
    is_turn,
)

LANGUAGES = ("en", "de")
LanguageCode = Literal["en", "de"]
_POINT = re.compile(r"(?<=\d)\.(?=\d)")
_MINUS = re.compile(r"(?<!\S)-(?=\d)")
_SQUARE = {"C0Y": ("Y", "X"), "B0Z": ("Z", "X"), "A0Z": ("Z", "Y")}


@dataclass(frozen=True, slots=True)
class Language:
    """Texts and number format of one language.

    own : texts of the certificate; shared : those of the operator page
    """

    code: str
    own: Mapping[str, str]
    shared: Mapping[str, str]

    def text(self, key: str, **values: object) -> str:
        """The text of a key of `own`, with values in place. Raises KeyError."""
        return self.own[key].format(**values)

    def number(self, value: float, decimals: int = 1) -> str:
        """With the language's decimal mark and a true minus sign."""
        return self.localise_numbers(format_number(value, decimals))

    def expanded(self, value: float, standard: float) -> str:
        """`value ± U`, k = 2; `standard` is the standard uncertainty."""
        return self.localise_numbers(format_expanded(value, standard))

    def count(self, value: int) -> str:
        """In groups of three digits, with narrow spaces."""
        return f"{value:,}".replace(",", "\u202f")

    def localise_numbers(self, text: str) -> str:
        """With decimal mark and minus sign of the language in all numbers."""
        return _MINUS.sub("−", _POINT.sub(self.decimal_mark, text))

    @property
    def decimal_mark(self) -> str:
        """Comma or point."""
        return "," if self.code == "de" else "."

    def day(self, value: date) -> str:
        """`29.11.2026` in German, else ISO 8601."""
        return f"{value:%d.%m.%Y}" if self.code == "de" else value.isoformat()

    def name_symbol(self, symbol: str) -> str:
        """Name of an error motion, squareness or location of ISO 230-1."""
        if symbol in SQUARENESS:
            axis, other = _SQUARE[symbol]
            return self._share("error.squareness", axis=axis, other=other)
        if is_location(symbol):
            return self._name_location(symbol)
        motion, axis = symbol[1], symbol[2]
        if is_positioning(symbol):
            turning = "angular_" if axis in TURNS else ""
            return self._share(f"error.{turning}positioning", axis=axis)
        if not is_turn(symbol):
            kind = "shift" if axis in TURNS else "straightness"
            return self._share(f"error.{kind}", axis=axis, along=motion)
        about = LINEAR[TURNS.index(motion)]
        kind = "roll" if about == axis else "tilt"
        return self._share(f"error.{kind}", axis=axis, about=about)

    def name_effect(self, name: str) -> str:
        """The catalogue's title of an effect; its key if it is unknown."""
        try:
            words = find_family(name).words
        except TruepathError:
            return name
        return words[self.code if self.code in words else "en"].title

    def describe_reason(self, reason: Reason) -> str:
        """A verdict's reason and remedy; English without a translation."""
        text = self.shared.get(f"verdict.{reason.kind}")
        if text is None:
            return f"{reason} {reason.remedy}".strip()
        shown = reason.shown
        if kind := shown.get("why_kind"):
            shown["why"] = self.shared.get(f"verdict.why.{kind}", shown["why"])
        said = text.format(**{k: self.localise_numbers(v) for k, v in shown.items()})
        run = f"{self.shared['verdict.run'].format(run=reason.run)} "
        remedy = self.shared.get(f"verdict.{reason.kind}_remedy", "")
        return f"{run if reason.run else ''}{said} {remedy}".strip()

    def _name_location(self, symbol: str) -> str:
        letter, axis = symbol[0], symbol[2]
        if letter in LINEAR:
            return self.text("error_location_shift", axis=axis, along=letter)
        about = LINEAR[TURNS.index(letter)]
        return self.text("error_location_tilt", axis=axis, about=about)

    def _share(self, key: str, **values: str) -> str:
        return self.shared[key].format(**values)


@cache
def load_language(code: str) -> Language:
    """Raises BadInput for an unknown language."""
    if code not in LANGUAGES:
        raise BadInput(f"language {code!r}: write one of {', '.join(LANGUAGES)}")
    table = tomllib.loads((Path(__file__).parent / "texts.toml").read_text("utf-8"))
    page = files("truepath.service.page") / "static" / "locales" / f"{code}.json"
    own = {key: texts[code] for key, texts in table.items()}
    return Language(code, own, json.loads(page.read_text("utf-8")))
