"""The next place on one axis: the exact optimum against BoTorch's acquisition.

The same belief for both: a Gaussian process whose kernel is that of the splines, and
the same measurements. BoTorch minimises the integrated posterior variance, averaged
over equidistant places, from several starts. It is not needed for anything else:
`pip install botorch` into an environment of its own, with this project beside it.
"""

from __future__ import annotations

import time

import numpy as np

from truepath.kinematics.splines import CubicSpline, natural_spline
from truepath.numerics.design_criteria import IntegratedVariance, find_best_position

KNOTS = np.linspace(0.0, 6.0, 7)
VARIANCE, CASES, PLACES = 1e-2, 10, 601


def main() -> None:
    try:
        import torch

        torch.set_default_dtype(torch.float64)
        torch.set_num_threads(1)
        import botorch  # noqa: F401
    except ImportError:
        print("BoTorch is not installed; nothing to compare with")
        return
    from botorch_one_axis import best_by_botorch

    spline = natural_spline(KNOTS)
    rows = [case(spline, seed, best_by_botorch) for seed in range(CASES)]
    ours_s, theirs_s, ours, theirs = np.array(rows).T
    print(f"ours {1e3 * np.median(ours_s):.2f} ms, BoTorch {np.median(theirs_s):.2f} s")
    print(
        f"ours is {np.median(theirs_s / ours_s):.0f} x faster; BoTorch lowers J "
        f"by {np.min(theirs / ours):.6f} to {np.max(theirs / ours):.6f} of ours"
    )


def case(spline: CubicSpline, seed: int, theirs) -> tuple[float, float, float, float]:
    """Return seconds and the fall of J, ours and theirs, after some measurements."""
    rng = np.random.default_rng(seed)
    prior = np.diag(rng.uniform(0.5, 2.0, spline.size))
    measured = rng.uniform(KNOTS[0], KNOTS[-1], 1 + seed % 6)
    known = IntegratedVariance(prior, spline.gram())
    for row in spline.basis(measured):
        known = known.update(row, VARIANCE)
    begin = time.perf_counter()
    best = find_best_position(known, spline.basis, KNOTS, VARIANCE)
    ours_s = time.perf_counter() - begin
    places = np.linspace(KNOTS[0], KNOTS[-1], PLACES)
    begin = time.perf_counter()
    at = theirs(spline, prior, measured, places, VARIANCE, seed)
    theirs_s = time.perf_counter() - begin
    drop = known.compute_drops(spline.basis(np.array([at])), VARIANCE)[0]
    return ours_s, theirs_s, best.drop, float(drop)


if __name__ == "__main__":
    main()
