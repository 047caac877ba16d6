"""Lines and circles of standards, measured at standstills, as files state them."""

from __future__ import annotations

from typing import Any

from truepath.app.results.circles_at_standstill import CircleFigures
from truepath.app.results.driven_figures import LineFigures


def line_json(one: LineFigures) -> dict[str, Any]:
    """Return an entry of `lines`."""
    return {
        "axes": one.axes,
        "standard": one.kind,
        "from": one.begin_mm.tolist(),
        "to": one.end_mm.tolist(),
        "runs": one.runs,
        "position_mm": one.position_mm.tolist(),
        "forward_um": one.forward_um.tolist(),
        "backward_um": one.backward_um.tolist(),
        "figures_um": one.figures_um,
        "uncertainty_um": one.uncertainty_um,
        "by_the_noise_alone_um": one.own_um,
        "predicted_um": one.predicted_um,
    }


def circle_json(one: CircleFigures) -> dict[str, Any]:
    """Return an entry of `circles`."""
    return {
        "plane": one.plane,
        "standard": "iso-230-4",
        "centre": one.centre_mm.tolist(),
        "radius_mm": one.radius_mm,
        "angle_deg": one.angle_deg.tolist(),
        "radial_um": one.radial_um.tolist(),
        "figures_um": one.figures_um,
        "uncertainty_um": one.uncertainty_um,
        "by_the_noise_alone_um": one.own_um,
        "predicted_um": one.predicted_um,
        "driven": "standstills on a polygon, in the senses that were commanded",
    }
