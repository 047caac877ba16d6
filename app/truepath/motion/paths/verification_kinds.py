"""Kinds of verification points."""

from __future__ import annotations

from enum import StrEnum


class VerificationKind(StrEnum):
    DIAGONALS = "diagonals"
    RANDOM_POINTS = "random-points"
    BIDIRECTIONAL = "bidirectional"
    CIRCLES = "circles"
    CIRCLES_IN_MOTION = "circles-in-motion"
