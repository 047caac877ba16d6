"""Units in the words of makers' software."""

from __future__ import annotations

_WORDS = {
    "mm": "mm millimeter millimetre millimeters millimetres milimetros",
    "m": "m meter metre meters metres metros metri",
    "um": "um µm μm micron microns micrometer micrometre mikrometer",
    "cm": "cm centimeter centimetre zentimeter",
    "inch": "inch in inches zoll pouce pouces pulgada pulgadas",
    "ft": "ft foot feet",
    "s": "s sec second seconds sekunden secondes segundos",
    "ms": "ms msec milliseconds millisekunden",
    "us": "us usec microseconds µs μs",
    "degC": "degc °c c celsius",
    "degF": "degf °f f fahrenheit",
    "deg": "deg ° degree degrees grad",
    "gon": "gon",
    "rad": "rad radian radians",
}
_UNIT = {word: unit for unit, words in _WORDS.items() for word in words.split()}
LENGTH_MM = {"mm": 1.0, "m": 1e3, "inch": 25.4, "um": 1e-3, "cm": 10.0, "ft": 304.8}
ANGLES = frozenset(("deg", "gon", "rad"))


def find_unit(word: str) -> str:
    """Empty for another word."""
    return _UNIT.get(word.strip().lower(), "")
