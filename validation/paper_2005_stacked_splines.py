"""brunn-hanebeck-2005, Figures 6 and 7: three stacked axes seen as one height.

Noise variance 0.0001. Configurations are optima over all three axes (eq. 34–37), found
by exact search along one axis after another and checked against a dense search.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from stochastic_splines import bending, draw, independent, learnt, sigma, stack

from truepath.kinematics.splines import natural_spline
from truepath.numerics.design_criteria import IntegratedVariance
from truepath.planning.next_configuration import SearchSpace, next_configuration

AXES, POINTS = 3, 7
STARTS = 24  # summits are many once little is left to learn
KNOTS = np.linspace(0.0, 1.0, POINTS)
SPLINE = natural_spline(KNOTS)
VARIANCE = 1e-4
MEASUREMENTS, DRAWS, SHOWN, PAPER_STOPS = 30, 4000, 1, 5
PRIORS = {"independent control points": independent, "bending": bending}
FINE = np.linspace(0.0, 1.0, 121)
TICKS = 41


@dataclass
class Course:
    """A measurement procedure on many drawn machines; one entry a measurement."""

    beliefs: list[IntegratedVariance]
    positions: list[np.ndarray]
    truth: np.ndarray
    estimates: list[np.ndarray]
    shortfall: float

    def variance(self) -> np.ndarray:
        return np.array([b.integrated_variance for b in self.beliefs])

    def compute_squared_error(self) -> np.ndarray:
        """Return ∫ (estimate − truth)², summed over axes, each number and draw."""
        off = np.array(self.estimates) - self.truth
        return np.einsum("mdp,pq,mdq->md", off, self.beliefs[0].gram, off)


def height(position: np.ndarray) -> np.ndarray:
    """Return rows of the height: the three splines add up."""
    return np.hstack([SPLINE.basis(position[:, k]) for k in range(AXES)])


def procedure(prior) -> Course:
    """Measure, always at the configuration that helps most."""
    rng = np.random.default_rng(2006)
    belief = stack([prior(SPLINE)] * AXES)
    truth = draw(belief, rng, DRAWS)
    course = Course([belief], [], truth, [np.zeros_like(truth)], 0.0)
    axes = SearchSpace((KNOTS,) * AXES, (3,) * AXES)
    for number in range(MEASUREMENTS):
        best = next_configuration(
            belief, height, axes, VARIANCE, starts=STARTS, seed=number
        )
        dense = float(belief.compute_drops(_dense_rows(), VARIANCE).max())
        row = height(best.position[None])[0]
        measured = truth @ row + np.sqrt(VARIANCE) * rng.standard_normal(DRAWS)
        estimate = learnt(belief, course.estimates[-1], row, VARIANCE, measured)
        belief = belief.update(row, VARIANCE)
        course.beliefs.append(belief)
        course.positions.append(best.position)
        course.estimates.append(estimate)
        course.shortfall = max(course.shortfall, 1.0 - best.drop / dense)
    return course


def unseen_variance(belief: IntegratedVariance) -> float:
    """Return the J that no height ever tells: constants that the axes trade."""
    sums = np.kron(np.eye(AXES), np.ones((POINTS, 1)))
    difference = sums @ np.linalg.svd(np.ones((1, AXES)))[2][1:].T
    precision = np.linalg.inv(belief.covariance)
    left = np.linalg.inv(difference.T @ precision @ difference)
    return float(np.trace(belief.gram @ difference @ left @ difference.T))


def main() -> None:
    courses = {name: procedure(prior) for name, prior in PRIORS.items()}
    for name, course in courses.items():
        _figure_7(name, course)
    _figure_of_course(courses)
    write_section("stacked-splines", _table(courses))


def _dense_rows() -> np.ndarray:
    tick = np.linspace(0.0, 1.0, TICKS)
    grid = np.meshgrid(*[tick] * AXES)
    return height(np.stack([g.ravel() for g in grid], axis=1))


def _table(courses: dict[str, Course]) -> str:
    rows = []
    for name, course in courses.items():
        left, error = course.variance(), course.compute_squared_error().mean(axis=1)
        floor = unseen_variance(course.beliefs[0])
        told = (left - floor) / (left[0] - floor)
        rows.append(
            [
                name,
                f"{left[0]:.2f}",
                f"{left[5]:.2f}",
                f"{left[19]:.2f}",
                f"{left[30]:.2f}",
                f"{floor:.2f}",
                f"{told[5]:.0%}",
                f"{told[19]:.2%}",
                f"{error[30] / left[30]:.2f}",
                f"{max(course.shortfall, 0.0):.0e}",
            ]
        )
    head = [
        "prior",
        "J before",
        "after 5",
        "after 19",
        "after 30",
        "never seen",
        "left of the rest after 5",
        "after 19",
        "mean squared error / J after 30",
        "short of a dense search",
    ]
    return table(head, rows)


def _figure_7(name: str, course: Course) -> None:
    rows = SPLINE.basis(FINE)
    figure, panels = plt.subplots(2, AXES, figsize=(9.0, 4.4), sharex=True, sharey=True)
    for line, count in zip(panels, (PAPER_STOPS, MEASUREMENTS), strict=True):
        for axis, panel in enumerate(line):
            part = slice(axis * POINTS, (axis + 1) * POINTS)
            belief = course.beliefs[count]
            spread = 2.0 * sigma(
                IntegratedVariance(belief.covariance[part, part], SPLINE.gram()), rows
            )
            estimate = course.estimates[count][SHOWN, part]
            middle = rows @ estimate
            panel.fill_between(
                FINE, middle - spread, middle + spread, color=figures.OURS, alpha=0.15
            )
            true = rows @ course.truth[SHOWN, part]
            panel.plot(FINE, true, color=figures.TRUTH, lw=2)
            panel.plot(FINE, middle, color=figures.OURS, lw=1)
            panel.plot(KNOTS, estimate, "x", color=figures.OURS, ms=4)
            places = [p[axis] for p in course.positions[:count]]
            low = panel.get_ylim()[0]
            panel.plot(places, np.full(count, low), "o", color=figures.DATA, ms=4)
            panel.set_title(f"t{axis + 1}, {count} measured", fontsize=9)
    figure.supxlabel(f"{name}; circles: places measured; band: ± 2σ", fontsize=9)
    figure.tight_layout()
    figures.save(figure, f"2005-figure-7-{name.split()[0]}.svg")


def _figure_of_course(courses: dict[str, Course]) -> None:
    figure, panel = plt.subplots(figsize=(6.0, 2.8))
    count = np.arange(MEASUREMENTS + 1)
    for (name, course), color in zip(
        courses.items(), (figures.PAPER, figures.OURS), strict=True
    ):
        panel.plot(count, course.variance(), "-", color=color, label=f"J, {name}")
        error = course.compute_squared_error().mean(axis=1)
        panel.plot(count, error, "--", color=color, label="mean ∫ error²")
        floor = unseen_variance(course.beliefs[0])
        panel.axhline(floor, color=color, lw=0.6)
    panel.set_xlabel("measurements")
    panel.set_ylim(bottom=0.0)
    panel.legend(fontsize=8)
    figure.tight_layout()
    figures.save(figure, "2005-stacked-course.svg")


if __name__ == "__main__":
    main()
