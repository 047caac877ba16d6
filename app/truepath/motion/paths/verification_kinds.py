"""Kinds of verification points."""

from __future__ import annotations

from enum import StrEnum


class VerificationKind(StrEnum):
    """What points of a verification lie on."""

    DIAGONALS = "diagonals"
    RANDOM_POINTS = "random-points"
    BIDIRECTIONAL = "bidirectional"
    CIRCLES = "circles"
    CIRCLES_IN_MOTION = "circles-in-motion"
