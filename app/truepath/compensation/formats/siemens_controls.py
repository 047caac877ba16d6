"""Limits of the controls of the SINUMERIK family."""

from __future__ import annotations

from dataclasses import dataclass

from truepath.compensation.formats.siemens_leadscrew import MEASURING_SYSTEMS


@dataclass(frozen=True, slots=True)
class Control:
    """Numbers of points and tables of a control.

    note : source of the numbers
    measuring_systems : that an axis may have
    """

    title: str
    leadscrew_points: int
    cross_points: int
    cross_tables: int
    note: str
    measuring_systems: frozenset[str] = frozenset(MEASURING_SYSTEMS)


CONTROLS = {
    "840d-sl": Control("840D sl", 1000, 500, 62, "MD38000 and MD18342 size the tables"),
    "828d": Control(
        "828D", 200, 200, 8, "8 cross tables of 200 points, fixed; MD38000 the others"
    ),
    "808d": Control(
        "808D",
        200,
        200,
        8,
        "no public text at hand states its limits: those of the 828D are taken; "
        "compare MD38000 and MD18342 before loading",
        frozenset({"1"}),  # function manual 01/2017, page 106
    ),
}
DEFAULT_CONTROL = "840d-sl"
