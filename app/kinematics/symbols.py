"""Symbols of ISO 230-1 and what they mean.

An error motion is `E`, the direction (X, Y, Z for a displacement, A, B, C for a turn
about X, Y, Z), then the axis that moves: EYX is the straightness of X in Y, ECX its
yaw. The squareness of two axes is the turn, a zero, and the axis that is out of square
to its reference: C0Y, B0Z, A0Z. Readers accept the letter O for the zero.
"""

from __future__ import annotations

LINEAR = ("X", "Y", "Z")
TURNS = ("A", "B", "C")
DIRECTION = {
    **{d: i for i, d in enumerate(LINEAR)},
    **{d: i for i, d in enumerate(TURNS)},
}
SQUARENESS = ("C0Y", "B0Z", "A0Z")


def error_motions(axis: str) -> tuple[str, ...]:
    """Return the six symbols of an axis, displacements first."""
    return tuple(f"E{d}{axis}" for d in LINEAR + TURNS)


def is_turn(symbol: str) -> bool:
    """Tell whether an error motion is an angle."""
    return symbol[1] in TURNS


def is_positioning(symbol: str) -> bool:
    """Tell whether an error motion is along its own axis."""
    return symbol[1] == symbol[2]


def is_straightness(symbol: str) -> bool:
    """Tell whether an error motion is a displacement across its own axis."""
    return not is_turn(symbol) and not is_positioning(symbol)


def unit(symbol: str) -> str:
    """Return the unit in which files state the symbol."""
    return "urad" if symbol in SQUARENESS or is_turn(symbol) else "um"


def meaning(symbol: str) -> str:
    """Return the symbol's name in words."""
    if symbol in SQUARENESS:
        axes = {"C0Y": "Y to X", "B0Z": "Z to X", "A0Z": "Z to Y"}
        return f"squareness of {axes[symbol]}"
    direction, axis = symbol[1], symbol[2]
    if is_positioning(symbol):
        return f"positioning of {axis}"
    if not is_turn(symbol):
        return f"straightness of {axis} in {direction}"
    if TURNS.index(direction) == LINEAR.index(axis):
        return f"roll of {axis}"
    return f"turn of {axis} about {LINEAR[TURNS.index(direction)]}"
