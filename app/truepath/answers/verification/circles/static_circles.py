"""Circles of ISO 230-4 as polygons of standstills, in figures that noise is part of.

Of the radial deviations, G is the range about the circle of least squares in both
senses, F the largest and smallest about the commanded centre. At standstill, they show
geometry and lost motion, no servo.

Noise makes a range larger: of an exact machine it makes all of it. The value stated is
the middle of the interval that the noise allows for each figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.answers.shown.sampled_vectors import SampledVectors
from truepath.answers.verification.places.noise_bias import enclose_largest
from truepath.answers.verification.places.reduced_points import ReducedPoints
from truepath.files.units import UM_PER_MM

CIRCLE_FIGURES = ("G", "F_max", "F_min")
_SAME_MM, _SAME_CIRCLE_MM = 1e-3, 0.1
_FEWEST = 12


@dataclass(frozen=True, slots=True)
class CircleFigures:
    """A circle in figures, µm.

    plane : both axes; angle_deg, radial_um : (n,) of its positions, about the commanded
        centre
    figures, uncertainty_um : by name, k = 1; own_um : each figure of noise alone
    predicted_um : by name, from the result
    """

    plane: str
    centre_mm: Float64[np.ndarray, " a"]
    radius_mm: float
    angle_deg: Float64[np.ndarray, " n"]
    radial_um: Float64[np.ndarray, " n"]
    figures_um: dict[str, float]
    uncertainty_um: dict[str, float]
    own_um: dict[str, float]
    predicted_um: dict[str, float]


def find_circles(
    position: Float64[np.ndarray, "n a"],
) -> list[Int64[np.ndarray, " k"]]:
    """Rows of each circle, in both senses: equal chords that turn.

    Circles in different planes may share centre and radius, and are different circles.
    """
    found: list[tuple[Float64[np.ndarray, " c"], list[Int64[np.ndarray, " k"]]]] = []
    step = np.diff(position, axis=0)
    length = np.linalg.norm(step, axis=1)
    turn = np.einsum("ni,ni->n", step[1:], step[:-1]) / np.maximum(
        length[1:] * length[:-1], _SAME_MM**2
    )
    alike = np.abs(length[1:] - length[:-1]) < 10.0 * _SAME_MM
    rounds: Bool[np.ndarray, " m"] = alike & (turn > 0.0) & (turn < 1.0 - 1e-6)
    changes = np.diff(np.concatenate([[0], rounds.astype(np.int64), [0]]))
    begins, ends = np.flatnonzero(changes > 0), np.flatnonzero(changes < 0)
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        own: Int64[np.ndarray, " k"] = np.arange(first, last + 2)
        plane, centre_mm, radius = _fit_nominal(position[own])
        off = np.abs(np.linalg.norm(position[own] - centre_mm, axis=1) - radius)
        if len(own) >= _FEWEST and off.max() < 10.0 * _SAME_MM:
            circle = np.array([*plane, *centre_mm, radius])
            senses = _find_same(circle, found)
            if senses is None:
                found.append((circle, [own]))
            else:
                senses.append(own)
    return [np.concatenate(senses) for _, senses in found]


def _find_same(
    circle: Float64[np.ndarray, " c"],
    found: Sequence[tuple[Float64[np.ndarray, " c"], list[Int64[np.ndarray, " k"]]]],
) -> list[Int64[np.ndarray, " k"]] | None:
    for other, senses in found:
        if np.abs(other - circle).max() < _SAME_CIRCLE_MM:
            return senses
    return None


def evaluate_circle(
    position: Float64[np.ndarray, "n a"],
    own: Int64[np.ndarray, " k"],
    values: SampledVectors,
    predicted_mm: Float64[np.ndarray, "n 3"],
    places: ReducedPoints,
) -> CircleFigures:
    """Figures of the circle that positions lie on.

    own : which of n positions
    """
    plane, centre_mm, radius_mm = _fit_nominal(position[own])
    out = (position[own] - centre_mm)[:, plane] / radius_mm
    every = places.at.machine.axis_names
    names = "".join(every[int(k)] for k in plane)
    column = ["XYZ".index(name) for name in names]
    across = np.zeros((len(own), 3))
    across[:, column] = out
    seen = values.project(own, across)
    expected = UM_PER_MM * np.einsum("ni,ni->n", across, predicted_mm[own])
    raw = _compute_figures(seen.measured_um[:, None], out)
    by_error = _compute_figures(seen.error_um, out)
    largest = _find_largest_sigma(seen.error_um, out)
    model = _compute_figures(expected[:, None], out)
    stated = {
        name: _enclose(name, float(raw[name][0]), by_error[name], largest[name])
        for name in CIRCLE_FIGURES
    }
    return CircleFigures(
        names,
        centre_mm,
        radius_mm,
        np.degrees(np.arctan2(out[:, 1], out[:, 0])),
        seen.measured_um,
        {name: value for name, (value, _) in stated.items()},
        {name: uncertainty for name, (_, uncertainty) in stated.items()},
        {
            name: float(one.mean())
            for name, one in _compute_figures(seen.noise_um, out).items()
        },
        {name: float(value[0]) for name, value in model.items()},
    )


def _enclose(
    name: str, raw: float, by_error: Float64[np.ndarray, " e"], largest_sigma: float
) -> tuple[float, float]:
    """Middle of the interval of a figure, and a quarter of its width."""
    if name != "F_min":
        value, uncertainty = enclose_largest(raw, by_error, largest_sigma)
        # A range below 0 is 0: the interval about it still reaches as far up.
        return value if name[0] == "F" else max(value, 0.0), uncertainty
    # A smallest is less the largest of −m.
    value, uncertainty = enclose_largest(-raw, -by_error, largest_sigma)
    return -value, uncertainty


def _find_largest_sigma(
    error: Float64[np.ndarray, "n e"], out: Float64[np.ndarray, "n 2"]
) -> dict[str, float]:
    single = float(error.std(axis=1).max())
    apart = np.cov(_centre(error, out))
    own = np.diag(apart)
    pair = float(np.max(own[:, None] + own - 2.0 * apart))
    return {"G": max(pair, 0.0) ** 0.5, "F_max": single, "F_min": single}


def _compute_figures(
    radial: Float64[np.ndarray, "n e"], out: Float64[np.ndarray, "n 2"]
) -> dict[str, Float64[np.ndarray, " e"]]:
    return {
        "G": np.ptp(_centre(radial, out), axis=0),
        "F_max": radial.max(axis=0),
        "F_min": radial.min(axis=0),
    }


def _centre(
    radial: Float64[np.ndarray, "n e"], out: Float64[np.ndarray, "n 2"]
) -> Float64[np.ndarray, "n e"]:
    # Each angle counts once, however often the circle was begun and ended there.
    _, place, count = np.unique(
        np.round(out, 4), axis=0, return_inverse=True, return_counts=True
    )
    root = np.sqrt(1.0 / count[place.ravel()])[:, None]
    columns = np.column_stack([out, np.ones(len(out))])
    fit = np.linalg.pinv(root * columns) @ (root * radial)
    return radial - out @ fit[:2]


def _fit_nominal(
    position: Float64[np.ndarray, "n a"],
) -> tuple[Int64[np.ndarray, "2"], Float64[np.ndarray, " a"], float]:
    plane = np.sort(np.argsort(-np.ptp(position, axis=0))[:2])
    flat = position[:, plane]
    columns = np.column_stack([2.0 * flat, np.ones(len(flat))])
    fitted = np.linalg.pinv(columns) @ (flat**2).sum(axis=1)
    centre = position.mean(axis=0)
    centre[plane] = fitted[:2]
    return plane, centre, float(np.sqrt(fitted[2] + fitted[:2] @ fitted[:2]))
