"""brunn-hanebeck-2005, Figures 4 and 5: one natural spline of seven control points.

Each measurement is made where it lowers the integrated variance most (eq. 27), noise
variance 0.01. Errors are means over drawn splines; the figure shows one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from stochastic_splines import bending, draw, independent, learnt, sigma

from truepath.kinematics.splines import natural_spline
from truepath.numerics.design_criteria import IntegratedVariance, find_best_position

KNOTS = np.linspace(0.0, 6.0, 7)
VARIANCE = 0.01
MEASUREMENTS, DRAWS, SHOWN = 16, 4000, 2
PRIORS = {"independent control points": independent, "bending": bending}
FINE = np.linspace(KNOTS[0], KNOTS[-1], 181)
DENSE = np.linspace(KNOTS[0], KNOTS[-1], 20_001)


@dataclass
class Course:
    """A measurement procedure on many drawn splines; one entry a measurement.

    shortfall : largest share by which the exact optimum lies below a dense search
    """

    beliefs: list[IntegratedVariance]
    places: list[float]
    truth: np.ndarray
    measured: list[np.ndarray]
    estimates: list[np.ndarray]
    shortfall: float

    def variance(self) -> np.ndarray:
        """Return J after 0, 1, 2, … measurements."""
        return np.array([b.integrated_variance for b in self.beliefs])

    def compute_squared_error(self) -> np.ndarray:
        """Return ∫ (estimate − truth)² for each number of measurements and draw."""
        off = np.array(self.estimates) - self.truth
        return np.einsum("mdp,pq,mdq->md", off, self.beliefs[0].gram, off)


def procedure(prior) -> Course:
    """Measure, always where it helps most."""
    rng = np.random.default_rng(2005)
    spline = natural_spline(KNOTS)
    belief = prior(spline)
    truth = draw(belief, rng, DRAWS)
    course = Course([belief], [], truth, [], [np.zeros_like(truth)], 0.0)
    for _ in range(MEASUREMENTS):
        best = find_best_position(belief, spline.basis, KNOTS, VARIANCE)
        dense = float(belief.compute_drops(spline.basis(DENSE), VARIANCE).max())
        row = spline.basis(np.array([best.at]))[0]
        noise = np.sqrt(VARIANCE) * rng.standard_normal(DRAWS)
        measured = truth @ row + noise
        estimate = learnt(belief, course.estimates[-1], row, VARIANCE, measured)
        belief = belief.update(row, VARIANCE)
        course.beliefs.append(belief)
        course.places.append(best.at)
        course.measured.append(measured)
        course.estimates.append(estimate)
        course.shortfall = max(course.shortfall, 1.0 - best.drop / dense)
    return course


def main() -> None:
    courses = {name: procedure(prior) for name, prior in PRIORS.items()}
    _figure_4(courses)
    _figure_5(courses)
    _figure_of_ripple(courses)
    write_section("single-spline", _table(courses))


def straightness_of_fall(variance: np.ndarray) -> float:
    """Return R² of a straight line through J after 0 to 7 measurements."""
    count = np.arange(8)
    return float(np.corrcoef(count, variance[:8])[0, 1] ** 2)


def ripple(belief: IntegratedVariance) -> float:
    """Return the lowest variance between control points over that at their sides."""
    spline = natural_spline(KNOTS)
    at_knots = sigma(belief, spline.basis(KNOTS)) ** 2
    ratios = []
    for left in range(len(KNOTS) - 1):
        inside = np.linspace(KNOTS[left], KNOTS[left + 1], 41)
        between = sigma(belief, spline.basis(inside)) ** 2
        ratios.append(between.min() / min(at_knots[left], at_knots[left + 1]))
    return float(min(ratios))


def _table(courses: dict[str, Course]) -> str:
    rows = []
    for name, course in courses.items():
        left = course.variance()
        error = course.compute_squared_error().mean(axis=1)
        rows.append(
            [
                name,
                f"{straightness_of_fall(left):.3f}",
                f"{(left[0] - left[7]) / left[0]:.1%}",
                f"{(left[6] - left[7]) / left[0]:.1%}",
                f"{(left[7] - left[8]) / left[0]:.2%}",
                f"{error[7] / left[7]:.2f}",
                f"{(course.squared_error()[7] < left[7]).mean():.0%}",
                f"{ripple(course.beliefs[0]):.2f}",
                f"{max(course.shortfall, 0.0):.0e}",
            ]
        )
    head = [
        "prior",
        "R² of a straight fall, 0–7",
        "J gone after 7",
        "by the 7th",
        "by the 8th",
        "mean squared error / J after 7",
        "splines inside J",
        "prior variance between / at control points",
        "short of a dense search",
    ]
    return table(head, rows)


def _figure_4(courses: dict[str, Course]) -> None:
    spline = natural_spline(KNOTS)
    rows = spline.basis(FINE)
    figure, panels = plt.subplots(2, 3, figsize=(9.0, 4.6), sharex=True, sharey=True)
    for line, (name, course) in zip(panels, courses.items(), strict=True):
        for panel, count in zip(line, (0, 3, 7), strict=True):
            estimate = course.estimates[count][SHOWN]
            spread = 2.0 * sigma(course.beliefs[count], rows)
            middle = rows @ estimate
            panel.fill_between(
                FINE, middle - spread, middle + spread, color=figures.OURS, alpha=0.15
            )
            panel.plot(FINE, rows @ course.truth[SHOWN], color=figures.TRUTH, lw=2)
            panel.plot(FINE, middle, color=figures.OURS, lw=1)
            panel.plot(KNOTS, estimate, "x", color=figures.OURS, ms=4)
            seen = [m[SHOWN] for m in course.measured[:count]]
            panel.plot(course.places[:count], seen, "o", color=figures.DATA, ms=4)
            panel.set_title(f"{name}, {count} measured", fontsize=9)
    figure.supxlabel("place (arbitrary units); band: ± 2σ", fontsize=9)
    figure.tight_layout()
    figures.save(figure, "2005-figure-4.svg")


def _figure_5(courses: dict[str, Course]) -> None:
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.0))
    for panel, (name, course) in zip(panels, courses.items(), strict=True):
        count = np.arange(MEASUREMENTS + 1)
        error = course.compute_squared_error()
        panel.plot(count, course.variance(), "o-", ms=3, color=figures.OURS, label="J")
        panel.plot(
            count, error.mean(axis=1), "--", color=figures.TRUTH, label="mean ∫ error²"
        )
        panel.plot(
            count, error[:, SHOWN], ":", color=figures.PAPER, label="the spline shown"
        )
        panel.axvline(7, color="black", lw=0.6)
        panel.set_title(name, fontsize=9)
        panel.set_xlabel("measurements")
        panel.legend(fontsize=8)
    figure.tight_layout()
    figures.save(figure, "2005-figure-5.svg")


def _figure_of_ripple(courses: dict[str, Course]) -> None:
    rows = natural_spline(KNOTS).basis(FINE)
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 2.6))
    for panel, count in zip(panels, (0, 7), strict=True):
        for (name, course), color in zip(
            courses.items(), (figures.PAPER, figures.OURS), strict=True
        ):
            variance = sigma(course.beliefs[count], rows) ** 2
            panel.plot(FINE, variance, color=color, label=name)
        panel.plot(KNOTS, np.zeros_like(KNOTS), "|", color="black", ms=8)
        panel.set_title(f"variance along the spline, {count} measured", fontsize=9)
        panel.set_ylim(bottom=0.0)
    panels[0].legend(fontsize=8)
    figure.tight_layout()
    figures.save(figure, "2005-variance-between-control-points.svg")


if __name__ == "__main__":
    main()
