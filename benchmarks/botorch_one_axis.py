"""BoTorch's integrated-variance acquisition on a spline's belief; imports BoTorch."""

from __future__ import annotations

import warnings

import numpy as np
import torch
from botorch.acquisition.active_learning import qNegIntegratedPosteriorVariance
from botorch.models import SingleTaskGP
from botorch.optim import optimize_acqf
from gpytorch.kernels import Kernel
from gpytorch.means import ZeroMean

from truepath.kinematics.splines import CubicSpline

RESTARTS, RAW = 8, 64


class SplineKernel(Kernel):
    """k(s, t) = mᵀ(s) C m(t), the basis made in torch so that it has gradients."""

    def __init__(self, spline: CubicSpline, covariance: np.ndarray) -> None:
        super().__init__()
        self.knots = torch.tensor(spline.knots)
        self.curvature = torch.tensor(spline.curvature_map)
        self.root = torch.linalg.cholesky(torch.tensor(covariance))

    def forward(self, x1, x2, diag=False, **_):
        """Return the kernel's matrix, or its diagonal."""
        left, right = (self._basis(x[..., 0]) @ self.root for x in (x1, x2))
        if diag:
            return (left * right).sum(-1)
        return left @ right.transpose(-1, -2)

    def _basis(self, at):
        inner = self.knots[1:-1].contiguous()
        i = torch.bucketize(at.detach().contiguous(), inner)
        h = self.knots[i + 1] - self.knots[i]
        b = (at - self.knots[i]) / h
        a = 1.0 - b
        unit = torch.eye(len(self.knots))
        rows = a[..., None] * unit[i] + b[..., None] * unit[i + 1]
        rows = rows + ((a**3 - a) * h**2 / 6.0)[..., None] * self.curvature[i]
        return rows + ((b**3 - b) * h**2 / 6.0)[..., None] * self.curvature[i + 1]


def best_by_botorch(
    spline: CubicSpline,
    covariance: np.ndarray,
    measured: np.ndarray,
    places: np.ndarray,
    variance: float,
    seed: int,
) -> float:
    """Return the place that BoTorch would measure next."""
    torch.manual_seed(seed)
    x = torch.tensor(measured)[:, None]
    y = torch.zeros(len(measured), 1)
    model = SingleTaskGP(
        x,
        y,
        torch.full_like(y, variance),
        covar_module=SplineKernel(spline, covariance),
        mean_module=ZeroMean(),
        outcome_transform=None,
    )
    model.eval()
    acquisition = qNegIntegratedPosteriorVariance(
        model, mc_points=torch.tensor(places)[:, None]
    )
    bounds = torch.tensor([[spline.knots[0]], [spline.knots[-1]]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its line search gives up where all is flat
        best, _ = optimize_acqf(
            acquisition,
            bounds,
            q=1,
            num_restarts=RESTARTS,
            raw_samples=RAW,
            retry_on_optimization_warning=False,
        )
    return float(best[0, 0])
