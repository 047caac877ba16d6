"""Symbols of ISO 230-1 and their meaning.

An error motion is `E`, the direction (X, Y, Z for a displacement, A, B, C for a turn
about X, Y, Z), then the axis that moves: EYX is the straightness of X in Y, ECX its
yaw. The squareness of two axes is the turn, a zero, and the axis that is out of square
to its reference: C0Y, B0Z, A0Z. The location of a rotary axis is the direction, the
letter O and the axis: XOC, YOC, AOC, BOC. Readers of squareness accept the letter O for
the zero.
"""

from __future__ import annotations

LINEAR = ("X", "Y", "Z")
TURNS = ("A", "B", "C")
DIRECTION = {d: i for letters in (LINEAR, TURNS) for i, d in enumerate(letters)}
SQUARENESS = ("C0Y", "B0Z", "A0Z")


def list_locations(axis: str) -> tuple[str, ...]:
    """Shifts first: XOC, YOC, AOC, BOC."""
    own = TURNS.index(axis)
    return tuple(
        f"{g[i]}O{axis}" for g in (LINEAR, TURNS) for i in range(3) if i != own
    )


def is_location(symbol: str) -> bool:
    """Location of a rotary axis, such as XOC."""
    return symbol[1] == "O" and symbol[2] in TURNS


def list_error_motions(axis: str) -> tuple[str, ...]:
    """Six symbols, displacements first: EXX, EYX, … ECX."""
    return tuple(f"E{d}{axis}" for d in LINEAR + TURNS)


def is_turn(symbol: str) -> bool:
    """An angle: its second letter is A, B or C."""
    return symbol[1] in TURNS


def is_positioning(symbol: str) -> bool:
    """Along, or about, its own axis."""
    return DIRECTION[symbol[1]] == DIRECTION[symbol[2]] and (
        is_turn(symbol) == (symbol[2] in TURNS)
    )


def is_straightness(symbol: str) -> bool:
    """A displacement across its own axis."""
    return not is_turn(symbol) and not is_positioning(symbol)


def find_unit(symbol: str) -> str:
    """`um` or `urad`, as in files."""
    kind = symbol[0 if is_location(symbol) else 1]
    return "urad" if symbol in SQUARENESS or kind in TURNS else "um"


def describe_symbol(symbol: str) -> str:
    """The symbol in words: `straightness of X in Y`."""
    if symbol in SQUARENESS:
        axes = {"C0Y": "Y to X", "B0Z": "Z to X", "A0Z": "Z to Y"}
        return f"squareness of {axes[symbol]}"
    if is_location(symbol):
        letter, axis = symbol[0], symbol[2]
        if letter in LINEAR:
            return f"shift of the axis of {axis} in {letter}"
        return f"tilt of the axis of {axis} about {LINEAR[TURNS.index(letter)]}"
    direction, axis = symbol[1], symbol[2]
    if axis in TURNS:
        return _meaning_of_turning(symbol)
    if is_positioning(symbol):
        return f"positioning of {axis}"
    if not is_turn(symbol):
        return f"straightness of {axis} in {direction}"
    if TURNS.index(direction) == LINEAR.index(axis):
        return f"roll of {axis}"
    return f"turn of {axis} about {LINEAR[TURNS.index(direction)]}"


def _meaning_of_turning(symbol: str) -> str:
    direction, axis = symbol[1], symbol[2]
    along = DIRECTION[direction] == DIRECTION[axis]
    if is_turn(symbol):
        about = LINEAR[TURNS.index(direction)]
        return f"positioning of {axis}" if along else f"tilt of {axis} about {about}"
    return f"{'axial' if along else 'radial'} motion of {axis} in {direction}"
