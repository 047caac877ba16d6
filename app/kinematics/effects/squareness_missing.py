"""A squareness that the model in use has left out, or that has changed since."""

from __future__ import annotations

from collections.abc import Sequence

from app.kinematics.conditions import Conditions
from app.kinematics.effects.catalogue import (
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    Words,
)
from app.kinematics.effects.keys import SYMBOL
from app.kinematics.effects.squareness import Squareness, list_squarenesses

_USUAL_RAD = 2e-5


class SquarenessFamily(Family):
    """One candidate a pair of straight axes.

    The rigid-body model has all of them and leaves nothing to find.
    """

    name = "squareness"
    is_rigid_body = True
    makes = Squareness
    keys = {"symbol": SYMBOL}
    words = {
        "en": Words(
            title="Squareness",
            cause="Two axes are not square to each other: as assembled, after a "
            "crash, or because the machine was levelled anew.",
            looks_like="Lines across the plane of the two axes lean in proportion to "
            "the travel of one of them; face diagonals differ in length.",
            remedy="Enter the angle as squareness compensation; check levelling and "
            "the joint between the two axes.",
        ),
        "de": Words(
            title="Rechtwinkligkeit",
            cause="Zwei Achsen stehen nicht rechtwinklig zueinander: seit der "
            "Montage, nach einem Aufprall oder weil die Maschine neu nivelliert "
            "wurde.",
            looks_like="Geraden quer durch die Ebene der beiden Achsen neigen sich im "
            "Verhältnis zum Weg der einen; die Diagonalen der Ebene sind verschieden "
            "lang.",
            remedy="Den Winkel als Rechtwinkligkeitskompensation eintragen; "
            "Nivellierung und Verbindung der beiden Achsen prüfen.",
        ),
    }

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a pair of axes."""
        names = tuple(axis.name for axis in at.machine.linear_axes)
        return [self.offer(s, [_USUAL_RAD]) for s in list_squarenesses(names)]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return the angle."""
        return {"value_urad": found.parameters[0].scale(1e6)}
