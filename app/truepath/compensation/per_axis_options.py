"""Choices of a format that may differ from axis to axis: `2`, or `X=1,Y=2`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from truepath.errors import BadInput
from truepath.kinematics.machine.symbols import LINEAR, TURNS

_PART = re.compile(rf"([{''.join(LINEAR + TURNS)}])=([^,=]+)")


def split_by_axis(word: str, known: Sequence[str]) -> dict[str, str]:
    """Words of a choice by axis; empty for a choice of one word for all axes.

    known : possible words for an axis

    Raises BadInput for another form, an axis twice, or an unknown word.
    """
    if "=" not in word:
        return {}
    chosen: dict[str, str] = {}
    for part in word.split(","):
        found = _PART.fullmatch(part)
        if found is None or found.group(1) in chosen or found.group(2) not in known:
            raise BadInput(
                f"{word!r}: {part!r} is no choice of one axis more; write each axis "
                f"once, with one of {', '.join(known)}, as X={known[0]},Y={known[-1]}"
            )
        chosen[found.group(1)] = found.group(2)
    return chosen
